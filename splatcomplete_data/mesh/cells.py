"""Cut triangles into cells of about one size, each of which one flat splat stands for.

Conventions
-----------
* A triangle lies on its longest edge, the base: x runs along the base, y up to the apex. It is cut
  into m rows of equal height, row j into k_j equal pieces; a piece is a cell, a rectangle of
  ``width x height`` in the tangent plane. In the frame (x, y) the map from a unit square to a cell
  is diagonal: x and y are the singular vectors of its Jacobian, width and height its singular
  values. A splat's tangent standard deviations are a multiple of them, its axes are x and y.
* Triangles lower than one row get one row whose cells follow the triangle's local height down to
  ``THINNEST``, so slivers become rows of thin splats that neither bulge nor vanish, and no needles.
* Edges marked ``inset`` (borders, folds) are moved inwards before cutting, by a fraction of the
  cell, so that the soft rim of a splat ends about where the surface does.
* Barycentric weights belong to the corners in the caller's order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gscomplete.util.arrays import Float32Array, Float64Array, IntArray

THINNEST = 0.15
"""Least height of a cell, in spacings; with ``allot.SLIVER_WIDTH`` it bounds a cell's aspect."""
_POINTED = 1.5
"""If the end of the lowest row slants over more cells than this, within a flat surface, the row is
cut into slices of equal area. Otherwise the tips of a fan of triangles would all be cut off and
leave a hole at the centre of the fan."""
_MOST_ASPECT = 7.0
"""Largest aspect of such a slice. At the very tip a slice is therefore wider than the triangle."""
_DIRECTIONS = 16
_COSINES = tuple(math.cos(2.0 * math.pi * k / _DIRECTIONS) for k in range(_DIRECTIONS))
_SINES = tuple(math.sin(2.0 * math.pi * k / _DIRECTIONS) for k in range(_DIRECTIONS))
_ROUNDS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """N cells, each of which becomes one splat."""

    triangle: IntArray  # [N] index into all parts' triangles
    weights: Float32Array  # [N, 3] barycentric weights of the middle
    steps: Float32Array  # [N, 2, 3] change of the weights over a quarter cell along x and y
    axes: Float32Array  # [N, 2, 3] unit x and y
    sizes: Float32Array  # [N, 2] width and height


@numba.njit(cache=True)
def row_counts(base: float, height: float, count: int) -> tuple[int, float]:
    """Return the number of rows m of a triangle cut into ``count`` cells, and a cell's side."""
    side = math.sqrt(0.5 * base * height / count)
    rows = round(height / side)
    return min(max(rows, 1), count), side


@numba.njit(cache=True)
def _inset_triangle(
    corners: Float64Array,  # [3, 3] barycentric weights, one row per corner; changed
    lengths: Float64Array,  # [3] of the edges; edge e runs from corner e to corner e + 1
    area: float,
    marked: int,  # bit e = edge e is inset
    depth: float,
    side: float,
) -> None:
    """Move each marked edge inwards by at most ``depth`` and at most a third of the inradius.

    Triangles thinner than a cell stay as they are: their splats follow the local height anyway, and
    moving the edges of an acute corner would shorten them.
    """
    inradius = 2.0 * area / (lengths[0] + lengths[1] + lengths[2])
    if inradius <= 0.4 * side:  # equal where the area is rounded to 0
        return
    depth = min(depth, inradius * 0.35)
    shift = np.zeros(3)  # barycentric weight of the corner opposite an edge, on the moved edge
    for edge in range(3):
        if marked >> edge & 1:
            shift[(edge + 2) % 3] = depth * lengths[edge] / (2.0 * area)
    rest = 1.0 - shift[0] - shift[1] - shift[2]
    for corner in range(3):
        for axis in range(3):
            corners[corner, axis] = shift[axis] + (rest if axis == corner else 0.0)


