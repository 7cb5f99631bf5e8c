"""Find holes in thin walls by their rims, and bridge surfaces that continue across a hole.

The inside shows through a hole in a thin wall just as through an intended opening. The rim tells
them apart: about a hole the surface heads for the opposite side of the hole; about the mouth of a
vessel it heads past it.

Conventions
-----------
* The object frame; lengths are in object sizes.
* Nodes are P's points thinned to about one per spacing, on each side of a wall. A node is on a rim
  if its neighbours along the surface leave a wide angle free; the middle of that angle is the
  direction in which the surface would continue.
* Two rim nodes face each other if each one's surface would continue towards the other. A bridge is
  the cubic curve between them that continues both surfaces. Connected bridges form a patch. It is a
  lid if it meets P all round; a patch between two parallel edges, as of slats, is not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.shape.fill.gaps import components
from gscomplete.util.arrays import BoolArray, Float64Array, IntArray

_MOST_WIDE = 0.25
"""Longer bridges are not built."""
_LEAST_SPACING = 0.006
_NEIGHBOURS = 32
_REACH = 2.6
"""Neighbours that tell whether a node is on a rim, in spacings."""
_FREE_ANGLE = 2.3
"""A node is on a rim if its neighbours leave a larger angle free, radians. On a straight grid 1.6
is free, at a straight edge pi."""
_ALIKE = 0.3
"""Least cosine between normals on the same side of a wall."""
_SURE = 0.3
"""Normals at least this long, that is, this sure, have a known sign."""
_TOWARDS = 0.6
"""Least cosine between a bridge and the direction in which the surface would continue."""
_LEAST_GAP = 1.5
"""Shorter bridges are not built, in spacings."""
_LEAST_WIDTH = 3.0
"""Narrower patches are only places where splats are sparse, in spacings."""
_ROUND = 0.15
"""Least ratio of the second moments of bridge directions at a place. Across a hole bridges run in
many directions; stray bridges run in one."""
_NARROW = 0.03
"""A place with a shorter bridge than this may be bridged in one direction only: it is in a slit."""
_STEPS = 12
_MOST_RIM = 6000
_MOST_EDGES = 0.1
"""Largest share of a lid's points that may still be on a rim: a lid meets P all round."""
_LONGEST_EDGE = 0.5
"""Longest free edge of a lid over its width. Between slats the open end is as long as the width."""
_JOINED = 1.8
"""Points this near to each other belong to one patch, in spacings."""
_FEWEST = 6
"""Patches of fewer points are specks of noise."""


@dataclass(frozen=True, slots=True)
class Patch:
    """A connected set of bridges."""

    points: Tensor  # [K, 3]
    normals: Tensor  # [K, 3]
    width: float
    """Length of its longest bridge."""
    narrow: float
    """Median over its places of the shortest bridge there."""
    spacing: float
    """Of its points."""


@dataclass(frozen=True, slots=True)
class _Nodes:
    places: Float64Array  # [N, 3]
    normals: Float64Array  # [N, 3] unit
    is_sure: BoolArray  # [N]
    spacing: float


def bridged(points: Tensor, normals: Tensor, spacing: float) -> list[Patch]:  # [M, 3], [M, 3]
    """Return patches that close holes across which surfaces face each other, the widest first.

    Args:
        points: on the surface, object frame.
        normals: outward, as long as they are sure (0 to 1).
        spacing: of P's splats, object sizes.
    """
    nodes = _thinned(points, normals, max(spacing, _LEAST_SPACING))
    if len(nodes.places) < _FEWEST:
        return []
    rim, onward = _rim(nodes)
    pairs = _facing(nodes, rim, onward)
    if not len(pairs):
        return []
    samples = _curves(nodes, rim, onward, pairs)
    samples = _in_free_space(samples, nodes)
    patches = _patches(samples, nodes.spacing)
    patches = [patch for patch in patches if patch.width >= _LEAST_WIDTH * nodes.spacing]
    return [patch for patch in patches if _meets_all_round(patch, nodes)]


def _meets_all_round(patch: Patch, nodes: _Nodes) -> bool:
    """Tell whether a patch meets P all round; between two slats it would have free edges."""
    reach = 2 * _REACH * nodes.spacing
    places, normals = patch.points.numpy().astype(np.float64), patch.normals.numpy()
    inside = (nodes.places >= places.min(axis=0) - reach).all(axis=1)
    inside &= (nodes.places <= places.max(axis=0) + reach).all(axis=1)
    near = np.flatnonzero(inside)  # in the patch's box: few of all nodes
    near = near[cKDTree(places).query(nodes.places[near], distance_upper_bound=reach)[0] < np.inf]
    together = _Nodes(
        np.concatenate([places, nodes.places[near]]),
        np.concatenate([normals, nodes.normals[near]]).astype(np.float64),
        np.concatenate([np.ones(len(places), np.bool_), nodes.is_sure[near]]),
        nodes.spacing,
    )
    rim, _ = _rim(together)
    edge = places[rim[rim < len(places)]]
    if len(edge) > _MOST_EDGES * len(places):
        return False
    labels = components(edge, _JOINED * nodes.spacing) if len(edge) else np.zeros(0, np.int64)
    longest = max(
        (float(np.ptp(edge[labels == label], axis=0).max()) for label in set(labels)), default=0.0
    )
    return longest <= _LONGEST_EDGE * patch.narrow


