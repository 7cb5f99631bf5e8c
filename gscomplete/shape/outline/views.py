"""Views of P, its outline from them, and what lies beside it.

Conventions
-----------
* A view is three axes: right, up, and towards the viewer. Views are perspective, at V's distance
  from its target, and look at it; the picture plane passes through the target. Points are relative
  to the target.
* The grid has the elevations ``ELEVATIONS_DEG`` and, for each, ``AZIMUTHS`` azimuths in turn;
  arrays over it are [V, ...].
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from gscomplete.util.arrays import BoolArray, Float32Array, Float64Array, IntArray

ELEVATIONS_DEG = (0.0, 15.0, 30.0, 45.0)
AZIMUTHS = 24
"""Views at each elevation, evenly round the object; an even number, so that each has an
opposite."""
SIDE_PX = 96
"""Side of a picture from a view of the grid."""
_HALF_WIDTH = 0.9
"""Half the side of a picture, object sizes."""
_GROWN_PX = 5
"""Side of the square that each point of an outline is grown to."""

Mask = BoolArray


@dataclass(frozen=True, slots=True)
class View:
    """One view."""

    axes: Float32Array  # [3, 3]
    distance: float

    @property
    def toward(self) -> Float32Array:  # [3]
        """Direction to the viewer."""
        return self.axes[2]

    def pixels(
        self,
        points: Float32Array,  # [N, 3] about the target
        side_px: int = SIDE_PX,
    ) -> tuple[IntArray, Float32Array]:  # [N], [N]
        """Return the pixels of points, numbered row by row, and the points' depths."""
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
        points: Float32Array,  # [N, 3] about the target
        places: Float32Array,  # [M, 3] about the target
        side_px: int,
        grown_px: int,
    ) -> Mask:  # [M]
        """Return which places lie beside the outline of points."""
        covered = outline(self.pixels(points, side_px)[0], side_px, grown_px)
        return ~covered.ravel()[self.pixels(places, side_px)[0]]


def outline(
    pixels: IntArray,  # [N]
    side_px: int = SIDE_PX,
    grown_px: int = _GROWN_PX,
) -> Mask:  # [side_px, side_px]
    """Return the pixels that points cover, grown so that gaps between points close."""
    covered = np.zeros(side_px**2, np.bool_)
    covered[pixels] = True
    return maximum_filter(covered.reshape(side_px, side_px), grown_px)


def views_at(distance: float) -> list[View]:
    """Return the grid of views."""
    return [View(axes, distance) for axes in _grid_axes()]


@functools.cache
def _grid_axes() -> Float32Array:  # [V, 3, 3]
    return axes_of_views(360.0 / AZIMUTHS, ELEVATIONS_DEG).astype(np.float32)


def axes_of_views(step_deg: float, elevations_deg: Sequence[float]) -> Float64Array:  # [V, 3, 3]
    """Return the axes of views all round at the given elevations; azimuths change fastest."""
    found = []
    for elevation in np.deg2rad(elevations_deg):
        for azimuth in np.deg2rad(np.arange(0.0, 360.0, step_deg)):
            right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
            level = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
            toward = level * math.cos(elevation) + (0.0, 0.0, math.sin(elevation))
            found.append(np.stack([right, np.cross(toward, right), toward]))
    return np.stack(found)
