"""How far splats lie below their mesh, to offset what 3DGS's blur adds to an outline.

Conventions
-----------
* 3DGS adds 0.3 px^2 to every projected covariance, also to that of a disc seen from its edge, so an
  outline moves out by 0.6 to 1 pixel whatever the splats' size. Splats sink by ``DEPTH_PX`` pixels
  of a picture of a given size, but at most by ``MOST_SPACINGS``, so that more splats are more
  exact.
* Splats on surfaces without an inside (``edges.inside_of``) stay on the surface.
* If there is a surface behind a splat that faces the other way, or whose splats stay, the splat
  sinks by at most ``_SHARE`` of the way to where it would be ``_APART_SPACINGS`` away from that
  surface.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from gscomplete.util.arrays import Float32Array, IntArray
from splatcomplete_data.mesh.cells import Cells

DEPTH_PX = 0.5
MOST_SPACINGS = 0.3
_SHARE = 0.5
_APART_SPACINGS = 0.5
"""Closer together, the two sides of a thin wall would show through each other, because 3DGS sorts
splats by their centres."""
_CUBE_SPACINGS = 2.0
"""Side of the cubes that splats are looked up in; half of it is more than the search reaches."""
_BESIDE_SPACINGS = 0.75
"""A surface behind a splat has a splat within this distance of the splat's normal."""
_LEVEL = 1e-3
"""Surface less than this in front of a splat counts as in the same place, spacings."""
_LEANS = 1 / 6
"""Component along an axis from which a unit normal leans towards it."""


def sinking_depth(vertices: Float32Array, spacing: float, outline_px: float) -> float:
    """Return how far splats sink, in the vertices' units.

    Args:
        vertices: of the triangles, [T, 3, 3].
        spacing: side of a cell.
        outline_px: pixels of the object's largest side in pictures whose outlines are to be right;
            0 = none.
    """
    if outline_px == 0:
        return 0.0
    size = float(np.ptp(vertices.reshape(-1, 3), axis=0).max())
    return min(DEPTH_PX * size / outline_px, MOST_SPACINGS * spacing)


def sink(
    vertices: Float32Array,  # [T, 3, 3]
    cells: Cells,
    inside: NDArray[np.int8],  # [T] as of ``edges.inside_of``
    depth: float,
    spacing: float,
) -> Float32Array:  # [N]
    """Return how far the splats of cells are to lie from them, along their winding's normals."""
    count = len(cells.triangle)
    raised = np.zeros(count, np.float32)
    if depth == 0 or not inside.any():
        return raised
    low = vertices.min(axis=(0, 1))
    side = _CUBE_SPACINGS * spacing
    rows = 1 << max(4, count.bit_length())
    heads, following = np.full(rows, -1, np.int32), np.empty(count, np.int32)
    facing = np.zeros(rows, np.uint8)
    means, outwards = np.empty((2, count, 3), np.float32)
    places = vertices, cells.triangle, cells.weights, cells.axes, inside
    _file(*places, low, side, means, outwards, heads, following, facing)
    turns = inside[cells.triangle]
    _limit(means, outwards, turns, low, side, heads, following, facing, depth, spacing, raised)
    return raised * turns


@numba.njit(cache=True)
def _cube(x: int, y: int, z: int, cubes: int) -> int:
    """Return the row of a cube in a table of a power of 2 of them; several may share one."""
    return (x * 73_856_093 ^ y * 19_349_663 ^ z * 83_492_791) & (cubes - 1)


@numba.njit(cache=True)
def _signs(normal: Float32Array, sign: float) -> int:
    """Return a bit for every signed axis that a unit normal, times a sign, leans towards.

    Of two normals with a cosine below -1/2 one leans towards an axis and the other away from it.
    """
    bits = 0
    for axis in range(3):
        along = sign * normal[axis]
        if along > _LEANS:
            bits |= 1 << axis
        elif along < -_LEANS:
            bits |= 8 << axis
    return bits