@numba.njit(cache=True)
def cut_into_cells(
    vertices: Float32Array,  # [T, 3, 3]
    counts: IntArray,  # [T] cells per triangle
    areas: Float64Array,  # [T]
    marked: NDArray[np.uint8],  # [T] bit e set = edge e (corner e to e + 1) is inset
    ends: NDArray[np.uint8],  # [T] bit k set = the surface is not flat all round corner k
    inset: float,  # depth of the inset over the cell's side
    spacing: float,  # of the mesh, vertices' units
    triangle: IntArray,  # [N] out
    weights: Float32Array,  # [N, 3] out: barycentric weights of the cell's middle
    steps: Float32Array,  # [N, 2, 3] out: weights' change over a quarter cell along x and y
    axes: Float32Array,  # [N, 2, 3] out: unit x and y
    sizes: Float32Array,  # [N, 2] out: width and height
) -> int:
    """Fill the cells of all triangles in order; return their number."""
    made = 0
    corners = np.empty((3, 3))
    points = np.empty((3, 3))
    lengths = np.empty(3)
    for t in range(len(counts)):
        count = counts[t]
        if count < 1:
            continue
        for corner in range(3):
            for axis in range(3):
                corners[corner, axis] = 1.0 if axis == corner else 0.0
        _edge_lengths(vertices[t], lengths)
        if marked[t] and inset > 0.0:
            side = math.sqrt(areas[t] / count)
            _inset_triangle(corners, lengths, areas[t], marked[t], inset * side, side)
        for corner in range(3):
            for axis in range(3):
                total = 0.0
                for k in range(3):
                    total += corners[corner, k] * vertices[t, k, axis]
                points[corner, axis] = total
        thinnest = THINNEST * spacing
        made = _cut_one(
            points,
            corners,
            count,
            thinnest,
            made,
            triangle,
            weights,
            steps,
            axes,
            sizes,
            t,
            ends[t],
        )
    return made


@numba.njit(cache=True)
def _edge_lengths(corners: NDArray, lengths: Float64Array) -> None:
    """Fill in the lengths of the edges 0-1, 1-2, 2-0."""
    for edge in range(3):
        total = 0.0
        for axis in range(3):
            difference = float(corners[(edge + 1) % 3, axis]) - float(corners[edge, axis])
            total += difference * difference
        lengths[edge] = math.sqrt(total)


