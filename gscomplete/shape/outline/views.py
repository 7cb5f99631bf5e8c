"""P's outline from a grid of views, and what lies beside it.

Conventions
-----------
* A view is three axes: to the right, up, and towards the viewer. Views are at V's distance and look
  at its target, which points are given about; their pictures are planes through the target.
* The grid is ``ELEVATIONS_DEG`` by ``AZIMUTHS``, azimuths in turn; arrays over it are [V, ...].
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from gscomplete.shape.voxels import FloatArray

ELEVATIONS_DEG = (0.0, 15.0, 30.0, 45.0)
AZIMUTHS = 24
"""Evenly round the object; even, so that every view has an opposite."""
SIDE_PX = 96
_HALF_WIDTH = 0.9
"""Of a picture, object sizes."""
_GROWN_PX, _BESIDE_PX = 5, 7
"""Side of the square that each point of an outline grows to, and for what lies beside it: where it
turns away, P's surface is sparse."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class View:
    """One view."""

    axes: FloatArray  # [3, 3]
    distance: float

    @property
    def toward(self) -> FloatArray:  # [3]
        """Direction to the viewer."""
        return self.axes[2]

    def pixels(
        self,
        points: FloatArray,  # [N, 3] about the target
    ) -> tuple[NDArray[np.int64], FloatArray]:  # [N], [N]
        """Return the pixels of points, numbered row by row, and how far away they are."""
        right, up, toward = self.axes @ points.T
        depth = self.distance - toward
        scale = self.distance / np.maximum(depth, 1e-3)
        column, row = (
            ((v * scale + _HALF_WIDTH) * (SIDE_PX / (2 * _HALF_WIDTH)))
            .clip(0, SIDE_PX - 1)
            .astype(np.int64)
            for v in (right, up)
        )
        return row * SIDE_PX + column, depth

    def beside(
        self,
        points: FloatArray,  # [N, 3] about the target
        places: FloatArray,  # [M, 3] about the target
    ) -> Mask:  # [M]
        """Return which places lie beside the outline of points."""
        covered = outline(self.pixels(points)[0], _BESIDE_PX)
        return ~covered.ravel()[self.pixels(places)[0]]


def outline(
    pixels: NDArray[np.int64],  # [N]
    grown_px: int = _GROWN_PX,
) -> Mask:  # [SIDE_PX, SIDE_PX]
    """Return the outline of points, filled, without gaps between them."""
    covered = np.zeros(SIDE_PX**2, np.bool_)
    covered[pixels] = True
    return maximum_filter(covered.reshape(SIDE_PX, SIDE_PX), grown_px)


def views_at(distance: float) -> list[View]:
    """Return the grid of views."""
    return [View(axes, distance) for axes in _axes()]


@functools.cache
def _axes() -> FloatArray:  # [V, 3, 3]
    """Return the axes of the grid's views."""
    elevation, azimuth = np.meshgrid(
        np.deg2rad(ELEVATIONS_DEG), 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS, indexing="ij"
    )
    flat, zero = np.cos(elevation), np.zeros_like(elevation)
    level = np.stack([np.cos(azimuth), np.sin(azimuth), zero], axis=-1)
    right = np.stack([-np.sin(azimuth), np.cos(azimuth), zero], axis=-1)
    up = np.stack([zero, zero, np.ones_like(zero)], axis=-1)
    toward = level * flat[..., None] + up * np.sin(elevation)[..., None]
    axes = np.stack([right, np.cross(toward, right), toward], axis=-2)
    return axes.reshape(-1, 3, 3).astype(np.float32)