@numba.njit(cache=True)
def _file(
    vertices: Float32Array,  # [T, 3, 3]
    triangle: IntArray,  # [N]
    weights: Float32Array,  # [N, 3]
    axes: Float32Array,  # [N, 2, 3]
    inside: NDArray[np.int8],  # [T]
    low: Float32Array,  # [3] corner of the first cube
    side: float,
    means: Float32Array,  # [N, 3] out
    outwards: Float32Array,  # [N, 3] out: unit normals
    heads: NDArray[np.int32],  # [C] out: first splat of a cube, or -1
    following: NDArray[np.int32],  # [N] out: next one in the same cube
    facing: NDArray[np.uint8],  # [C] out: where its splats face
) -> None:
    """Sort splats into cubes."""
    for n in range(len(triangle)):
        t = triangle[n]
        for k in range(3):
            total = np.float32(0.0)
            for corner in range(3):
                total += weights[n, corner] * vertices[t, corner, k]
            means[n, k] = total
        out = np.float32(-1.0 if inside[t] > 0 else 1.0)
        x, y = axes[n, 0], axes[n, 1]
        outwards[n, 0] = out * (x[1] * y[2] - x[2] * y[1])
        outwards[n, 1] = out * (x[2] * y[0] - x[0] * y[2])
        outwards[n, 2] = out * (x[0] * y[1] - x[1] * y[0])
        row = _cube(
            math.floor((means[n, 0] - low[0]) / side),
            math.floor((means[n, 1] - low[1]) / side),
            math.floor((means[n, 2] - low[2]) / side),
            len(heads),
        )
        following[n] = heads[row]
        heads[row] = n
        facing[row] |= 63 if inside[t] == 0 else _signs(outwards[n], 1.0)


@numba.njit(cache=True, parallel=True)
def _limit(
    means: Float32Array,  # [N, 3]
    outwards: Float32Array,  # [N, 3]
    turns: NDArray[np.int8],  # [N] ``inside_of`` of its triangle
    low: Float32Array,
    side: float,
    heads: NDArray[np.int32],
    following: NDArray[np.int32],
    facing: NDArray[np.uint8],
    depth: float,
    spacing: float,
    depths: Float32Array,  # [N] out
) -> None:
    """Find how far every splat can sink."""
    beside2 = (_BESIDE_SPACINGS * spacing) ** 2
    reach = depth / _SHARE + _APART_SPACINGS * spacing
    for n in numba.prange(len(means)):
        if turns[n] == 0:
            continue
        x, y, z = means[n, 0], means[n, 1], means[n, 2]
        nx, ny, nz = -outwards[n, 0], -outwards[n, 1], -outwards[n, 2]
        # the 2 x 2 x 2 cubes about the middle of what is searched
        first_x = math.floor((x + 0.5 * reach * nx - low[0]) / side - 0.5)
        first_y = math.floor((y + 0.5 * reach * ny - low[1]) / side - 0.5)
        first_z = math.floor((z + 0.5 * reach * nz - low[2]) / side - 0.5)
        wanted = _signs(outwards[n], -1.0)
        nearest = reach
        for k in range(8):
            row = _cube(first_x + (k & 1), first_y + (k >> 1 & 1), first_z + (k >> 2), len(heads))
            if not facing[row] & wanted:
                continue
            m = heads[row]
            while m >= 0:
                dx, dy, dz = means[m, 0] - x, means[m, 1] - y, means[m, 2] - z
                along = dx * nx + dy * ny + dz * nz
                if -_LEVEL * spacing <= along < nearest:
                    away2 = dx * dx + dy * dy + dz * dz - along * along
                    if away2 < beside2 and m != n:
                        facing_away = (
                            outwards[m, 0] * nx + outwards[m, 1] * ny + outwards[m, 2] * nz
                        )
                        if facing_away > 0.5 or (turns[m] == 0 and facing_away < -0.5):
                            nearest = max(along, 0.0)
                m = following[m]
        depths[n] = min(depth, _SHARE * max(nearest - _APART_SPACINGS * spacing, 0.0))
