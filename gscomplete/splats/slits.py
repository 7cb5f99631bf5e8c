"""Slits between the samples of a scan, closed by additional samples.

Where a surface leans away from the camera, the samples of neighbouring pixels are far apart in
space, all the more because depths are quantised; seen from another side, P has slits between them.
Two samples belong to one surface if they are near each other, no other sample lies between, and the
camera sees hardly any gap: they are neighbours in its picture, or nearly so and the line between
them runs along the surface. A gap that the camera does see is real, as between the bars of a rack.

Conventions
-----------
* Lengths are in spacings: the median distance of samples from their nearest neighbours.
* Where the camera was is known to a few degrees, so limits across its rays have some room.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gscomplete.splats.geometry.nearest import query_nearest
from gscomplete.splats.geometry.neighbourhood import normals_of
from gscomplete.splats.record import Splats, colors_to_sh
from gscomplete.util.arrays import Float64Array

_ROUND = 0.5
"""P is a scan if its splats are round, the smallest standard deviation being at least this share of
the largest, ..."""
_EVEN_QUANTILES, _MOST_UNEVEN = (0.05, 0.95), 2.2
"""... and evenly spaced: these quantiles of the distances between neighbours differ by at most this
factor. It is 1.1 to 2.0 for 11 captures and scans of SplatComplete-open, and at least 22 for
trained captures."""
_FEWEST = 100
_NEIGHBOURS = 32
_LEAST, _MOST = 1.3, 5.0
"""Least and largest distance of samples with a slit between them: nearer ones leave no slit, and
steps in depth are seldom larger."""
_LARGEST = 0.05
"""Largest width of a slit, in sides of P's box; wider ones may be gaps of the object."""
_BESIDE, _NEARLY_BESIDE = 1.5, 2.5
"""Largest distance across the camera's rays of neighbours in its picture, and of near
neighbours."""
_ALONG = 0.5
"""A line runs along the surface if the cosine between it and the normal is at most this ..."""
_PARALLEL = 0.7
"""... and that between the normals at its ends at least this."""
_BETWEEN = 0.98
_COVERED = 0.7
"""A place between samples is covered from this opacity on."""
_COVERING = 8
"""Nearest samples that this opacity is summed over."""
_APART = 0.85
_SIGMA = 0.5
"""Standard deviation of a new sample; .6 closes no more and changes P's pictures by a quarter
more."""
_COLOR_NEIGHBOURS = 4


@dataclass(frozen=True, slots=True)
class _Samples:
    """Splats and their nearest neighbours."""

    points: Float64Array  # [N, 3]
    tree: cKDTree
    distance: Float64Array  # [N, K]
    index: NDArray[np.intp]  # [N, K]

    @property
    def spacing(self) -> float:
        """Median distance from the nearest neighbour."""
        return float(np.median(self.distance[:, 0]))


def slit_splats(
    partial: Splats,
    eye: Float64Array,  # [3] in the frame of P
) -> Splats:
    """Return the samples that close P's slits; none if P is not a scan.

    Args:
        partial: P.
        eye: approximate position that P was scanned from.
    """
    nothing = partial.with_sh_degree(0).select(torch.arange(0))
    samples = _samples_of(partial)
    if samples is None:
        return nothing
    points = _between(samples, *_ends(samples, eye))
    points = points[_opacity_at(points, partial, samples.tree) < _COVERED]
    points = _thinned(points, _APART * samples.spacing)
    if not len(points):
        return nothing
    return _like(partial, points, samples)


def _samples_of(partial: Splats) -> _Samples | None:
    """Return P's splats if they are samples of a scan, round and evenly spaced; None if not."""
    if len(partial) < _FEWEST:
        return None
    scales = partial.scales
    roundness = scales.amin(dim=1) / scales.amax(dim=1).clamp_min(1e-30)
    if float(roundness.median()) < _ROUND:
        return None
    points = partial.means.double().numpy()
    tree = cKDTree(points)
    nearest, _ = query_nearest(tree, points, [2])  # the first is each itself
    low, high = np.quantile(nearest, _EVEN_QUANTILES)
    if not 0 < high <= _MOST_UNEVEN * low:
        return None
    distance, index = query_nearest(tree, points, range(2, _NEIGHBOURS + 2))
    return _Samples(points, tree, distance, index)


