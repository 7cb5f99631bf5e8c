"""Separate objects that touch, along the concave folds in which their surfaces meet.

Convex parts are joined and concave contacts are cut, as in "Object Partitioning using Local
Convexity" (Stein et al., CVPR 2014). Here the most convex contacts are joined first, and a contact
is scored over its whole length, so that a few noisy normals do not join two objects.

Conventions
-----------
* Lengths are multiples of the cloud's spacing unless their name ends in ``_file``.
* Points are gathered in cubes, and cubes in patches of similar normal and colour. The normal of a
  cube is the least principal axis of the points about it. It faces the scanner, or upwards and
  outwards if the scanner's position is unknown.
* A contact's score is 1 if it is flat or convex, and falls with the angle of a concave one and with
  the difference in colour. Patches join while the score of their contact is above a threshold.
* Inner sides of vessels, and fragments, are joined again afterwards (``rejoin``).
* Which points belong to an object is decided by a vote over several sizes of cubes and patches.
"""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from gscomplete.util.arrays import BoolArray, Float64Array, IntArray
from splatcomplete_data.scan.rejoin import Cubes, rejoin

_FOLD_DEG = 15.0
"""Concave angle between two patches at which their contact's score is 0."""
_COLOR_WEIGHT = 1.0
"""Loss of score per unit (sRGB) by which two patches' colours differ beyond ``_LIKE_COLORS``."""
_LEAST_CONTACT = -0.3
"""Patches whose contact has a lower score stay apart."""


# Chosen on nine labelled table-top scenes (docs/benchmarks/dataset.md).
VOTES = ((3.7, 11.0), (4.3, 12.3), (4.9, 12.3), (4.3, 14.8), (4.0, 13.5))
"""For every vote the sides of cubes and of patches, in spacings."""
_NORMAL_REACH = 2.5
"""Radius about a cube in which its normal is measured, in sides of a cube."""
_STEP = 1.9
"""Cubes whose points' means are at most this far apart are neighbours, in sides of a cube."""
_NORMAL_COST, _COLOR_COST = 1.0, 0.5
"""Cost of a difference in normals (1 - cosine) and in colours (sRGB) on a step from cube to cube,
in addition to its length in sides of a patch."""
_LIKE_COLORS = 0.15
_MOSTLY = 0.5
"""An object is a neighbour if boxes hold a smaller share of its points than this."""
_ALMOST_ALL, _LARGE, _CUT = 0.95, 0.25, 0.9
"""If boxes hold more than the first share of the object they are drawn around, another object that
has more than the second of its points inside is already a neighbour if less than the third share of
it is inside. Smaller ones are left: they may be a handle that the boxes cut."""
_LEAST_SCORE = -3.0
"""Lowest score of a contact, so that a few very concave places do not decide alone."""


def object_at(
    points: Float64Array,  # [N, 3]
    colors: NDArray[np.floating],  # [N, 3] sRGB
    seed: Float64Array,  # [3]
    spacing_file: float,
    *,
    viewpoint: Float64Array | None = None,  # [3]
    up: Float64Array | None = None,  # [3]
) -> BoolArray:  # [N]
    """Mark the points of the object that the point nearest to ``seed`` belongs to.

    Args:
        points: finite points, without the planes that the objects stand on.
        colors: the points' colours.
        seed: a place on the object.
        spacing_file: the cloud's spacing, file units.
        viewpoint: position of the scanner; None = unknown.
        up: the up direction, which orients normals if the viewpoint is unknown; None = +z.
    """
    nearest = int(np.square(points - seed).sum(axis=1).argmin())
    votes = np.zeros(len(points), np.int64)
    for size in VOTES:
        labels = segment(points, colors, spacing_file, size, viewpoint=viewpoint, up=up)
        votes += labels == labels[nearest]
    return votes > len(VOTES) / 2


