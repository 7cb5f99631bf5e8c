"""Views of P, its outline from them, and what lies beside it.

Conventions
-----------
* A view is three axes: to the right, up, and towards the viewer. Views are at V's distance and look
  at its target, which points are given about; their pictures are planes through the target.
* The grid is ``ELEVATIONS_DEG`` by ``AZIMUTHS``, azimuths in turn; arrays over it are [V, ...].
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from gscomplete.shape.voxels import FloatArray

ELEVATIONS_DEG = (0.0, 15.0, 30.0, 45.0)
AZIMUTHS = 24
"""Evenly round the object; even, so that every view has an opposite."""
SIDE_PX = 96
"""Of a picture of the grid's."""
_HALF_WIDTH = 0.9
"""Of a picture, object sizes."""
_GROWN_PX = 5
"""Side of the square that each point of an outline grows to."""

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
        side_px: int = SIDE_PX,
    ) -> tuple[NDArray[np.int64], FloatArray]:  # [N], [N]
        """Return the pixels of points, numbered row by row, and how far away they are."""
        right, up, toward = self.axes @ points.T
        depth = self.distance - toward
        scale = self.distance / np.maximum(depth, 1e-3)
        column, row = (
            ((v * scale + _HALF_WIDTH) * (side_px / (2 * _HALF_WIDTH)))
            .clip(0, side_px - 1)
            .astype(np.int64)
            for v in (right, up)
        )
        return row * side_px + column, depth

    def beside(
        self,
        points: FloatArray,  # [N, 3] about the target
        places: FloatArray,  # [M, 3] about the target
        side_px: int,
        grown_px: int,
    ) -> Mask:  # [M]
        """Return which places lie beside the outline of points."""
        covered = outline(self.pixels(points, side_px)[0], side_px, grown_px)
        return ~covered.ravel()[self.pixels(places, side_px)[0]]


def outline(
    pixels: NDArray[np.int64],  # [N]
    side_px: int = SIDE_PX,
    grown_px: int = _GROWN_PX,
) -> Mask:  # [side_px, side_px]
    """Return the outline of points, filled, without gaps between them."""
    covered = np.zeros(side_px**2, np.bool_)
    covered[pixels] = True
    return maximum_filter(covered.reshape(side_px, side_px), grown_px)


def views_at(distance: float) -> list[View]:
    """Return the grid of views."""
    return [View(axes, distance) for axes in _grid_axes()]


@functools.cache
def _grid_axes() -> FloatArray:  # [V, 3, 3]
    return axes_of_views(360.0 / AZIMUTHS, ELEVATIONS_DEG).astype(np.float32)


def axes_of_views(
    step_deg: float, elevations_deg: Sequence[float]
) -> NDArray[np.float64]:  # [V, 3, 3]
    """Return the axes of views from all sides, at some elevations, azimuths in turn."""
    found = []
    for elevation in np.deg2rad(elevations_deg):
        for azimuth in np.deg2rad(np.arange(0.0, 360.0, step_deg)):
            right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
            level = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
            toward = level * math.cos(elevation) + (0.0, 0.0, math.sin(elevation))
            found.append(np.stack([right, np.cross(toward, right), toward]))
    return np.stack(found)
