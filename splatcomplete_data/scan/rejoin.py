"""Join segments that belong to one object although concave folds separate them.

These are the inner sides of vessels, and small fragments.

Conventions
-----------
* Segments are numbered from 0; each is a set of cubes (``segments``). Normals face the scanner.
* A segment is concave if its normals converge, that is, if the covariance of normals and positions
  has a negative trace. Its bend is that trace over the spreads of both: -1 for the inner half of a
  ball, 0 for a plane, 1 for the outer half.
* Over the near rim of a vessel a scanner sees the far inner side, but nothing that connects it with
  the near outer side. Two such segments belong to one vessel if each faces the inside of the other,
  if the outer one covers the inner one in the scanner's picture, and if they are of similar size
  and near to each other. An object that stands behind another and is partly hidden is not concave.
* A fragment is small compared with the segment it touches, so joining it wrongly does little harm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from gscomplete.util.arrays import BoolArray, Float64Array, IntArray

_SMOOTH_COSINE = 0.7
"""Segments that may be concave and meet at less than 45 degrees count as one inner side."""
_CONCAVE, _CONVEX = -0.4, 0.1
"""Greatest bend of an inner side, and least bend of a segment that cannot be part of one."""
_FEW_CUBES = 50
"""The bend of a segment with fewer cubes (about six patches) is too uncertain to rule it out."""
_LEAST_INNER = 15
"""Least number of cubes in an inner side."""
_MOSTLY = 0.9
"""Least share of a side's cubes that face the inside of the other side."""
_NEAR = 1.0
"""Greatest distance between both sides, in radii of the outer one. They touch at the rim, but a
depth camera loses some pixels at every edge; an object behind is at least a radius away."""
_LARGER = 1.5
"""Greatest radius of the inner side over that of the outer one, so that the corner of a room behind
an object is not taken for its inner side."""
_FRAGMENT = 0.05
"""Largest size of a fragment over that of the segment it joins, and so the largest error."""
_GAP = 2.0
"""Fragments that touch nothing join a segment within this distance, in reaches of neighbours."""


@dataclass(frozen=True, slots=True, eq=False)
class Cubes:
    """The cubes that the points of a cloud are gathered in."""

    means: Float64Array  # [C, 3] means of their points
    normals: Float64Array  # [C, 3]
    counts: Float64Array  # [C] points
    pairs: IntArray  # [P, 2] neighbours
    reach: float
    """Greatest distance between neighbouring cubes, file units."""


def rejoin(labels: IntArray, cubes: Cubes, viewpoint: Float64Array | None) -> IntArray:  # [C], [C]
    """Join inner sides with their vessels, then fragments with the segments that they touch most.

    Args:
        labels: the segment of every cube.
        cubes: positions and normals of the cubes.
        viewpoint: position of the scanner, file frame; None = unknown, and inner sides stay apart.

    Returns:
        The labels after joining.
    """
    labels = np.unique(labels, return_inverse=True)[1].reshape(-1).astype(np.int64)
    if viewpoint is not None:
        labels = _with_inner_sides(labels, cubes, viewpoint)
    return _with_fragments(labels, cubes)


def _with_inner_sides(labels: IntArray, cubes: Cubes, viewpoint: Float64Array) -> IntArray:
    """Give every inner side the label of the outer side in front of it."""
    contacts, lengths, cosines = _contacts(labels, cubes)
    number, sizes = int(labels.max()) + 1, np.bincount(labels)
    bends = bend(cubes, labels)
    may_be_inner = (bends < _CONVEX) | (sizes < _FEW_CUBES)
    smooth = contacts[(cosines / lengths > _SMOOTH_COSINE) & may_be_inner[contacts].all(axis=1)]
    group = _components(number, smooth)
    over = _coverings(cubes, viewpoint)
    joined = []
    for which in np.unique(group[bends < _CONVEX]):
        members = np.flatnonzero((group == which) & may_be_inner)
        inner = np.isin(labels, members)
        if inner.sum() < _LEAST_INNER or bend(cubes, inner.astype(np.int64))[1] > _CONCAVE:
            continue
        covering = labels[over[inner[over[:, 1]] & ~inner[over[:, 0]], 0]]
        if len(covering) == 0:
            continue
        front = int(np.bincount(covering).argmax())
        if 2 * (covering == front).sum() > len(covering) and _is_vessel(
            cubes, labels == front, inner
        ):
            joined += [(front, int(member)) for member in members]
    return _components(number, np.array(joined, np.int64).reshape(-1, 2))[labels]


def _is_vessel(cubes: Cubes, outer: BoolArray, inner: BoolArray) -> bool:
    """Tell whether two sides face each other's inside, are of similar size and near each other."""
    a, b = cubes.means[outer], cubes.means[inner]
    inwards = ((a.mean(axis=0) - b) * cubes.normals[inner]).sum(axis=1) > 0
    outwards = ((a - b.mean(axis=0)) * cubes.normals[outer]).sum(axis=1) > 0
    if inwards.mean() < _MOSTLY or outwards.mean() < _MOSTLY:
        return False
    radius = _radius(a)
    near = float(cKDTree(a).query(b)[0].min())
    return near <= _NEAR * radius and _radius(b) <= _LARGER * radius


