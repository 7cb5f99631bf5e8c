"""Connected clusters of points: two points are of one cluster if a chain of short steps joins them.

Conventions
-----------
* A step is short if it is no longer than the radius; distances are those of the points themselves.
* Points are gathered in cubes of side radius / sqrt(3), within which any two are near enough. Only
  cubes at most two apart can hold points near enough to each other; of those, only pairs that no
  chain joins yet are compared point by point. So dense clouds cost little more than sparse ones.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from gscomplete.util.arrays import Float64Array, IntArray

_SIDE = (1.0 - 1e-9) / np.sqrt(3.0)
"""Side of a cube over the radius; a little less, so that rounding joins nothing."""


def cluster(points: Float64Array, radius: float) -> IntArray:  # [N, 3] -> [N]
    """Number the connected clusters, largest first.

    Args:
        points: finite points.
        radius: length of the longest step, positive.
    """
    if len(points) == 0:
        return np.zeros(0, np.int64)
    # Floats, because far points of a cloud may be more cubes away than integers can count.
    cubes = np.floor((points - points.min(axis=0)) / (_SIDE * radius))
    order = np.lexsort(cubes.T[::-1])
    cubes = cubes[order]
    is_first = np.ones(len(points), np.bool_)
    is_first[1:] = (cubes[1:] != cubes[:-1]).any(axis=1)
    start = np.append(np.flatnonzero(is_first), len(points))
    parent = np.arange(len(start) - 1)
    _join(np.ascontiguousarray(points[order]), cubes[start[:-1]], start, radius, parent)
    labels = np.empty(len(points), np.int64)
    labels[order] = np.unique(parent, return_inverse=True)[1].reshape(-1)[is_first.cumsum() - 1]
    sizes = np.bincount(labels)
    rank = np.empty(len(sizes), np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return rank[labels]


@numba.njit(cache=True)
def _join(
    points: Any,  # [N, 3] cube by cube
    cubes: Any,  # [C, 3] float64, sorted by x, then y, then z
    start: Any,  # [C + 1] first point of each cube
    radius: float,
    parent: Any,  # [C] each cube's own number; written: the first cube of its cluster
) -> None:
    """Join the cubes of each cluster."""
    count = len(cubes)
    low, high = np.empty((count, 3)), np.empty((count, 3))
    for c in range(count):
        for k in range(3):
            low[c, k] = points[start[c] : start[c + 1], k].min()
            high[c, k] = points[start[c] : start[c + 1], k].max()
    for dx in range(3):
        for dy in range(-2 if dx else 0, 3):
            begin = 0  # of the column (x + dx, y + dy), from z - 2 on: it only moves forward
            for c in range(count):
                x, y, z = cubes[c, 0] + dx, cubes[c, 1] + dy, cubes[c, 2]
                while begin < count and _before(cubes[begin], x, y, z - 2):
                    begin += 1
                other = begin
                while other < count and not _after(cubes[other], x, y, z + 2):
                    known = other <= c or _root(parent, c) == _root(parent, other)
                    if not known and _touch(points, start, low, high, c, other, radius):
                        _unite(parent, c, other)
                    other += 1
    for c in range(count):
        parent[c] = _root(parent, c)


@numba.njit(cache=True)
def _before(cube: Any, x: float, y: float, z: float) -> bool:
    """Whether a cube comes before a place in the order."""
    if cube[0] != x:
        return cube[0] < x
    if cube[1] != y:
        return cube[1] < y
    return cube[2] < z


@numba.njit(cache=True)
def _after(cube: Any, x: float, y: float, z: float) -> bool:
    """Whether a cube comes after a place in the order."""
    if cube[0] != x:
        return cube[0] > x
    if cube[1] != y:
        return cube[1] > y
    return cube[2] > z


@numba.njit(cache=True)
def _root(parent: Any, cube: int) -> int:
    """Return the first cube of the cluster that a cube is known to be of."""
    while parent[cube] != cube:
        parent[cube] = parent[parent[cube]]
        cube = parent[cube]
    return cube


@numba.njit(cache=True)
def _unite(parent: Any, a: int, b: int) -> None:
    """Make two clusters one, named after the cube that comes first."""
    a, b = _root(parent, a), _root(parent, b)
    parent[max(a, b)] = min(a, b)


@numba.njit(cache=True)
def _touch(points: Any, start: Any, low: Any, high: Any, a: int, b: int, radius: float) -> bool:
    """Whether some point of one cube is within the radius of some point of another."""
    limit = radius * radius
    for i in range(start[a], start[a + 1]):
        beyond = 0.0  # squared distance of the point to the box of the other cube's points
        for k in range(3):
            gap = max(low[b, k] - points[i, k], points[i, k] - high[b, k], 0.0)
            beyond += gap * gap
        if beyond > limit:
            continue
        for j in range(start[b], start[b + 1]):
            squared = 0.0
            for k in range(3):
                squared += (points[i, k] - points[j, k]) ** 2
            if squared <= limit:
                return True
    return False
