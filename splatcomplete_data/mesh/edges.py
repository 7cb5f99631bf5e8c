"""The edges of a triangle soup: borders and folds, which splats must not bulge past; and insides.

Conventions
-----------
* Corners at one place are one vertex, whatever their texture coordinates say.
* An edge is a border when one triangle has it, a fold when the surface turns there by more than an
  angle (180 degrees at a knife's edge); edges of three and more triangles count as folds.
* ``marked_edges`` returns two bit fields per triangle. In the first, bit e marks the edge from
  corner e to corner e + 1; in the second, bit k marks corner k unless flat surface surrounds it.
* Outside is where a triangle's corners run anticlockwise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gscomplete.util.arrays import BoolArray, Float32Array, Float64Array, IntArray

FLAT_DEG = 5.0
"""Two triangles whose planes differ by less belong to one flat surface, such as a cap."""
_ENCLOSED = 0.01
"""A piece of surface with borders has an inside if the volume that it encloses is at least this
share of its area to the power of 3/2 (it is 0.094 for a ball, 0.07 for a box without lid, 0 for a
sheet), ..."""
_BORDER = 0.05
"""... or if a circle as long as its borders has less than this share of its area."""


@dataclass(frozen=True, slots=True)
class Edges:
    """The edges of T triangles. Side 3 t + e is edge e of triangle t."""

    corner: IntArray  # [T, 3] number of the vertex
    order: IntArray  # [3 T] sides, those of one edge beside each other
    starts: IntArray  # [E] where in ``order`` an edge's sides begin
    sizes: IntArray  # [E] number of its sides

    @property
    def pairs(self) -> tuple[IntArray, IntArray]:  # [P], [P]
        """Return both sides of the edges that have two."""
        at = self.starts[self.sizes == 2]
        return self.order[at], self.order[at + 1]

    @property
    def agree(self) -> BoolArray:  # [P]
        """Return which pairs are wound alike: they run along their edge in opposite directions."""
        first, second = self.pairs
        starts: IntArray = self.corner.ravel()
        return starts[first] != starts[second]


def find_edges(vertices: Float32Array) -> Edges:  # [T, 3, 3]
    """Find which sides of triangles are one edge."""
    corner = _merge(vertices.reshape(-1, 3)).reshape(-1, 3)
    following = np.roll(corner, -1, axis=1)
    low, high = np.minimum(corner, following), np.maximum(corner, following)
    key = (low * (int(corner.max()) + 1) + high).ravel()
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    return Edges(corner, order, starts, np.diff(np.append(starts, len(order))))


def marked_edges(
    edges: Edges,
    normals: Float64Array,  # [T, 3] any length
    fold_deg: float,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:  # [T], [T]
    """Mark borders and folds, and the corners that are not surrounded by flat surface.

    Args:
        edges: of the soup.
        normals: one per triangle, of its winding; neighbours may contradict each other.
        fold_deg: angle that the surface turns by at an edge from which it is a fold.
    """
    paired = edges.sizes == 2
    sharp = ~paired
    unit = _unit(normals)
    first, second = edges.pairs
    cosine = np.einsum("pc,pc->p", unit[first // 3], unit[second // 3])
    cosine = np.where(edges.agree, cosine, -cosine)
    sharp[paired] = cosine < np.cos(np.radians(fold_deg))
    bent = sharp.copy()
    bent[paired] |= cosine < np.cos(np.radians(FLAT_DEG))
    flags = np.zeros((2, edges.corner.size), np.bool_)
    flags[:, edges.order] = np.repeat([sharp, bent], edges.sizes, axis=1)
    marks, bends = flags.reshape(2, -1, 3)
    is_end = np.zeros(int(edges.corner.max()) + 1, np.bool_)
    is_end[edges.corner[bends]] = True
    is_end[np.roll(edges.corner, -1, axis=1)[bends]] = True
    return _bits(marks), _bits(is_end[edges.corner])


def inside_of(
    edges: Edges,
    vertices: Float32Array,  # [T, 3, 3]
    normals: Float64Array,  # [T, 3] twice the area long
) -> NDArray[np.int8]:  # [T]
    """Tell on which side of its triangles a surface has its inside.

    Returns:
        -1: behind the triangle (its normal points out). 1: in front of it (it is turned over). 0:
        its piece of surface has no inside (a sheet, or triangles that contradict each other).
    """
    first, second = edges.pairs
    agree = edges.agree
    return _inside_of(vertices.astype(np.float64), normals, first[agree], second[agree])


@numba.njit(cache=True)
def _inside_of(
    vertices: Float64Array,  # [T, 3, 3]
    normals: Float64Array,  # [T, 3]
    first: IntArray,  # [P] sides of triangles that agree
    second: IntArray,  # [P]
) -> NDArray[np.int8]:  # [T]
    """Join triangles to pieces, and tell their sides; see ``inside_of``."""
    count = len(vertices)
    root = np.arange(count)
    is_open = np.ones(3 * count, np.bool_)
    for pair in range(len(first)):
        is_open[first[pair]] = is_open[second[pair]] = False
        one, two = first[pair] // 3, second[pair] // 3
        while root[one] != one:
            root[one] = root[root[one]]
            one = root[one]
        while root[two] != two:
            root[two] = root[root[two]]
            two = root[two]
        root[max(one, two)] = min(one, two)
    area, border, volume = np.zeros(count), np.zeros(count), np.zeros(count)
    middle = np.zeros((count, 3))  # of a piece, times its area
    for t in range(count):
        root[t] = root[root[t]]  # the least of its piece, whose own root is found before
        piece = root[t]
        own = 0.5 * math.sqrt(normals[t, 0] ** 2 + normals[t, 1] ** 2 + normals[t, 2] ** 2)
        area[piece] += own
        for k in range(3):
            middle[piece, k] += (
                own * (vertices[t, 0, k] + vertices[t, 1, k] + vertices[t, 2, k]) / 3.0
            )
        for side in range(3):
            if is_open[3 * t + side]:
                length = 0.0
                for k in range(3):
                    length += (vertices[t, side, k] - vertices[t, (side + 1) % 3, k]) ** 2
                border[piece] += math.sqrt(length)
    for t in range(count):
        piece = root[t]
        for k in range(3):
            away = vertices[t, 0, k] - middle[piece, k] / max(area[piece], 1e-300)
            volume[piece] += away * normals[t, k] / 6.0
    answer = np.zeros(count, np.int8)
    for t in range(count):
        piece = root[t]
        encloses = abs(volume[piece]) > _ENCLOSED * area[piece] ** 1.5
        if encloses or border[piece] ** 2 < _BORDER * 4.0 * math.pi * area[piece]:
            answer[t] = -1 if volume[piece] > 0.0 else 1
    return answer


def _unit(normals: Float64Array) -> Float64Array:
    """Return vectors of length 1, or 0."""
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def _bits(flags: BoolArray) -> NDArray[np.uint8]:  # [T, 3] -> [T]
    """Pack three flags, the first in the lowest bit."""
    return (flags * np.array([1, 2, 4], np.uint8)).sum(axis=1, dtype=np.uint8)


def _merge(points: Float32Array) -> IntArray:  # [M, 3] -> [M]
    """Number the distinct points."""
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    step = max(float((high - low).max()), 1e-30) * 2.0**-20
    grid = np.rint((points - low) / step).astype(np.int64)
    keys = (grid[:, 0] << 42) | (grid[:, 1] << 21) | grid[:, 2]
    return np.unique(keys, return_inverse=True)[1].reshape(-1)