def _radius(places: Float64Array) -> float:  # [K, 3]
    """Return the root mean square distance to the mean."""
    return float(np.sqrt(np.square(places - places.mean(axis=0)).sum(axis=1).mean()))


def bend(cubes: Cubes, labels: IntArray) -> Float64Array:  # [C] -> [labels]
    """Return how concave (-1) or convex (1) every set of cubes is."""
    counts = np.bincount(labels).astype(np.float64)
    places = cubes.means - _sums(labels, cubes.means)[labels] / counts[labels, None]
    normals = cubes.normals - _sums(labels, cubes.normals)[labels] / counts[labels, None]
    squares = np.stack([np.square(places).sum(axis=1), np.square(normals).sum(axis=1)], axis=1)
    spreads = np.sqrt(_sums(labels, squares).prod(axis=1))
    trace = _sums(labels, (places * normals).sum(axis=1)[:, None])[:, 0]
    bends: Float64Array = np.where(spreads > 0, trace / np.maximum(spreads, 1e-300), 0.0)
    return bends


def _sums(labels: IntArray, values: Float64Array) -> Float64Array:  # [C], [C, K] -> [labels, K]
    """Return the sum of the rows of every label."""
    return np.stack([np.bincount(labels, column) for column in values.T], axis=1)


def _coverings(cubes: Cubes, viewpoint: Float64Array) -> IntArray:  # [K, 2] front, back
    """Return the pairs of cubes that are neighbours in the scanner's picture but not in space."""
    rays = cubes.means - viewpoint
    depths = np.linalg.norm(rays, axis=1)
    angle = cubes.reach / max(float(np.median(depths)), 1e-300)
    rays /= np.maximum(depths, 1e-300)[:, None]
    pairs = cKDTree(rays).query_pairs(angle, output_type="ndarray")
    pairs = pairs[np.abs(depths[pairs[:, 0]] - depths[pairs[:, 1]]) > cubes.reach]
    is_swapped = depths[pairs[:, 0]] > depths[pairs[:, 1]]
    pairs[is_swapped] = pairs[is_swapped][:, ::-1]
    return pairs.astype(np.int64)


def _with_fragments(labels: IntArray, cubes: Cubes) -> IntArray:
    """Give every fragment the label of the segment that it touches most, or that is nearest."""
    contacts, lengths, _ = _contacts(labels, cubes)
    sizes = np.bincount(labels, cubes.counts)
    # Candidates (fragment, host, merit): the longest contact with a larger segment comes first,
    # and for segments that touch nothing larger the nearest host.
    is_up = sizes[contacts[:, 0]] < sizes[contacts[:, 1]]
    touching = np.where(is_up[:, None], contacts, contacts[:, ::-1])
    near, distances = _nearby(labels, cubes, np.setdiff1d(np.arange(len(sizes)), touching[:, 0]))
    ends = np.concatenate([touching, near])
    merit = np.concatenate([lengths, -distances])
    order = np.lexsort((-sizes[ends[:, 1]], -merit, ends[:, 0]))
    best = ends[order[np.flatnonzero(np.diff(ends[order, 0], prepend=-1))]]
    joined = best[sizes[best[:, 0]] <= _FRAGMENT * sizes[best[:, 1]]]
    return _components(len(sizes), joined)[labels]


def _nearby(
    labels: IntArray, cubes: Cubes, loose: IntArray
) -> tuple[IntArray, Float64Array]:  # [K, 2], [K]
    """Return pairs of a loose segment and a segment it may be a fragment of, with distances."""
    sizes = np.bincount(labels, cubes.counts)
    own = np.flatnonzero(np.isin(labels, loose))
    if len(own) == 0:
        return np.zeros((0, 2), np.int64), np.zeros(0)
    near = cKDTree(cubes.means[own]).sparse_distance_matrix(
        cKDTree(cubes.means), _GAP * cubes.reach, output_type="coo_matrix"
    )
    ends = np.column_stack([labels[own[near.row]], labels[near.col]]).astype(np.int64)
    may_be = sizes[ends[:, 0]] <= _FRAGMENT * sizes[ends[:, 1]]
    return ends[may_be], np.asarray(near.data, np.float64)[may_be]


def _contacts(labels: IntArray, cubes: Cubes) -> tuple[IntArray, Float64Array, Float64Array]:
    """Return the pairs of segments that touch [K, 2], and for each two sums over pairs of cubes.

    These are the number of neighbouring cubes and the sum of the cosines between their normals.
    """
    ends = labels[cubes.pairs]
    differ = ends[:, 0] != ends[:, 1]
    if not differ.any():
        return np.zeros((0, 2), np.int64), np.zeros(0), np.zeros(0)
    first, second = cubes.pairs[differ].T
    cosines = (cubes.normals[first] * cubes.normals[second]).sum(axis=1)
    contacts, which = np.unique(np.sort(ends[differ], axis=1), axis=0, return_inverse=True)
    which = which.reshape(-1)
    lengths = np.bincount(which).astype(np.float64)
    sums = np.bincount(which, cosines).astype(np.float64)
    return contacts.astype(np.int64), lengths, sums


def _components(number: int, pairs: IntArray) -> IntArray:  # [number]
    """Number the components of a graph."""
    graph = sparse.csr_matrix((np.ones(len(pairs)), pairs.T), shape=(number, number))
    found: IntArray = csgraph.connected_components(graph, directed=False)[1].astype(np.int64)
    return found