def _thinned(points: Tensor, normals: Tensor, spacing: float) -> _Nodes:
    """Reduce the points in every grid cell to their mean, apart for each side of a wall."""
    places, ways = points.numpy().astype(np.float64), normals.numpy().astype(np.float64)
    length = np.linalg.norm(ways, axis=1)
    units = ways / np.maximum(length, 1e-12)[:, None]
    cell, counts = _cells(places, units, spacing)
    sureness = np.bincount(cell, length) / counts
    return _Nodes(
        _means(cell, places, counts), _units(_means(cell, units, counts)), sureness > _SURE, spacing
    )


def _cells(
    places: Float64Array, units: Float64Array, spacing: float
) -> tuple[IntArray, Float64Array]:  # [N], [C]
    """Number the cell of every point, one for each side of a wall, and count their points."""
    axis = np.abs(units).argmax(axis=1)
    side = 2 * axis + (units[np.arange(len(units)), axis] > 0)
    cells = np.column_stack([np.floor(places / spacing).astype(np.int64), side])
    cells -= cells.min(axis=0)
    sizes = cells.max(axis=0) + 1
    if math.prod(sizes.tolist()) < 2**62:
        # one number instead of four: sorted several times as fast, into the same order
        numbers = np.ravel_multi_index(tuple(cells.T), tuple(sizes))
        found = np.unique(numbers, return_inverse=True)[1]
    else:
        found = np.unique(cells, axis=0, return_inverse=True)[1]
    cell = found.reshape(-1).astype(np.int64)
    return cell, np.bincount(cell).astype(np.float64)


def _means(cell: IntArray, values: Float64Array, counts: Float64Array) -> Float64Array:
    """Return the means of rows of every cell."""
    sums = [np.bincount(cell, column, len(counts)) for column in values.T]
    mean: Float64Array = np.stack(sums, axis=1) / counts[:, None]
    return mean


def _units(vectors: Float64Array) -> Float64Array:  # [N, 3]
    """Return vectors of length 1."""
    units: Float64Array = vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)[:, None]
    return units


def _rim(nodes: _Nodes) -> tuple[IntArray, Float64Array]:  # [R], [R, 3]
    """Return the nodes on rims, and the unit directions in which the surface would continue."""
    reach = _REACH * nodes.spacing
    number = min(_NEIGHBOURS, len(nodes.places))
    distance, index = cKDTree(nodes.places).query(
        nodes.places, k=number, distance_upper_bound=reach
    )
    near = np.isfinite(distance) & (distance > 0)
    index = np.where(near, index, 0)
    offsets = nodes.places[index] - nodes.places[:, None]
    heights = np.einsum("nkc,nc->nk", offsets, nodes.normals)
    cosines = np.einsum("nkc,nc->nk", nodes.normals[index], nodes.normals)
    is_signed = nodes.is_sure[index] & nodes.is_sure[:, None]
    near &= np.where(is_signed, cosines, np.abs(cosines)) > _ALIKE
    near &= np.abs(heights) < 0.5 * reach
    first = _units(np.cross(nodes.normals, np.eye(3)[np.abs(nodes.normals).argmin(axis=1)]))
    second = np.cross(nodes.normals, first)
    angles = np.arctan2(
        np.einsum("nkc,nc->nk", offsets, second), np.einsum("nkc,nc->nk", offsets, first)
    )
    angles = np.sort(np.where(near, angles, np.inf), axis=1)
    count = near.sum(axis=1)
    following = np.roll(angles, -1, axis=1)
    rows = np.arange(len(angles))
    last = np.maximum(count - 1, 0)
    following[rows, last] = angles[:, 0] + 2 * np.pi
    free = np.where(
        np.isfinite(angles), following - np.where(np.isfinite(angles), angles, 0.0), -np.inf
    )
    widest = free.argmax(axis=1)
    rim = np.flatnonzero((free[rows, widest] > _FREE_ANGLE) & (count >= 3))
    middle = angles[rim, widest[rim]] + 0.5 * free[rim, widest[rim]]
    onward = np.cos(middle)[:, None] * first[rim] + np.sin(middle)[:, None] * second[rim]
    if len(rim) > _MOST_RIM:
        rows = np.linspace(0, len(rim) - 1, _MOST_RIM).astype(np.int64)
        rim, onward = rim[rows], onward[rows]
    return rim, onward


