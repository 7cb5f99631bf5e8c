"""Depth images to points, without the flying pixels at depth edges.

Conventions
-----------
* Points are in camera axes (OpenCV: x right, y down, z forward), in the depth's unit; pixel (0, 0)
  has its centre at (0.5, 0.5).
* A flying pixel hangs between a near and a far surface, because stereo, time of flight and networks
  all blur depth across edges. Unlike a pixel at a clean edge it has jumps on both sides: its depth
  differs from *both* neighbours in its row (or column) by more than a share of its depth, or no
  neighbour at all is at its depth. Pixels at a clean edge are kept.
"""

from __future__ import annotations

import numpy as np

from gscomplete.util.arrays import BoolArray, Float64Array, IntArray
from splatcomplete_data.singleview.intrinsics import Intrinsics

FLYING_JUMP = 0.02
"""Jump between neighbouring pixels, over their depth, that a surface does not make."""


def flying_pixels(
    depth: Float64Array,  # [H, W], NaN = unknown
    jump: float = FLYING_JUMP,
) -> BoolArray:  # [H, W]
    """Mark flying pixels among the known ones."""
    known = np.isfinite(depth)
    flying = np.zeros(depth.shape, np.bool_)
    for axis in (0, 1):
        before, after = _beside(depth, 1, axis), _beside(depth, -1, axis)
        with np.errstate(invalid="ignore"):
            jumps_before = ~(np.abs(before - depth) <= jump * np.minimum(before, depth))
            jumps_after = ~(np.abs(after - depth) <= jump * np.minimum(after, depth))
            between = (np.minimum(before, after) < depth) & (depth < np.maximum(before, after))
        one_missing = np.isnan(before) != np.isnan(after)
        flying |= known & jumps_before & jumps_after & (between | one_missing)
    return flying | (known & (_close_neighbours(depth, jump) == 0))


def _beside(depth: Float64Array, step: int, axis: int) -> Float64Array:
    """Return every pixel's neighbour, NaN beyond the border."""
    moved = np.roll(depth, step, axis)
    edge = [slice(None), slice(None)]
    edge[axis] = slice(0, 1) if step > 0 else slice(-1, None)
    moved[tuple(edge)] = np.nan
    return moved


def _close_neighbours(depth: Float64Array, jump: float) -> IntArray:
    """Count how many of the four neighbours are at a pixel's depth."""
    count = np.zeros(depth.shape, np.int64)
    for axis in (0, 1):
        for step in (1, -1):
            other = _beside(depth, step, axis)
            with np.errstate(invalid="ignore"):
                count += np.abs(other - depth) <= jump * np.minimum(other, depth)
    return count


def unproject(
    depth: Float64Array,  # [H, W]
    camera: Intrinsics,
    keep: BoolArray,  # [H, W]
) -> Float64Array:  # [N, 3]
    """Return the points of the pixels kept, row by row."""
    rows, columns = np.nonzero(keep)
    z = depth[rows, columns]
    x = (columns + 0.5 - camera.center_x_px) / camera.focal_x_px * z
    y = (rows + 0.5 - camera.center_y_px) / camera.focal_y_px * z
    return np.stack([x, y, z], axis=1)
