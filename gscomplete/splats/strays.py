"""Find P's strays, splats that float beside the object's surface, with a small network.

A depth camera leaves flying points behind the edges of what it sees, a trained capture floaters,
haze, and large splats behind the surface where no photo looks. Each of them passes for surface when
the object is guessed: it fills a cell of the grid, hides what is behind it, and widens the frame.
Where splats are sparse, those of a surface still lie on one, and next to others like them. The
scorer has learned this from parts of meshes that strays were added to, and from captures trained on
rendered photos of meshes (``recipes/train_embedded_prior``).

Conventions
-----------
* Scores are log odds. Nothing depends on the frame of the splats or on its unit.
* Only splats that stand out are scored: those in sparse places, nearly transparent or large ones.
  Ranks of neighbours start at 1, and a splat is not its own neighbour.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.networks.packaged import PACKAGED_WEIGHTS
from gscomplete.networks.perceptron import Perceptron
from gscomplete.splats.geometry.nearest import query_nearest
from gscomplete.splats.geometry.neighbourhood import FLAT
from gscomplete.splats.record import Splats
from gscomplete.splats.rotations import thinnest_axes
from gscomplete.util.arrays import Float32Array, Float64Array

STRAY_SCORER_FILE = "strays.safetensors"
STRAY_FROM = 0.0
"""A splat is a stray if its score is higher, and P has strays."""
_SURE_FROM, _FEWEST_SURE = 2.0, 0.002
"""P has strays if at least this share of its splats scores higher than the first. In a sound P, the
few that do are surface that a scanner saw only in places: without it guesses are worse."""
_MOST = 0.5
"""If a larger share would be strays, they are what P consists of, and none is."""
_FEWEST = 200
"""Smaller sets have no strays: too few splats to tell what is usual."""
_RANKS = (1, 2, 4, 8, 16, 32)
"""Ranks of the neighbours whose distances are features."""
_OUTLYING_RANKS = (4, 8, 16)
"""Ranks whose distances are also compared with what neighbours have."""
_RANK = 8
"""Rank whose distance tells how sparse a place is."""
_ABOUT = 16
"""So many neighbours are the surroundings of a splat."""
SPARSE, FAINT, LARGE = 1.5, 0.5, 1.2
"""A splat stands out if it is so many times as sparse as the median splat, less opaque than such a
share of the median, or so many times as large."""
_DENSE_QUANTILE = 0.05
_REACH_SIGMAS = 3.0
"""A splat is drawn up to about this many standard deviations from its centre."""
_TINY, _MOST_LOG = 1e-12, 6.0
"""Logarithms are clamped to the second: beyond it the scorer has seen nothing, and what is so far
from others is a stray."""
FEATURES = (
    *(f"distance_{rank}" for rank in _RANKS),  # over the median of rank 8; logarithms, as the next
    *(f"outlying_{rank}" for rank in _OUTLYING_RANKS),  # over the median of the surroundings
    "sparse",  # distance of rank 8 over that in the densest places
    "standing_out",  # share of the surroundings that stand out, too; no logarithm
    "thickness",  # of the surroundings: smallest over middle variance
    "slenderness",  # middle over largest variance
    "off_surface",  # distance from their plane, in standard deviations
    "off_middle",  # distance from their middle over that of rank 16
    "size",  # largest standard deviation over the median splat's
    "flatness",  # smallest over largest standard deviation
    "reach",  # distance of rank 8 over how far both splats reach
    "opacity",  # in [0, 1], and so the next two
    "opacity_above_usual",
    "opacity_above_others",
    "color",  # largest difference from the surroundings' mean
    "facing",  # cosine between its normal and the surroundings', .5 for round splats
    "alike",  # mean cosine between its normal and its neighbours'
)


@functools.cache
def packaged_stray_scorer() -> Perceptron:
    """Return the network that ships with the package."""
    return Perceptron.load(PACKAGED_WEIGHTS / STRAY_SCORER_FILE, len(FEATURES))


def stray_rows(splats: Splats) -> Tensor:  # [N] bool
    """Mark the strays of a set.

    Args:
        splats: N splats in any frame that can be drawn (``filters.usable_rows``).
    """
    is_stray = torch.zeros(len(splats), dtype=torch.bool)
    found = standing_out(splats)
    if len(found.rows):
        is_far = found.features[:, FEATURES.index(f"distance_{_RANK}")] >= _MOST_LOG
        scores = np.where(is_far, np.inf, packaged_stray_scorer()(found.features))
        rows = found.rows[scores > STRAY_FROM]
        has_some = (scores > _SURE_FROM).sum() >= _FEWEST_SURE * len(splats)
        if has_some and len(rows) <= _MOST * len(splats):
            is_stray[torch.from_numpy(rows)] = True
    return is_stray.to(splats.means.device)


@dataclass(frozen=True, slots=True)
class StandingOut:
    """The splats of a set that may be strays."""

    rows: NDArray[np.intp]  # [M] increasing
    features: Float32Array  # [M, F]


def standing_out(splats: Splats) -> StandingOut:
    """Return the splats that stand out and their features, as ``FEATURES``; none of small sets."""
    nothing = StandingOut(np.zeros(0, np.intp), np.zeros((0, len(FEATURES)), np.float32))
    if len(splats) < _FEWEST:
        return nothing
    points = splats.means.detach().cpu().double().numpy()
    scales = splats.scales.detach().cpu().double().sort(dim=1).values.numpy()
    opacities = splats.opacities.detach().cpu().double().numpy()
    tree = cKDTree(points)
    spread, _ = query_nearest(tree, points, [_RANK + 1])  # rank 1 of the tree is each itself
    spread, size = spread[:, 0], scales[:, 2]
    usual = float(np.median(spread))
    if not usual > 0:
        return nothing
    stands_out = spread > SPARSE * usual
    stands_out |= opacities < FAINT * np.median(opacities)
    stands_out |= size > LARGE * np.median(size)
    rows = np.flatnonzero(stands_out)
    if not len(rows):
        return nothing
    distance, index = query_nearest(tree, points[rows], range(2, _RANKS[-1] + 2))
    about = index[:, :_ABOUT]
    ranks = [rank - 1 for rank in _RANKS]
    outlying = _outlying(tree, points, distance, about)
    dense = max(float(np.quantile(spread, _DENSE_QUANTILE)), _TINY)
    reach = _REACH_SIGMAS * (size[rows] + size[index[:, _RANK - 1]])
    middle, off_plane, variances, normals = _planes(points[rows], points[about])
    quaternions = splats.quaternions.detach().cpu().double()
    own = thinnest_axes(quaternions, splats.scales.detach().cpu()).numpy()
    colors = splats.base_colors.detach().cpu().double().numpy()
    is_flat = scales[rows, 0] < FLAT * scales[rows, 1]
    facing = np.abs((own[rows] * normals).sum(axis=1))
    alike = np.abs(np.einsum("mkc,mc->mk", own[index[:, :_RANK]], own[rows])).mean(axis=1)
    columns = [
        *_log(distance[:, ranks] / usual).T,
        *outlying.T,
        _log(spread[rows] / dense),
        stands_out[about].mean(axis=1),
        _log(variances[:, 0] / variances[:, 1]),
        _log(variances[:, 1] / variances[:, 2]),
        _log(off_plane / np.sqrt(variances[:, 0])),
        middle / np.maximum(distance[:, _ABOUT - 1], _TINY),
        _log(size[rows] / max(float(np.median(size)), _TINY)),
        _log(scales[rows, 0] / np.maximum(scales[rows, 2], _TINY)),
        _log(distance[:, _RANK - 1] / np.maximum(reach, _TINY)),
        opacities[rows],
        opacities[rows] - np.median(opacities),
        opacities[rows] - opacities[about].mean(axis=1),
        np.abs(colors[rows] - colors[about].mean(axis=1)).max(axis=1),
        np.where(is_flat, facing, 0.5),
        np.where(is_flat, alike, 0.5),
    ]
    return StandingOut(rows, np.stack(columns, axis=1).astype(np.float32))


def _outlying(
    tree: cKDTree,
    points: Float64Array,  # [N, 3]
    distance: Float64Array,  # [M, K] of the splats that stand out
    about: NDArray[np.intp],  # [M, A] their surroundings
) -> Float64Array:  # [M, R]
    """Return logarithms of distances over those of the surroundings, for ``_OUTLYING_RANKS``."""
    ranks = [rank + 1 for rank in _OUTLYING_RANKS]
    others, place = np.unique(about, return_inverse=True)
    usual, _ = query_nearest(tree, points[others], ranks)
    usual = np.median(usual[place.reshape(about.shape)], axis=1)
    own = distance[:, [rank - 1 for rank in _OUTLYING_RANKS]]
    return _log(own / np.maximum(usual, _TINY))


def _planes(
    points: Float64Array,  # [M, 3]
    about: Float64Array,  # [M, A, 3]
) -> tuple[Float64Array, ...]:  # [M], [M], [M, 3], [M, 3]
    """Return distances from the middle and the plane of surroundings, variances and normals."""
    middle = about.mean(axis=1)
    offsets = about - middle[:, None]
    covariances = np.einsum("mki,mkj->mij", offsets, offsets) / about.shape[1]
    variances, axes = np.linalg.eigh(covariances)
    normals = axes[:, :, 0]
    away = points - middle
    off_plane = np.abs((away * normals).sum(axis=1))
    return np.linalg.norm(away, axis=1), off_plane, np.maximum(variances, _TINY**2), normals


def _log(values: Float64Array) -> Float64Array:
    return np.log(np.maximum(values, _TINY)).clip(-_MOST_LOG, _MOST_LOG)
