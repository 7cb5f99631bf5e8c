"""Colours at P's edges that a depth camera has mixed with those of what stood behind P.

A guess carries the colours of P's rim over what is missing: a rim in the table's colour becomes a
side in the table's colour. For the guess, edge splats whose colours are unlike those further inside
take the latter. P itself is not changed.

Conventions
-----------
* Lengths are multiples of P's spacing: the median distance to the fourth nearest splat.
* Colours are compared in Oklab.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from scipy.spatial import cKDTree

from gscomplete.splats import Splats, colors_to_sh
from gscomplete.splats.geometry.nearest import query_nearest
from gscomplete.splats.geometry.neighbourhood import one_sidedness
from gscomplete.splats.oklab import oklab_from_srgb
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import IntArray

_MOST_LOOKED_AT = 40_000
"""Most splats among which the rim is looked for."""
_NEIGHBOURS, _ON_RIM = 24, 0.45
"""A splat is on the rim if so many neighbours are this one-sided about it."""
_EDGE = 2.0
"""Splats this near to the rim, in spacings, are at the edge."""
_FARTHEST = 8.0
"""Edge splats farther from all that is further inside keep their colours, spacings."""
_COMPARED, _TAKEN = 16, 8
"""Colours further inside: how many an edge splat's is compared with, and how many it takes the mean
of."""
_UNLIKE, _SPREADS = 0.05, 1.0
"""A colour is unlike these if it differs from their mean by more than the first, plus so many of
their root mean square differences from it."""
_FEWEST = 100


def without_mixed_edges(partial: Splats) -> tuple[Splats, int]:
    """Return P with other colours at its edges, and how many splats have other ones.

    Args:
        partial: P, N splats in the object frame.
    """
    if len(partial) <= _FEWEST:
        return partial, 0
    means = partial.means.double().numpy()
    order = np.arange(len(means))
    sample = every_nth(order, _MOST_LOOKED_AT)
    looked_at = means[sample]
    distance, index = query_nearest(cKDTree(looked_at), looked_at, range(1, _NEIGHBOURS + 2))
    spacing = float(np.median(distance[:, 4]))
    ways = looked_at[index[:, 1:]] - looked_at[:, None]
    rim = looked_at[one_sidedness(ways) > _ON_RIM]
    if not len(rim):
        return partial, 0
    to_rim, _ = query_nearest(cKDTree(rim), means, within=_EDGE * spacing)
    edge = order[np.isfinite(to_rim)]
    inside = sample[np.isinf(to_rim[sample])]
    if not len(edge) or len(inside) < _FEWEST:
        return partial, 0
    return _recolored(partial, edge, inside, spacing)


def _recolored(
    partial: Splats,
    edge: IntArray,  # [E] rows
    inside: IntArray,  # [I] rows
    spacing: float,
) -> tuple[Splats, int]:
    """Give edge splats that are unlike those further inside their mean colour."""
    means, base = partial.means.double().numpy(), partial.base_colors.float().clamp(0, 1)
    tree = cKDTree(means[inside])
    distance, index = query_nearest(tree, means[edge], range(1, _COMPARED + 1))
    seen = oklab_from_srgb(base).numpy()
    known = seen[inside[index]]
    middle = known.mean(axis=1)
    spread = np.sqrt(((known - middle[:, None]) ** 2).sum(axis=2).mean(axis=1))
    unlike = np.linalg.norm(seen[edge] - middle, axis=1) > _UNLIKE + _SPREADS * spread
    unlike &= distance[:, 0] < _FARTHEST * spacing
    near = 1.0 / (distance[unlike, :_TAKEN] + 0.5 * spacing) ** 2
    weight = torch.from_numpy(near / near.sum(axis=1, keepdims=True)).float()
    taken = base[torch.from_numpy(inside[index[unlike, :_TAKEN]])]
    plain = partial.with_sh_degree(0)
    sh = plain.sh.clone()
    sh[torch.from_numpy(edge[unlike])] = colors_to_sh((weight[:, :, None] * taken).sum(dim=1))
    return dataclasses.replace(plain, sh=sh), int(unlike.sum())
