"""Colours that mirror images give, checked against the colours at P's rim.

A mirror image repeats what an object has only once: a face, a label, a lens. Where the colours
about a splat differ on average from what the rim suggests, the rim's colours are used, unless P
shows both sides of that symmetry (``both_sides``). To carry them over the new surface, P's colours
at the rim are grouped into a few main colours; the share of each spreads as heat does (Laplace's
equation on a graph of neighbouring splats), and the shares are then sharpened, so that an object
that is black below and white above stays so.

Conventions
-----------
* Colours are sRGB in [0, 1], lengths in object sizes. Arithmetic is float64.
"""

from __future__ import annotations

import math
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
from gscomplete.splats.thinning import every_nth, thinned
from gscomplete.util.arrays import Float64Array

_NEIGHBOURS = 8
"""Neighbours of a splat in the graph."""
_RIM_REACH = 0.05
"""Splats of P within this distance of a new splat, across the surface, are P's rim."""
_RIM_SPLATS = 20_000
"""Most splats of P among which the rim is looked for."""
_MAIN_COLORS = 8
"""Most main colours at the rim."""
_MOST_CLUSTERED = 4000
"""About how many of the rim's colours the clustering into main colours looks at."""
_SHARES_SHARPENED = 2.0
"""Power to which the shares of main colours are raised."""
_HEIGHT_WEIGHT = 8.0
"""Factor on heights in distances between splats: colours spread round the object rather than up or
down."""
_ACROSS = 0.03
"""Least weight of neighbours, whichever way they face, so that colours pass edges."""
_ALIKE = 0.1
"""Root mean square difference from the rim's colour, in Oklab, at which the weight of the mirror
image's colour is 1/e."""
_AVERAGED_REACH = 0.08
"""Root mean square distance of the places that this mean is over, object sizes."""
_MOST_AVERAGED_STEPS = 200
"""Bounds the time that very dense splats take."""
_TINY = 1e-6


def checked_by_rim(
    colors: Tensor,  # [N, 3] that a mirror image gives
    sure: Tensor,  # [N] in [0, 1]
    points: Tensor,  # [N, 3]
    normals: Tensor,  # [N, 3] outward
    partial: Splats,
    generator: torch.Generator,
) -> Tensor:  # [N, 3]
    """Replace colours that a mirror image gives by the rim's where the two differ.

    Args:
        colors: from the mirror image, in [0, 1].
        sure: least weight of these colours.
        points: centres of the new splats.
        normals: of the surface at the centres.
        partial: P in the object frame.
        generator: chooses the splats of P that are looked at, if there are too many.

    Returns:
        The new splats' colours in [0, 1]; a smooth mix where the difference is in between.
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
    unlike = _averaged(unlike, graph, places)
    weight = torch.from_numpy(np.exp(-unlike / _ALIKE**2)).float().maximum(sure)[:, None]
    return weight * colors + (1 - weight) * rim


def _averaged(
    values: Float64Array,  # [N]
    graph: csr_array,  # [N, N]
    places: Float64Array,  # [N, 3]
) -> Float64Array:  # [N]
    """Return means over the places about each, by steps of a random walk along the graph's edges.

    The variance of a step is the mean squared length of the edges.
    """
    rows, columns = graph.nonzero()
    squared = float(((places[rows] - places[columns]) ** 2).sum(axis=1).mean())
    steps = math.ceil(_AVERAGED_REACH**2 / max(squared, _TINY))
    edges = np.bincount(rows, minlength=len(places)).clip(1)
    walk = csr_array((1.0 / edges[rows], (rows, columns)), shape=graph.shape)
    for _ in range(min(steps, _MOST_AVERAGED_STEPS)):
        values = walk @ values
    return values


def _neighbour_weights(
    places: Float64Array,  # [N, 3]
    facing: Float64Array,  # [N, 3]
) -> csr_array:  # [N, N], symmetric
    """Return the weights of the graph: large between near splats that face alike."""
    _, index = cKDTree(places).query(places, k=_NEIGHBOURS + 1)
    rows, columns = np.repeat(np.arange(len(places)), _NEIGHBOURS), index[:, 1:].reshape(-1)
    alike = np.maximum((facing[rows] * facing[columns]).sum(axis=1), 0.0) + _ACROSS
    weight = alike * _nearness(places[columns] - places[rows])
    one_way = csr_array((weight, (rows, columns)), shape=(len(places), len(places)))
    return csr_array(0.5 * (one_way + one_way.T))


def _nearness(offsets: Float64Array) -> Float64Array:  # [N, 3] -> [N]
    squared = (offsets * (1.0, 1.0, _HEIGHT_WEIGHT)) ** 2
    return 1.0 / np.maximum(squared.sum(axis=1), _TINY)


def _rim_colors(
    graph: csr_array,  # [N, N]
    places: Float64Array,  # [N, 3]
    facing: Float64Array,  # [N, 3]
    partial: Splats,
    colors: Tensor,  # [N, 3] of what the rim does not reach
) -> Tensor | None:  # [N, 3]
    """Return the rim's colours, spread over the new splats; None = no splat of P is near."""
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


def _main_color(colors: Float64Array) -> NDArray[np.intp]:  # [N, 3] Oklab -> [N]
    """Return which of the main colours each is nearest to."""
    some = every_nth(colors, _MOST_CLUSTERED)
    count = min(_MAIN_COLORS, len(np.unique(some, axis=0)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # fewer clusters than asked for will do
        main, _ = kmeans2(some, count, iter=15, minit="++", seed=0)
    return np.asarray(cKDTree(main).query(colors)[1])
