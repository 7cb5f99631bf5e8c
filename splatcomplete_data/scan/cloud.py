"""The record of a scan: coloured points.

Conventions
-----------
* Points keep the file's frame and units; colours are sRGB in [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gscomplete.util.arrays import Float32Array, Float64Array, IntArray

GREY = 0.6
"""Colour of points without any."""
NO_COLOR = "no colour: grey"
"""Note on such points."""


@dataclass(frozen=True, slots=True)
class PointCloud:
    """N coloured points."""

    points: Float64Array  # [N, 3]
    colors: Float32Array  # [N, 3] sRGB in [0, 1]
    labels: IntArray | None = None  # [N], None = the file has none

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    def select(self, index: NDArray[np.generic]) -> PointCloud:
        """Return the points picked by a mask or by indices."""
        labels = None if self.labels is None else self.labels[index]
        return PointCloud(self.points[index], self.colors[index], labels)


def grey_colors(count: int) -> Float32Array:  # [N, 3]
    """Return the colours of a cloud that has none."""
    return np.full((count, 3), GREY, np.float32)


def unit_colors(values: NDArray[Any]) -> Float32Array:
    """Scale colours of any type to [0, 1].

    Bytes are divided by 255, 16-bit integers by 65535. For wider integers and floats the largest
    value tells whether to divide by 1 (floats only), 255 or 65535. Values that are not finite
    become 0.
    """
    if np.issubdtype(values.dtype, np.integer) and values.dtype.itemsize <= 2:
        top = float(np.iinfo(values.dtype).max)
        return np.clip(values / np.float64(top), 0, 1).astype(np.float32)
    with np.errstate(invalid="ignore"):  # signalling NaNs
        wide = values.astype(np.float64)
    scaled = np.nan_to_num(wide, posinf=0.0, neginf=0.0)
    largest = scaled.max(initial=0.0)
    if largest > 255.0:
        scaled = scaled / 65535.0
    elif largest > 1.0 or np.issubdtype(values.dtype, np.integer):
        scaled = scaled / 255.0
    return scaled.clip(0, 1).astype(np.float32)