def _ends(
    samples: _Samples,
    eye: Float64Array,  # [3]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:  # [S], [S]
    """Return the pairs of samples with a slit between them."""
    points, spacing = samples.points, samples.spacing
    longest = min(_MOST * spacing, _LARGEST * float(np.ptp(points, axis=0).max()))
    is_near = (samples.distance > _LEAST * spacing) & (samples.distance <= longest)
    start, place = is_near.nonzero()
    end = samples.index[start, place]
    pairs = np.sort(np.minimum(start, end) * len(points) + np.maximum(start, end))
    first, second = np.divmod(pairs[np.diff(pairs, prepend=-1) > 0], len(points))

    line = points[second] - points[first]
    middle = (points[first] + points[second]) / 2
    ray = middle - eye
    along = _dot(line, ray) / np.sqrt(_dot(ray, ray))
    length = np.sqrt(_dot(line, line))
    across = np.sqrt((length**2 - along**2).clip(0)) / spacing
    kept = across < _NEARLY_BESIDE
    nearest, _ = query_nearest(samples.tree, middle[kept])
    kept[kept] = nearest >= _BETWEEN * length[kept] / 2
    first, second, across = first[kept], second[kept], across[kept]
    line = line[kept] / length[kept, None]

    ends, place = np.unique(np.concatenate([first, second]), return_inverse=True)
    normals = normals_of(points[samples.index[ends]])
    one, other = normals[place].reshape(2, -1, 3)
    runs_along = np.maximum(np.abs(_dot(one, line)), np.abs(_dot(other, line))) < _ALONG
    runs_along &= np.abs(_dot(one, other)) > _PARALLEL
    belong = runs_along | (across < _BESIDE)
    return first[belong], second[belong]


def _dot(a: Float64Array, b: Float64Array) -> Float64Array:
    return np.einsum("...i,...i->...", a, b)


def _between(
    samples: _Samples,
    first: NDArray[np.intp],  # [S]
    second: NDArray[np.intp],  # [S]
) -> Float64Array:  # [M, 3]
    """Return places on the lines between samples, about a spacing apart."""
    start, end = samples.points[first], samples.points[second]
    length = np.linalg.norm(end - start, axis=1)
    counts = np.maximum(np.rint(length / samples.spacing).astype(np.intp) - 1, 1)
    line = np.repeat(np.arange(len(counts)), counts)
    step = np.arange(len(line)) - np.repeat(counts.cumsum() - counts, counts) + 1
    share = (step / (counts[line] + 1))[:, None]
    return (1 - share) * start[line] + share * end[line]


def _opacity_at(
    points: Float64Array,  # [M, 3]
    partial: Splats,
    tree: cKDTree,
) -> Float64Array:  # [M]
    """Return the sum of the opacities of P's splats at places, as if they were balls."""
    distance, index = query_nearest(tree, points, range(1, _COVERING + 1))
    sigmas = partial.scales.double().mean(dim=1).clamp_min(1e-12).numpy()[index]
    falloff = np.exp(-0.5 * (distance / sigmas) ** 2)
    return np.einsum("mk,mk->m", partial.opacities.double().numpy()[index], falloff)


def _thinned(points: Float64Array, side: float) -> Float64Array:  # [M, 3] -> [K, 3]
    """Keep one place of every grid cell."""
    cells = np.floor(points / side).astype(np.int64)
    _, kept = np.unique(cells, axis=0, return_index=True)
    return points[kept]


def _like(partial: Splats, points: Float64Array, samples: _Samples) -> Splats:
    """Return splats of the samples' size, in the colours of the samples about them."""
    distance, index = query_nearest(samples.tree, points, range(1, _COLOR_NEIGHBOURS + 1))
    weights = 1 / (distance + 1e-3 * samples.spacing)
    weights /= weights.sum(axis=1, keepdims=True)
    colors = (partial.base_colors.double().numpy()[index] * weights[..., None]).sum(axis=1)
    count = len(points)
    return Splats(
        torch.from_numpy(points).float(),
        torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        torch.full((count, 3), _SIGMA * samples.spacing),
        partial.opacities.median().expand(count).clone(),
        colors_to_sh(torch.from_numpy(colors).float().clamp(0.0, 1.0)),
    )