@numba.njit(cache=True)
def _cut_one(
    points: Float64Array,  # [3, 3]
    corners: Float64Array,  # [3, 3]
    count: int,
    thinnest: float,
    made: int,
    triangle: IntArray,
    weights: Float32Array,
    steps: Float32Array,
    axes: Float32Array,
    sizes: Float32Array,
    index: int,
    ends: int,
) -> int:
    """Cut one triangle; see ``cut_into_cells``."""
    lengths = np.empty(3)
    _edge_lengths(points, lengths)
    longest = 0
    for edge in range(1, 3):
        if lengths[edge] > lengths[longest]:
            longest = edge
    a, b, c = longest, (longest + 1) % 3, (longest + 2) % 3  # base from a to b, apex c
    base = lengths[longest]
    x_axis, y_axis = np.empty(3), np.empty(3)
    along = 0.0
    for axis in range(3):
        x_axis[axis] = (points[b, axis] - points[a, axis]) / base
        along += (points[c, axis] - points[a, axis]) * x_axis[axis]
    height = 0.0
    for axis in range(3):
        y_axis[axis] = points[c, axis] - points[a, axis] - along * x_axis[axis]
        height += y_axis[axis] * y_axis[axis]
    height = max(math.sqrt(height), 1e-7 * base)
    for axis in range(3):
        y_axis[axis] /= height
    apex = min(max(along / base, 0.0), 1.0)
    # corners with flat surface all round
    at_a, at_b = (ends >> a & 1) == 0, (ends >> b & 1) == 0
    rows, _ = row_counts(base, height, count)
    placed, passed = 0, 0.0
    for row in range(rows):
        middle = (row + 0.5) / rows if rows > 1 else 0.0
        passed += 1.0 - (row + 0.5) / rows
        until = math.floor(count * passed / (0.5 * rows) + 0.5)
        if row == rows - 1:
            until = count
        pieces = until - placed
        usual = base * (1.0 - middle) / max(pieces, 1)
        rise = fall = 0.0
        if rows > 1 and row == 0:
            most = _POINTED * usual / base
            rise = apex / rows if at_a and apex / rows > most else 0.0
            fall = (1.0 - apex) / rows if at_b and (1.0 - apex) / rows > most else 0.0
        for piece in range(pieces):
            width = usual
            u = (piece + 0.5) / pieces  # along the row
            if rise + fall > 0.0:
                start, end = _slice(piece, pieces, rise, fall, rows, apex)
                x, mean_height = 0.5 * (start + end), (1.0 - 0.5 / rows) / (pieces * (end - start))
                cell_height = height * mean_height / rows
                v = 0.5 * mean_height / rows
                width = base * (end - start)
                cell_height = max(cell_height, width / _MOST_ASPECT)
            elif rows > 1:
                v, cell_height = middle, height / rows
                x = apex * v + u * (1.0 - v)  # both in units of the base
            else:
                x = u if pieces > 1 else (1.0 + apex) / 3.0
                left = x / apex if x < apex else 1.0
                right = (1.0 - x) / (1.0 - apex) if x > apex else 1.0
                local = min(left, right)
                v = 0.5 * local if pieces > 1 else 1.0 / 3.0
                cell_height = height * local if pieces > 1 else height * 0.75
            if rows == 1 and pieces == 1:
                width = base * (0.85 if 3.0 * height < base else 0.75)  # slivers end abruptly
            place = made + placed
            triangle[place] = index
            sizes[place, 0], sizes[place, 1] = width, max(cell_height, min(thinnest, width))
            weight_b = x - apex * v
            weight_a = 1.0 - v - weight_b
            du = 0.25 * width / base
            dv = 0.25 * cell_height / height
            for axis in range(3):
                weights[place, axis] = (
                    weight_a * corners[a, axis] + weight_b * corners[b, axis] + v * corners[c, axis]
                )
                steps[place, 0, axis] = du * (corners[b, axis] - corners[a, axis])
                steps[place, 1, axis] = dv * (
                    corners[c, axis] - apex * corners[b, axis] - (1.0 - apex) * corners[a, axis]
                )
                axes[place, 0, axis] = x_axis[axis]
                axes[place, 1, axis] = y_axis[axis]
            placed += 1
    return made + placed


@numba.njit(cache=True)
def _slice(
    piece: int, pieces: int, rise: float, fall: float, rows: int, apex: float
) -> tuple[float, float]:
    """Return begin and end of one of the lowest row's slices of equal area, as shares of the base.

    The row's height rises over the length ``rise`` at the start of the base and falls over ``fall``
    at its end. Where one of them is 0, the row ends upright, in the middle of its slanting end.
    """
    low = 0.5 * apex / rows if rise == 0.0 else 0.0
    high = 1.0 - (0.5 * (1.0 - apex) / rows if fall == 0.0 else 0.0)
    area = high - low - 0.5 * (rise + fall)
    start, end = low, high
    for side in range(2):
        share = area * (piece + side) / pieces
        if share < 0.5 * rise:
            place = low + math.sqrt(2.0 * share * rise)
        elif share <= area - 0.5 * fall:
            place = low + share + 0.5 * rise
        else:
            place = high - math.sqrt(max(2.0 * (area - share) * fall, 0.0))
        if side == 0:
            start = place
        else:
            end = place
    return start, end


