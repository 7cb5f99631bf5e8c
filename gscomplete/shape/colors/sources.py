"""Colours of new splats, taken from P or one of its mirror images as the network points.

Where mirrored splats are used as they are, gaps beside them take the nearest colours instead.

The network also predicts a colour of its own. Training needs it: otherwise colours that P does not
show would lead the pointing astray. But mixed in, it looks like dirt beside P's colours, and so
does a mean of two patterns. So every new splat takes the colour of one source.

Conventions
-----------
* Sources are P and its mirror images, in the order of ``partial_voxels``; colours in [0, 1].
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.shape.colors.both_sides import shows_both_sides
from gscomplete.shape.network import ShapeOutput
from gscomplete.shape.partial_voxels import ShapeInputs
from gscomplete.shape.symmetry import SOURCES
from gscomplete.shape.voxels import CELL_SIDE, sample_volume
from gscomplete.splats import Splats
from gscomplete.splats.geometry.nearest import query_nearest
from gscomplete.splats.thinning import thinned
from gscomplete.util.arrays import Float32Array

_SHARPNESS = 8.0
"""Factor on the network's logits, so that sources mix only where one gives way to another."""
_NO_SHARE = 3.0
"""A source this many logits behind another has a share below float32's precision."""
_PREFERENCE = 1.0
"""Logits that each mirror image loses against the likelier one before it: where the network cannot
tell two of them apart, the mean of both is the one colour that is surely wrong."""
_NEIGHBOURS = 8
"""A colour is a mean over this many splats of a source, because scans are noisy."""
_OUTWARD = 2.0 * CELL_SIDE
"""The nearest colours are searched from a point this far outside a new splat, so that the outer
layer is found: icing rather than the dough under it."""
_REACH = 0.06
"""A source counts in full where it has a splat within this distance, object sizes. Beyond, it loses
logits with distance, so that the nearest source is taken where none is near."""
_FAR_PENALTY = 3.0
"""Logits lost per ``_REACH`` beyond it."""
_MOST_SEARCHED = 40_000
"""Most splats of a source among which the nearest are searched."""
_HEIGHT_WEIGHT = 3.0
"""Factor on heights when the nearest splats are searched: rims, bands and stripes go round upright
objects, so colours do too. On most objects it makes no difference; a striped lantern gains
1.9 dB."""


def source_colors(
    output: ShapeOutput,
    inputs: ShapeInputs,
    partial: Splats,
    points: Tensor,  # [N, 3]
    generator: torch.Generator,
) -> tuple[Tensor, Tensor]:  # [N, 3], [N]
    """Return the colours of new splats at ``points``, and how sure they are.

    Args:
        output: of the network for a batch of one.
        inputs: what the network saw.
        partial: P in the object frame.
        points: where the new splats are.
        generator: chooses the splats of P searched, if there are too many.

    Returns:
        Colours in [0, 1], and which share of each comes from mirror images of whose symmetry P
        shows both sides.
    """
    known = _Known(partial, generator)
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
        beyond = (distance / _REACH - 1.0).clamp_min(0)
        logits[counts, source] = pointing[counts, source] - _FAR_PENALTY * beyond - behind[source]
    shares = (_SHARPNESS * logits).softmax(dim=1)
    sure = torch.tensor([False, *(shows_both_sides(partial, s) for s in inputs.symmetries)])
    return (shares[:, :, None] * found).sum(dim=1), shares[:, sure].sum(dim=1)


def nearest_colors(
    colored: Splats,
    points: Tensor,  # [N, 3]
    normals: Tensor,  # [N, 3] outward
    generator: torch.Generator,
) -> Tensor:  # [N, 3]
    """Return the colours nearest to ``points``, those of outer layers before inner ones.

    Args:
        colored: splats to take colours from, object frame.
        points: where the new splats are.
        normals: of the surface there.
        generator: chooses the splats searched, if there are too many.
    """
    outside = points + _OUTWARD * normals
    return _Known(colored, generator).near(outside.numpy())[0]


class _Known:
    """Splats that colours are taken from."""

    def __init__(self, splats: Splats, generator: torch.Generator) -> None:
        looked_at = thinned(splats, _MOST_SEARCHED, generator)
        self._base = looked_at.base_colors.float().clamp(0, 1)
        self._means = looked_at.means.float().numpy()
        self._stretch = np.array([1.0, 1.0, _HEIGHT_WEIGHT], np.float32)
        self._tree = cKDTree(self._means * self._stretch)
        self._nearest = range(1, min(_NEIGHBOURS, len(looked_at)) + 1)

    def near(self, places: Float32Array) -> tuple[Tensor, Tensor]:  # [N, 3] -> [N, 3], [N]
        """Return the mean colour of the nearest splats, weighted by nearness, and a distance.

        The nearest splats are chosen with heights scaled by ``_HEIGHT_WEIGHT``; the distance to the
        first of them, in object sizes, is not scaled.
        """
        distance, index = query_nearest(self._tree, places * self._stretch, self._nearest)
        weight = torch.from_numpy(1.0 / (distance + 0.2 * CELL_SIDE) ** 2).float()
        weight /= weight.sum(dim=1, keepdim=True)
        color = (weight[:, :, None] * self._base[torch.from_numpy(index)]).sum(dim=1)
        away = np.linalg.norm(places - self._means[index[:, 0]], axis=1)
        return color, torch.from_numpy(away).float()