def beyond_boxes(
    points: Float64Array,  # [N, 3]
    colors: NDArray[np.floating],  # [N, 3] sRGB
    is_inside: BoolArray,  # [N]
    spacing_file: float,
    *,
    viewpoint: Float64Array | None = None,
    up: Float64Array | None = None,
) -> BoolArray:  # [N]
    """Mark the points of objects other than the one that the boxes are drawn around.

    That one has the most points inside, those outside subtracted. Another object is marked if most
    of it lies outside. If almost all of the boxes' own object lies inside, a large other object is
    marked even if only some of it lies outside.

    Args:
        points: finite points of the complete scene, without the planes that the objects stand on.
        colors: the points' colours.
        is_inside: mask of the points that the boxes keep.
        spacing_file: the cloud's spacing, file units.
        viewpoint: position of the scanner; None = unknown.
        up: as for ``object_at``.
    """
    votes = np.zeros(len(points), np.int64)
    for size in VOTES:
        labels = segment(points, colors, spacing_file, size, viewpoint=viewpoint, up=up)
        inside, total = (
            np.bincount(labels[is_inside], minlength=labels.max() + 1),
            np.bincount(labels),
        )
        own = int((2 * inside - total).argmax())
        is_beyond = inside < _MOSTLY * total
        if inside[own] > _ALMOST_ALL * total[own]:
            is_large = inside > _LARGE * inside[own]
            is_beyond |= is_large & (inside < _CUT * total)
        is_beyond[own] = False
        votes += is_beyond[labels]
    return votes > len(VOTES) / 2


