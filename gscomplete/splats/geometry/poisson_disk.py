"""Choose points that are evenly spread over a surface: a Poisson-disk sample of given points.

Points are taken one after another, and each is kept unless one that was kept before is nearer than
the spacing and faces the same way (dart throwing, Cook 1986). So no two kept points that face the
same way are nearer than the spacing, no point is farther than it from a kept one, and both sides of
a thin wall have points.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from gscomplete.util.arrays import BoolArray, Float64Array
from gscomplete.util.kernels import KERNEL

_FIRST_SPACING = 0.01
"""Spacing that is tried first; the next ones follow from how many points each keeps."""
_AIM, _ENOUGH, _ROUNDS = 0.985, 0.97, 8
"""The search aims at the first share of the points asked for. It ends once at least the second is
kept, or after so many rounds."""
_CELLS = 1 << 20
"""Cells along each axis; cell numbers must fit into 63 bits."""
_MIX, _SHIFT = 0x9E3779B97F4A7C1, 20
"""Multiplier and shift that turn cell numbers into places of the hash table."""


def poisson_disk_sample(
    points: Float64Array,  # [N, 3]
    normals: Float64Array,  # [N, 3]
    most: int,
    least_spacing: float,
) -> tuple[NDArray[np.intp], float]:  # [K]
    """Return which points to keep, and their spacing: as many as there is room for.

    Args:
        points: of a surface; it is fastest if points that follow each other are near each other.
        normals: which way the points face.
        most: largest number of points to keep, at least 1.
        least_spacing: no smaller spacing is tried, even if fewer than ``most`` are kept.

    Returns:
        Increasing indices of the points, and the spacing with which these are kept. The first
        ``most`` are returned if more face different ways at nearly the same place.
    """
    if not len(points):
        return np.zeros(0, np.intp), least_spacing
    start = points.min(axis=0)
    arrays = [np.ascontiguousarray(array, np.float64) for array in (points - start, normals)]
    extent = float(arrays[0].max())
    floor = max(least_spacing, 2.0 * extent / _CELLS)
    spacing, best = max(floor, _FIRST_SPACING), None
    for _ in range(_ROUNDS):
        kept = np.flatnonzero(keep_apart(*arrays, spacing))
        if len(kept) <= most and (best is None or len(kept) > len(best[0])):
            best = kept, spacing
        is_full = _ENOUGH * most <= len(kept) <= most
        if is_full or (len(kept) <= most and spacing == floor):
            break
        spacing = max(floor, spacing * (len(kept) / (_AIM * most)) ** 0.5)
    while best is None:
        spacing *= 1.5
        kept = np.flatnonzero(keep_apart(*arrays, spacing))
        best = (kept, spacing) if len(kept) <= most or spacing > 4.0 * extent else None
    return best[0][:most], best[1]


@numba.njit(**KERNEL)
def keep_apart(
    points: Float64Array,  # [N, 3] none negative
    normals: Float64Array,  # [N, 3]
    spacing: float,
) -> BoolArray:  # [N]
    """Mark the points that are kept; cells as wide as the spacing are found by hashing."""
    count, size = len(points), 1
    while size < 2 * count:
        size *= 2
    cells = np.full(size, -1, np.int64)
    newest = np.empty(size, np.int32)  # point that was last kept in a cell
    earlier = np.empty(count, np.int32)  # the one before it, or -1
    kept = np.zeros(count, np.bool_)
    for i in range(count):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        at_x, at_y, at_z = x / spacing + 1.0, y / spacing + 1.0, z / spacing + 1.0
        cell_x, cell_y, cell_z = int(at_x), int(at_y), int(at_z)
        at_x, at_y, at_z = at_x - cell_x, at_y - cell_y, at_z - cell_z
        is_free, own, own_cell = True, 0, 0
        for k in range(27):  # the point's own cell is the first
            step_x, step_y, step_z = (k // 9 + 1) % 3 - 1, (k // 3 + 1) % 3 - 1, (k + 1) % 3 - 1
            gap_x = 0.0 if step_x == 0 else (1.0 - at_x if step_x == 1 else at_x)
            gap_y = 0.0 if step_y == 0 else (1.0 - at_y if step_y == 1 else at_y)
            gap_z = 0.0 if step_z == 0 else (1.0 - at_z if step_z == 1 else at_z)
            if gap_x * gap_x + gap_y * gap_y + gap_z * gap_z >= 1.0:
                continue
            cell = ((cell_x + step_x) * _CELLS + cell_y + step_y) * _CELLS + cell_z + step_z
            place = (cell * _MIX >> _SHIFT) & (size - 1)
            while cells[place] != -1 and cells[place] != cell:
                place = (place + 1) & (size - 1)
            if k == 0:
                own, own_cell = place, cell
            if cells[place] == -1:
                continue
            j = newest[place]
            while j >= 0:
                a, b, c = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
                if a * a + b * b + c * c < spacing * spacing:
                    u, v, w = normals[j, 0], normals[j, 1], normals[j, 2]
                    if u * normals[i, 0] + v * normals[i, 1] + w * normals[i, 2] > 0.0:
                        is_free = False
                        break
                j = earlier[j]
            if not is_free:
                break
        if is_free:
            kept[i] = True
            earlier[i] = newest[own] if cells[own] != -1 else -1
            cells[own], newest[own] = own_cell, i
    return kept
