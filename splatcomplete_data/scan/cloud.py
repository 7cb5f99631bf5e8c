"""The record of a scan: coloured points.

Conventions
-----------
* Points keep the file's frame and units; colours are sRGB in [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GREY = 0.6
"""Colour of points without any."""


@dataclass(frozen=True, slots=True)
class PointCloud:
    """N coloured points."""

    points: NDArray[np.float64]  # [N, 3]
    colors: NDArray[np.float32]  # [N, 3] sRGB in [0, 1]
    labels: NDArray[np.int64] | None = None  # [N], None = the file has none

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    def select(self, index: NDArray[np.generic]) -> PointCloud:
        """Return the points picked by a mask or by indices."""
        labels = None if self.labels is None else self.labels[index]
        return PointCloud(self.points[index], self.colors[index], labels)


def grey_colors(count: int) -> NDArray[np.float32]:  # [N, 3]
    """Return the colours of a cloud that has none."""
    return np.full((count, 3), GREY, np.float32)
