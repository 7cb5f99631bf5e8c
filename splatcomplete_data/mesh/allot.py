"""Decide how many splats every triangle of a mesh gets, so that none is lost.

Conventions
-----------
* A cell of area ``spacing``^2 is what one splat stands for.
* A triangle gets splats of its own if it is not much smaller than a cell, or longer than the
  spacing (slivers, wires): area / cell, rounded, and at least one. Along a triangle lower than a
  row of cells each splat stands for at most ``SLIVER_WIDTH`` spacings, so that none becomes a
  needle.
* All other triangles are tiny. They are gathered in cubes of side ``spacing``, and every cube that
  holds any gets at least one splat, which lies on one of them and is as large as the surface it
  stands for. So the smallest isolated piece of a mesh still shows, and finely cut surface does not
  get more splats than other surface.
* The spacing for a target count is found by bisection: both counts fall as it grows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float32Array, Float64Array, IntArray

OWN_AREA = 0.4
"""A triangle with at least this share of a cell's area gets splats of its own."""
OWN_LENGTH = 1.5
"""So does a triangle whose longest edge is at least this many spacings."""
SLIVER_WIDTH = 1.2
"""Longest cell along a triangle lower than a row of cells, in spacings."""
_ONE_ROW = 1.5
"""A triangle lower than this, in spacings, is cut into one row of cells."""
MAX_SPLATS = 20_000_000
"""A larger number is refused, since it is probably a typing error."""


@dataclass(frozen=True, slots=True)
class Allotment:
    """Splats per triangle."""

    spacing: float
    """Side of a cell, in the units of the vertices."""
    counts: IntArray  # [T]
    tiny_area: Float64Array  # [T] area that each splat of a tiny triangle stands for, else 0
    tiny: int
    """Number of triangles that share splats with others."""

    @property
    def total(self) -> int:
        """Number of splats."""
        return int(self.counts.sum())


def allot_by_spacing(
    vertices: Float32Array,  # [T, 3, 3]
    areas: Float64Array,  # [T]
    spacing: float,
) -> Allotment:
    """Give every triangle its splats at a given spacing.

    Raises:
        UserError: that would be more than ``MAX_SPLATS``.
    """
    cell = spacing * spacing
    if not areas.sum() / max(cell, 1e-300) < MAX_SPLATS:
        raise UserError(
            f"mesh: a spacing of {spacing:g} gives {areas.sum() / max(cell, 1e-300):.3g} splats, "
            f"expected at most {MAX_SPLATS:,}"
        )
    longest = _longest_edges(vertices)
    own = (areas >= OWN_AREA * cell) | (longest >= OWN_LENGTH * spacing)
    is_low = 2.0 * areas < _ONE_ROW * spacing * longest
    along = np.where(is_low, np.ceil(longest / (SLIVER_WIDTH * spacing)), 1.0)
    wanted = np.where(own, np.maximum(np.rint(areas / cell), along), 0)
    if not wanted.sum() <= MAX_SPLATS:
        raise UserError(
            f"mesh: a spacing of {spacing:g} gives {wanted.sum():,.0f} splats, expected at most "
            f"{MAX_SPLATS:,}"
        )
    counts = wanted.astype(np.int64)
    stands_for = np.zeros(len(areas))
    tiny = np.flatnonzero(~own)
    if len(tiny):
        chosen, number, share = _represent(vertices[tiny].mean(axis=1), areas[tiny], spacing)
        counts[tiny[chosen]] = number
        stands_for[tiny[chosen]] = share
    return Allotment(spacing, counts, stands_for, len(tiny))


def allot_by_count(
    vertices: Float32Array,  # [T, 3, 3]
    areas: Float64Array,  # [T]
    count: int,
) -> Allotment:
    """Give every triangle its splats so that they are about ``count`` in all.

    The number is within 2 % of ``count`` unless the mesh has more isolated small pieces or slivers
    than that; it is then the least number that shows them all at a spacing of 1/20 of the box.

    Raises:
        UserError: ``count`` is not positive or above ``MAX_SPLATS``.
    """
    if not 1 <= count <= MAX_SPLATS:
        raise UserError(f"mesh: count: expected 1 to {MAX_SPLATS:,}, found {count}")
    side = float(np.ptp(vertices.reshape(-1, 3), axis=0).max())
    low = 0.5 * np.sqrt(areas.sum() / count)
    high = max(4.0 * low, side / 20.0)
    best = allot_by_spacing(vertices, areas, 2.0 * low)
    for _ in range(14):
        if abs(best.total - count) <= 0.01 * count:
            break
        if best.total > count:
            low = best.spacing
        else:
            high = best.spacing
        best = allot_by_spacing(vertices, areas, float(np.sqrt(low * high)))
    return best


def _longest_edges(vertices: Float32Array) -> Float64Array:  # [T, 3, 3] -> [T]
    """Return the length of every triangle's longest edge."""
    edges = (np.roll(vertices, -1, axis=1) - vertices).astype(np.float64)
    return np.sqrt(np.einsum("tec,tec->te", edges, edges).max(axis=1))


def _represent(
    centers: Float32Array,  # [M, 3]
    areas: Float64Array,  # [M]
    spacing: float,
) -> tuple[IntArray, IntArray, Float64Array]:
    """Choose which tiny triangles carry the splats of their cube.

    Returns:
        Indices of the chosen triangles, their numbers of splats, and the area each stands for.
    """
    cubes = np.floor((centers - centers.min(axis=0)) / spacing).astype(np.int64)
    extent = cubes.max(axis=0) + 1
    keys = (cubes[:, 0] * extent[1] + cubes[:, 1]) * extent[2] + cubes[:, 2]
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    totals = np.add.reduceat(areas[order], starts)
    needed = np.maximum(np.rint(totals / (spacing * spacing)), 1).astype(np.int64)
    # the splats of a cube sit at equal steps of its cumulative area
    before = np.cumsum(areas[order]) - areas[order]
    cube = np.repeat(np.arange(len(starts)), needed)
    rank = np.arange(len(cube)) - np.repeat(np.cumsum(needed) - needed, needed)
    target = before[starts][cube] + (rank + 0.5) * (totals / needed)[cube]
    place = np.searchsorted(before, target, side="right") - 1
    ends = np.append(starts[1:], len(order))
    place = np.clip(place, starts[cube], ends[cube] - 1)
    chosen, first, number = np.unique(place, return_index=True, return_counts=True)
    return order[chosen], number, (totals / needed)[cube[first]]
