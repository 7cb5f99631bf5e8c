"""Colours that mirror images give, checked against those at P's rim, carried round the object.

A mirror image shows again what an object has once: a face, a label, a lens. Where its colours are
unlike the rim's on average about a splat, the rim's count. They are the shares that P's main
colours have at the rim, spread over the surface as heat is (Laplace's equation on a graph of
neighbouring splats) and sharpened, so that what is black below and white above stays so.

Conventions
-----------
* Colours are sRGB in [0, 1], lengths in object sizes. Arithmetic is float64.
"""

from __future__ import annotations

import warnings

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.shape.voxels import CELL_SIDE
from gscomplete.splats import Splats
from gscomplete.splats.oklab import oklab_from_srgb
from gscomplete.splats.thinning import thinned

_NEIGHBOURS = 8
"""Splats that a colour goes to directly."""
_RIM_REACH = 0.05
"""Splats of P this near to new ones, across the surface, are P's rim."""
_RIM_SPLATS = 20_000
"""Most splats of P among which the rim is looked for."""
_MAIN_COLORS = 8
"""Most of them."""
_MOST_CLUSTERED = 4000
"""Colours at the rim that decide the main ones."""
_SHARES_SHARPENED = 2.0
"""Power of the shares of main colours."""
_HEIGHT_WEIGHT = 8.0
"""How much less a colour goes up or down than round."""
_ACROSS = 0.03
"""Weight of neighbours that face another way, so that edges are passed."""
_ALIKE = 0.1
"""Distance of colours, in Oklab, at which the mirror image's count for 1/e."""
_AVERAGED_STEPS = 20
"""Steps to neighbours over which that distance is averaged."""
_TINY = 1e-6


def checked_by_rim(
    colors: Tensor,  # [N, 3] that a mirror image gives
    points: Tensor,  # [N, 3]
    normals: Tensor,  # [N, 3] outward
    partial: Splats,
    generator: torch.Generator,
) -> Tensor:  # [N, 3]
    """Return the colours of new splats, the rim's where a mirror image's are unlike them.

    Args:
        colors: in [0, 1].
        points: where the new splats are.
        normals: of the surface there.
        partial: P in the object frame.
        generator: chooses the splats of P looked at, if there are too many.
    """
    places = points.double().numpy()
    if len(places) <= _NEIGHBOURS:
        return colors
    facing = normals.double().numpy()
    graph = _neighbour_weights(places, facing)
    looked_at = thinned(partial, _RIM_SPLATS, generator)
    rim = _rim_colors(graph, places, facing, looked_at, colors)
    if rim is None:
        return colors
    unlike = (oklab_from_srgb(colors) - oklab_from_srgb(rim)).square().sum(dim=1).numpy()
    touches = (graph > 0).astype(np.float64)
    per_row = 1.0 / np.maximum(touches.sum(axis=1), 1.0)
    for _ in range(_AVERAGED_STEPS):
        unlike = 0.5 * (unlike + per_row * (touches @ unlike))
    weight = torch.from_numpy(np.exp(-unlike / _ALIKE**2)).float()[:, None]
    return weight * colors + (1 - weight) * rim


def _neighbour_weights(
    places: NDArray[np.float64],  # [N, 3]
    facing: NDArray[np.float64],  # [N, 3]
) -> csr_array:  # [N, N], symmetric
    """Return how well colours go from splat to splat."""
    _, index = cKDTree(places).query(places, k=_NEIGHBOURS + 1)
    rows, columns = np.repeat(np.arange(len(places)), _NEIGHBOURS), index[:, 1:].reshape(-1)
    alike = np.maximum((facing[rows] * facing[columns]).sum(axis=1), 0.0) + _ACROSS
    weight = alike * _nearness(places[columns] - places[rows])
    one_way = csr_array((weight, (rows, columns)), shape=(len(places), len(places)))
    return csr_array(0.5 * (one_way + one_way.T))


def _nearness(offsets: NDArray[np.float64]) -> NDArray[np.float64]:  # [N, 3] -> [N]
    squared = (offsets * (1.0, 1.0, _HEIGHT_WEIGHT)) ** 2
    return 1.0 / np.maximum(squared.sum(axis=1), _TINY)


def _rim_colors(
    graph: csr_array,  # [N, N]
    places: NDArray[np.float64],  # [N, 3]
    facing: NDArray[np.float64],  # [N, 3]
    partial: Splats,
    colors: Tensor,  # [N, 3] of what the rim does not reach
) -> Tensor | None:  # [N, 3]
    """Return the colours at P's rim, carried round; None where no splat of P is near."""
    means, base = partial.means.double().numpy(), partial.base_colors.float().clamp(0, 1)
    near = range(1, min(_NEIGHBOURS, len(means)) + 1)
    distance, index = cKDTree(means).query(places, k=near, distance_upper_bound=_RIM_REACH)
    rows, which = np.nonzero(np.isfinite(distance))
    given = index[rows, which]
    offsets, distance = means[given] - places[rows], distance[rows, which]
    off_surface = np.abs((offsets * facing[rows]).sum(axis=1))
    beside = off_surface <= np.maximum(0.5 * distance, 0.2 * CELL_SIDE)
    rows, given, offsets = rows[beside], given[beside], offsets[beside]
    if not len(rows):
        return None
    weight, count = _nearness(offsets), len(places)
    held = graph.sum(axis=1) + np.bincount(rows, weight, count)
    system = diags_array(held + _TINY * held.mean()) - graph
    solve = splu(system.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve
    shown = base.double().numpy()[given]
    label = _main_color(oklab_from_srgb(torch.from_numpy(shown)).numpy())
    shares, mixed = [], []
    for one in range(int(label.max()) + 1):
        w = np.where(label == one, weight, 0.0)
        right = [np.bincount(rows, w * column, count) for column in (1.0, *shown.T)]
        share, *color = solve(np.stack(right, axis=1)).T
        share = np.maximum(share, _TINY**2)
        shares.append(share)
        mixed.append(np.stack(color, axis=1) / share[:, None])
    sharp = (np.stack(shares) / np.max(shares, axis=0)) ** _SHARES_SHARPENED
    carried = (sharp[:, :, None] * np.stack(mixed)).sum(axis=0) / sharp.sum(axis=0)[:, None]
    reached = torch.from_numpy(np.max(shares, axis=0) > _TINY)[:, None]
    return torch.where(reached, torch.from_numpy(carried).float().clamp(0, 1), colors)


def _main_color(colors: NDArray[np.float64]) -> NDArray[np.intp]:  # [N, 3] Oklab -> [N]
    """Return which of the main colours each is nearest to."""
    some = colors[:: -(-len(colors) // _MOST_CLUSTERED)]
    count = min(_MAIN_COLORS, len(np.unique(some, axis=0)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # fewer clusters than asked for will do
        main, _ = kmeans2(some, count, iter=15, minit="++", seed=0)
    return np.asarray(cKDTree(main).query(colors)[1])