def segment(
    points: Float64Array,  # [N, 3]
    colors: NDArray[np.floating],  # [N, 3] sRGB
    spacing_file: float,
    size: tuple[float, float],
    *,
    viewpoint: Float64Array | None = None,
    up: Float64Array | None = None,
) -> IntArray:  # [N]
    """Number the objects that concave folds separate, the largest first.

    Args:
        points: finite points, without the planes that the objects stand on.
        colors: the points' colours.
        spacing_file: the cloud's spacing, file units.
        size: sides of cubes and of patches, in spacings.
        viewpoint: position of the scanner; None = unknown.
        up: as for ``object_at``.
    """
    side, patch_side = size[0] * spacing_file, size[1] * spacing_file
    cube, means, hues, counts = _cubes(points, colors, side)
    pairs = cKDTree(means).query_pairs(_STEP * side, output_type="ndarray")
    normals = _normals(means, counts, _NORMAL_REACH * side)
    _turn_normals(normals, means, pairs, viewpoint, up)
    patch = _patches(means, hues, normals, pairs, patch_side)
    joined = _join(patch, pairs, means, hues, normals, counts)
    cubes = Cubes(means, normals, counts, pairs, _STEP * side)
    labels = rejoin(joined[patch], cubes, viewpoint)[cube]
    sizes = np.bincount(labels)
    rank = np.empty(len(sizes), np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return rank[labels]


def _cubes(
    points: Float64Array, colors: NDArray[np.floating], side: float
) -> tuple[IntArray, Float64Array, Float64Array, Float64Array]:  # [N], [C, 3], [C, 3], [C]
    """Gather points in cubes; return each point's cube, and every cube's mean, colour and count."""
    cells = np.floor((points - points.min(axis=0)) / side)
    cube = np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    counts = np.bincount(cube).astype(np.float64)
    return cube, _mean(cube, points, counts), _mean(cube, colors, counts), counts


def _mean(
    groups: IntArray, values: NDArray[np.floating], weights: NDArray[np.generic]
) -> Float64Array:
    """Return the sums of rows per group, divided by ``weights`` [G]."""
    sums = [np.bincount(groups, values[:, axis], len(weights)) for axis in range(values.shape[1])]
    mean: Float64Array = np.stack(sums, axis=1) / np.asarray(weights, np.float64)[:, None]
    return mean


def _normals(means: Float64Array, counts: Float64Array, reach: float) -> Float64Array:  # [C, 3]
    """Return the least principal axis of the points about every cube."""
    tree = cKDTree(means)
    near = tree.query_pairs(reach, output_type="ndarray")
    here = np.concatenate([near[:, 0], near[:, 1], np.arange(len(means))])
    there = np.concatenate([near[:, 1], near[:, 0], np.arange(len(means))])
    weights = sparse.csr_matrix((counts[there], (here, there)), shape=(len(means),) * 2)
    total = np.asarray(weights.sum(axis=1)).reshape(-1)
    local = means - means.mean(axis=0)
    middle = (weights @ local) / total[:, None]
    products = np.einsum("ca,cb->cab", local, local).reshape(-1, 9)
    spread = ((weights @ products) / total[:, None]).reshape(-1, 3, 3)
    spread -= np.einsum("ca,cb->cab", middle, middle)
    axes: Float64Array = np.linalg.eigh(spread)[1][:, :, 0]
    return axes


def _turn_normals(
    normals: Float64Array,  # [C, 3] changed
    means: Float64Array,
    pairs: IntArray,
    viewpoint: Float64Array | None,
    up: Float64Array | None,
) -> None:
    """Orient normals towards the scanner or, if its position is unknown, consistently outwards.

    Without a scanner the highest cube of every connected piece faces up. Orientation then spreads
    from cube to cube, first along the steps that best fit an arc of a circle, whose normals at both
    ends are mirror images of each other in the plane that bisects the chord (Xie et al., "Piecewise
    C1 continuous surface reconstruction", 2003).
    """
    if viewpoint is not None:
        normals *= np.where(((viewpoint - means) * normals).sum(axis=1) < 0, -1.0, 1.0)[:, None]
        return
    upward = np.array([0.0, 0.0, 1.0]) if up is None else up
    a, b = pairs.T
    cost = 1.0 - np.abs((_mirrored(normals[a], means[b] - means[a]) * normals[b]).sum(axis=1))
    cost = np.maximum(cost, 0.0) + 1e-6  # a sparse matrix drops what is 0
    graph = sparse.csr_matrix((cost, (a, b)), shape=(len(means),) * 2)
    tree = csgraph.minimum_spanning_tree(graph)
    _, piece = csgraph.connected_components(tree, directed=False)
    order = np.lexsort((-(means @ upward), piece))
    for first in order[np.flatnonzero(np.diff(piece[order], prepend=-1))]:
        if normals[first] @ upward < 0:
            normals[first] *= -1
        nodes, before = csgraph.breadth_first_order(tree, first, directed=False)
        for node in nodes[1:]:
            origin = before[node]
            expected = _mirrored(normals[origin, None], (means[node] - means[origin])[None])[0]
            if normals[node] @ expected < 0:
                normals[node] *= -1


def _mirrored(
    normals: Float64Array, chords: Float64Array
) -> Float64Array:  # [K, 3], [K, 3] -> [K, 3]
    """Mirror normals in the planes perpendicular to chords."""
    unit = chords / np.maximum(np.linalg.norm(chords, axis=1, keepdims=True), 1e-300)
    mirrored: Float64Array = normals - 2.0 * (normals * unit).sum(axis=1, keepdims=True) * unit
    return mirrored


def _patches(
    means: Float64Array, hues: Float64Array, normals: Float64Array, pairs: IntArray, side: float
) -> IntArray:  # [C]
    """Gather cubes in patches about seeds; each cube joins the nearest seed along the surface."""
    a, b = pairs.T
    steps = sparse.csr_matrix((np.ones(len(pairs)), (a, b)), shape=(len(means),) * 2)
    piece = csgraph.connected_components(steps, directed=False)[1]
    cells = np.floor((means - means.min(axis=0)) / side)
    # Disconnected pieces that share a cell get a seed each, else one of them would have no seed.
    keys = np.column_stack([cells, piece])
    cell = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    middle = _mean(cell, means, np.bincount(cell))
    off = np.square(means - middle[cell]).sum(axis=1)
    order = np.lexsort((off, cell))
    seeds = np.sort(order[np.flatnonzero(np.diff(cell[order], prepend=-1))])
    cost = np.linalg.norm(means[b] - means[a], axis=1) / side
    cost += _NORMAL_COST * (1.0 - np.clip((normals[a] * normals[b]).sum(axis=1), -1, 1))
    cost += _COLOR_COST * np.linalg.norm(hues[a] - hues[b], axis=1)
    graph = sparse.csr_matrix((cost, (a, b)), shape=(len(means),) * 2)
    _, _, sources = csgraph.dijkstra(
        graph, directed=False, indices=seeds, min_only=True, return_predecessors=True
    )
    return np.searchsorted(seeds, sources).astype(np.int64)


def _join(
    patch: IntArray,  # [C]
    pairs: IntArray,  # [P, 2]
    means: Float64Array,
    hues: Float64Array,
    normals: Float64Array,
    counts: Float64Array,
) -> IntArray:  # [patches]
    """Join patches while contacts are convex enough; return the object of every patch."""
    number = int(patch.max()) + 1
    weight = np.bincount(patch, counts, number)
    middle = _mean(patch, counts[:, None] * means, weight)
    hue = _mean(patch, counts[:, None] * hues, weight)
    normal = _mean(patch, counts[:, None] * normals, weight)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    ends = np.sort(patch[pairs], axis=1)
    ends = ends[ends[:, 0] != ends[:, 1]]
    contacts, lengths = np.unique(ends, axis=0, return_counts=True)
    if len(contacts) == 0:
        return np.arange(number)
    i, j = contacts.T
    along = middle[j] - middle[i]
    angle = np.degrees(np.arccos(np.clip((normal[i] * normal[j]).sum(axis=1), -1, 1)))
    is_concave = ((normal[j] - normal[i]) * along).sum(axis=1) < 0
    score = np.where(is_concave, 1.0 - angle / _FOLD_DEG, 1.0)
    unlike = np.linalg.norm(hue[i] - hue[j], axis=1) - _LIKE_COLORS
    score -= _COLOR_WEIGHT * np.maximum(unlike, 0.0)
    return _agglomerate(number, contacts, np.clip(score, _LEAST_SCORE, 1.0), lengths)


def _agglomerate(
    number: int,
    contacts: IntArray,  # [K, 2]
    scores: Float64Array,  # [K]
    lengths: IntArray,  # [K]
) -> IntArray:  # [number]
    """Repeatedly join the pair whose contact has the best mean score; return roots."""
    near: list[dict[int, tuple[float, float]]] = [{} for _ in range(number)]
    for (a, b), score, length in zip(contacts.tolist(), scores, lengths, strict=True):
        near[a][b] = near[b][a] = (float(score * length), float(length))
    version = [0] * number
    parent = list(range(number))
    heap = [
        (-score, a, b, 0, 0)
        for (a, b), score in zip(contacts.tolist(), scores.tolist(), strict=True)
    ]
    heapq.heapify(heap)
    while heap:
        minus_score, a, b, version_a, version_b = heapq.heappop(heap)
        if (version[a], version[b]) != (version_a, version_b):
            continue
        if -minus_score < _LEAST_CONTACT:
            break
        parent[b] = a
        version[a] += 1
        version[b] = -1
        for other, (score, length) in near[b].items():
            del near[other][b]
            if other == a:
                continue
            before = near[a].get(other, (0.0, 0.0))
            near[a][other] = near[other][a] = (before[0] + score, before[1] + length)
        near[b] = {}
        for other, (score, length) in near[a].items():
            heapq.heappush(heap, (-score / length, a, other, version[a], version[other]))
    roots = np.empty(number, np.int64)
    for place in range(number):
        root = place
        while parent[root] != root:
            root = parent[root]
        roots[place] = root
    return roots
