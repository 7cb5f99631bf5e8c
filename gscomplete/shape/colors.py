"""Colours of new splats: taken from P and its mirror images, where the network points.

Where mirrored splats are used as they are, gaps beside them take the nearest colours instead.

A mirror image shows again what an object has once: a face, a label, a lens. So its colours are
checked against those at P's rim, carried round the object (``checked_by_rim``): where the two are
unlike each other on average about a splat, the rim's count. They are the shares that P's main
colours have at the rim, spread over the surface as heat is (Laplace's equation on a graph of
neighbouring splats) and sharpened, so that what is black below and white above stays so.

The network also has a colour of its own to mix in, which training needs (without it, colours that
P does not show would push the pointing astray); mixed into a picture it appears as dirt beside P's
colours, and so does a mean of two patterns. So new splats take the colour of one source.

Conventions
-----------
* Sources are P and its mirror images, in the order of ``partial_voxels``; colours in [0, 1].
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.shape.network import ShapeOutput
from gscomplete.shape.partial_voxels import ShapeInputs
from gscomplete.shape.symmetry import SOURCES
from gscomplete.shape.voxels import CELL_SIDE, sample_volume
from gscomplete.splats import Splats
from gscomplete.splats.filters import thinned
from gscomplete.splats.oklab import oklab_from_srgb

_SHARPNESS = 8.0
"""Factor on the network's logits: mixing happens only where sources change."""
_NO_SHARE = 3.0
"""Logits behind another source at which a source's share is below float32's last digit."""
_PREFERENCE = 1.0
"""What each mirror image is behind the likelier one before it, in logits: where the network
cannot tell two of them apart, a mean of both is the one colour that is surely wrong."""
_NEIGHBOURS = 8
"""A colour is a mean over this many splats of a source: scans are noisy."""
_OUTWARD = 2.0 * CELL_SIDE
"""So far outside new splats the nearest colours are searched: icing, not the dough under it."""

_RIM_REACH = 0.05
"""Splats of P this near to new ones, across the surface, are P's rim."""
_RIM_SPLATS = 20_000
"""Most splats of P among which the rim is looked for."""
_MAIN_COLORS = 8
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


@dataclass(frozen=True, slots=True)
class ColorSettings:
    """How sources are chosen; lengths in object sizes."""

    reach: float = 0.06
    """A source counts in full where it has a splat this near; beyond it loses, the farther the
    more, so that the nearest is taken where none is near."""
    max_splats: int = 40_000
    """Most splats of P searched."""
    height_weight: float = 3.0
    """How much farther away a splat counts for being higher or lower than for being beside: rims,
    bands and stripes go round what stands upright, and go on round it. On most objects it makes no
    difference; a striped lantern gains 1.9 dB."""


_FAR_PENALTY = 3.0
"""Logits lost per ``reach`` beyond it."""


def source_colors(
    output: ShapeOutput,
    inputs: ShapeInputs,
    partial: Splats,
    points: Tensor,  # [N, 3]
    generator: torch.Generator,
    settings: ColorSettings | None = None,
) -> Tensor:  # [N, 3]
    """Return the colours of new splats at ``points``.

    Args:
        output: of the network for a batch of one.
        inputs: what the network saw.
        partial: P in the object frame.
        points: where the new splats are.
        generator: chooses the splats of P searched, if there are too many.
        settings: knobs; None = defaults.
    """
    chosen = settings or ColorSettings()
    known = _Known(partial, generator, chosen)
    places = [points.numpy(), *(s.undo(points.numpy()) for s in inputs.symmetries)]
    pointing = sample_volume(output.sources[0, :SOURCES].float(), points)
    behind = _PREFERENCE * (torch.arange(SOURCES) - 1).clamp_min(0)
    most = pointing - behind  # where a splat of the source is near
    found = torch.zeros(len(points), SOURCES, 3)
    logits = torch.full((len(points), SOURCES), -torch.inf)
    for source, place in enumerate(places):
        counts = most[:, source] > logits.amax(dim=1) - _NO_SHARE
        color, distance = known.near(place[counts.numpy()])
        found[counts, source] = color
        beyond = (distance / chosen.reach - 1.0).clamp_min(0)
        logits[counts, source] = pointing[counts, source] - _FAR_PENALTY * beyond - behind[source]
    shares = (_SHARPNESS * logits).softmax(dim=1)
    return (shares[:, :, None] * found).sum(dim=1)


def nearest_colors(
    colored: Splats,
    points: Tensor,  # [N, 3]
    normals: Tensor,  # [N, 3] outward
    generator: torch.Generator,
    settings: ColorSettings | None = None,
) -> Tensor:  # [N, 3]
    """Return the colours of what lies about ``points``, outer layers before inner ones.

    Args:
        colored: splats to take colours from, object frame.
        points: where the new splats are.
        normals: of the surface there.
        generator: chooses the splats searched, if there are too many.
        settings: knobs; None = defaults.
    """
    chosen = settings or ColorSettings()
    outside = points + _OUTWARD * normals
    return _Known(colored, generator, chosen).near(outside.numpy())[0]


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


class _Known:
    """Splats that colours are taken from."""

    def __init__(self, splats: Splats, generator: torch.Generator, settings: ColorSettings) -> None:
        looked_at = thinned(splats, settings.max_splats, generator)
        self._base = looked_at.base_colors.float().clamp(0, 1)
        self._means = looked_at.means.float().numpy()
        self._stretch = np.array([1.0, 1.0, settings.height_weight], np.float32)
        self._tree = cKDTree(self._means * self._stretch)
        self._nearest = range(1, min(_NEIGHBOURS, len(looked_at)) + 1)

    def near(self, places: NDArray[np.float32]) -> tuple[Tensor, Tensor]:  # [N, 3] -> [N, 3], [N]
        """Return the mean colour of the nearest splats, near ones first, and how far the first is.

        Heights count ``height_weight`` times for which ones are near, once for how far it is.
        """
        distance, index = self._tree.query(places * self._stretch, k=self._nearest)
        weight = torch.from_numpy(1.0 / (distance + 0.2 * CELL_SIDE) ** 2).float()
        weight /= weight.sum(dim=1, keepdim=True)
        color = (weight[:, :, None] * self._base[torch.from_numpy(index)]).sum(dim=1)
        away = np.linalg.norm(places - self._means[index[:, 0]], axis=1)
        return color, torch.from_numpy(away).float()