def _facing(nodes: _Nodes, rim: IntArray, onward: Float64Array) -> IntArray:  # [K, 2] of the rim
    """Return the pairs of rim nodes that face each other across a hole."""
    places, normals = nodes.places[rim], nodes.normals[rim]
    pairs = cKDTree(places).query_pairs(_MOST_WIDE, output_type="ndarray")
    a, b = pairs.T
    along = places[b] - places[a]
    length = np.linalg.norm(along, axis=1)
    along = _units(along)
    cosines = (normals[a] * normals[b]).sum(axis=1)
    is_signed = nodes.is_sure[rim[a]] & nodes.is_sure[rim[b]]
    fits = (onward[a] * along).sum(axis=1) > _TOWARDS
    fits &= -(onward[b] * along).sum(axis=1) > _TOWARDS
    fits &= np.where(is_signed, cosines, np.abs(cosines)) > _ALIKE
    fits &= length > _LEAST_GAP * nodes.spacing
    return pairs[fits].astype(np.int64)


@dataclass(frozen=True, slots=True)
class _Samples:
    """Points on bridges."""

    places: Float64Array  # [S, 3]
    normals: Float64Array  # [S, 3]
    along: Float64Array  # [S, 3] the bridge's direction
    length: Float64Array  # [S] of the bridge

    def select(self, rows: NDArray[np.generic]) -> _Samples:
        return _Samples(self.places[rows], self.normals[rows], self.along[rows], self.length[rows])


def _curves(nodes: _Nodes, rim: IntArray, onward: Float64Array, pairs: IntArray) -> _Samples:
    """Return points on the cubic curves between pairs, without their ends."""
    a, b = pairs.T
    start, end = nodes.places[rim[a]], nodes.places[rim[b]]
    length = np.linalg.norm(end - start, axis=1)
    along = (end - start) / length[:, None]

    def slope(normals: Float64Array) -> Float64Array:
        # the bridge's direction in the plane of the surface, which the curve leaves along
        return _units(along - (along * normals).sum(axis=1)[:, None] * normals) * length[:, None]

    first, second = nodes.normals[rim[a]], nodes.normals[rim[b]]
    second = second * np.where((first * second).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    leaving, arriving = slope(first), slope(second)
    places, normals = [], []
    for step in range(1, _STEPS):
        t = step / _STEPS
        places.append(
            (2 * t**3 - 3 * t**2 + 1) * start
            + (t**3 - 2 * t**2 + t) * leaving
            + (3 * t**2 - 2 * t**3) * end
            + (t**3 - t**2) * arriving
        )
        normals.append((1 - t) * first + t * second)
    return _Samples(
        np.concatenate(places),
        _units(np.concatenate(normals)),
        np.tile(along, (_STEPS - 1, 1)),
        np.tile(length, _STEPS - 1),
    )


def _in_free_space(samples: _Samples, nodes: _Nodes) -> _Samples:
    """Keep the bridges that cross no surface between their ends."""
    per_step = len(samples.places) // (_STEPS - 1)
    middle = slice(per_step * (_STEPS // 4), per_step * (_STEPS - 1 - _STEPS // 4))
    tree = cKDTree(nodes.places)
    distance, index = tree.query(samples.places[middle])
    is_alike = (nodes.normals[index] * samples.normals[middle]).sum(axis=1) > _ALIKE
    is_met = ((distance < nodes.spacing) & (is_alike | ~nodes.is_sure[index])).reshape(-1, per_step)
    return samples.select(np.tile(~is_met.any(axis=0), _STEPS - 1))


def _patches(samples: _Samples, spacing: float) -> list[Patch]:
    """Group the points of bridges into connected patches."""
    if not len(samples.places):
        return []
    cell, counts = _cells(samples.places, samples.normals, spacing)
    places = _means(cell, samples.places, counts)
    normals = _units(_means(cell, samples.normals, counts))
    products = np.einsum("sa,sb->sab", samples.along, samples.along).reshape(-1, 9)
    moments = np.linalg.eigvalsh(_means(cell, products, counts).reshape(-1, 3, 3))
    is_round = moments[:, 1] >= _ROUND * moments[:, 2]
    shortest = np.full(len(counts), np.inf)
    np.minimum.at(shortest, cell, samples.length)
    longest = np.zeros(len(counts))
    np.maximum.at(longest, cell, samples.length)
    kept = np.flatnonzero(is_round | (shortest <= _NARROW))
    places, normals = places[kept], normals[kept]
    longest, shortest = longest[kept], shortest[kept]
    if not len(places):
        return []
    labels = components(places, _JOINED * spacing)
    patches = []
    for label in np.flatnonzero(np.bincount(labels) >= _FEWEST):
        rows = labels == label
        patches.append(
            Patch(
                torch.from_numpy(places[rows]).float(),
                torch.from_numpy(normals[rows]).float(),
                float(longest[rows].max()),
                float(np.median(shortest[rows])),
                spacing,
            )
        )
    return sorted(patches, key=lambda patch: -patch.width)