@numba.njit(cache=True, parallel=True)
def keep_within(
    vertices: Float32Array,  # [T, 3, 3]
    marked: NDArray[np.uint8],  # [T] bit e set = edge e (corner e to e + 1) bounds the surface
    triangle: IntArray,  # [N]
    weights: Float32Array,  # [N, 3]
    axes: Float32Array,  # [N, 2, 3]
    reach: float,  # of a splat over its cell's sides
    limit: float,  # how far it may reach beyond the surface's edge, vertices' units
    sizes: Float32Array,  # [N, 2] changed
) -> None:
    """Shorten cells whose splats would reach beyond a marked edge by more than a limit.

    A splat's rim is tested in ``_DIRECTIONS`` directions. A rim point whose nearest point of the
    triangle lies on an edge without a mark counts as covered by the triangle beyond that edge.
    """
    for n in numba.prange(len(triangle)):
        t = triangle[n]
        if marked[t] == 0:
            continue
        corners = np.zeros((3, 2))  # in the cell's own axes, from its middle
        for k in range(3):
            middle = 0.0
            for corner in range(3):
                middle += weights[n, corner] * vertices[t, corner, k]
            for corner in range(3):
                for axis in range(2):
                    corners[corner, axis] += (vertices[t, corner, k] - middle) * axes[n, axis, k]
        farthest = reach * max(sizes[n, 0], sizes[n, 1])
        if farthest <= limit + _distance_to_marked(corners, marked[t]):
            continue
        for _ in range(_ROUNDS):
            worst, at_x, at_y = limit, 0.0, 0.0
            for direction in range(_DIRECTIONS):
                x = reach * sizes[n, 0] * _COSINES[direction]
                y = reach * sizes[n, 1] * _SINES[direction]
                beyond = _beyond(corners, marked[t], x, y)
                if beyond > worst:
                    worst, at_x, at_y = beyond, x, y
            if worst <= limit:
                break
            # The axis that contributes most to the rim's farthest point is the one to shorten.
            axis = 0 if abs(at_x) >= abs(at_y) else 1
            length = max(abs(at_x), abs(at_y))
            sizes[n, axis] *= max(0.4, 1.0 - 1.05 * (worst - limit) / length)


@numba.njit(cache=True)
def _distance_to_marked(corners: Float64Array, marked: int) -> float:
    """Return how far the origin is from the nearest marked edge of a triangle [3, 2]."""
    nearest = math.inf
    for edge in range(3):
        if marked >> edge & 1:
            after = (edge + 1) % 3
            dx, dy = corners[after, 0] - corners[edge, 0], corners[after, 1] - corners[edge, 1]
            px, py = -corners[edge, 0], -corners[edge, 1]
            share = (px * dx + py * dy) / max(dx * dx + dy * dy, 1e-300)
            share = min(max(share, 0.0), 1.0)
            nearest = min(nearest, math.hypot(px - share * dx, py - share * dy))
    return nearest


@numba.njit(cache=True)
def _beyond(corners: Float64Array, marked: int, x: float, y: float) -> float:
    """Return how far a point lies beyond the marked edges of a triangle [3, 2]; 0 = it does not."""
    turn = (corners[1, 0] - corners[0, 0]) * (corners[2, 1] - corners[0, 1]) - (
        corners[1, 1] - corners[0, 1]
    ) * (corners[2, 0] - corners[0, 0])
    sign = 1.0 if turn > 0 else -1.0
    nearest, is_open, is_inside = math.inf, False, True
    for edge in range(3):
        after = (edge + 1) % 3
        dx, dy = corners[after, 0] - corners[edge, 0], corners[after, 1] - corners[edge, 1]
        px, py = x - corners[edge, 0], y - corners[edge, 1]
        if sign * (dx * py - dy * px) < 0:
            is_inside = False
        along = (px * dx + py * dy) / max(dx * dx + dy * dy, 1e-300)
        share = min(max(along, 0.0), 1.0)
        off = math.hypot(px - share * dx, py - share * dy)
        open_here = (marked >> edge & 1) != 0
        if share == 0.0:  # a corner is open where either of its edges is
            open_here = open_here or (marked >> ((edge + 2) % 3) & 1) != 0
        elif share == 1.0:
            open_here = open_here or (marked >> after & 1) != 0
        if off < nearest:
            nearest, is_open = off, open_here
    return 0.0 if is_inside or not is_open else nearest
