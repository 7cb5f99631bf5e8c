"""Mark splats that can be drawn but are probably not of the object's surface.

* ``floaters``: fewer than eight other splats are near. A splat is near if its distance is at most
  ``floater_spacings`` times what is usual in the dense part of the set, or if both splats reach
  each other within three standard deviations.
* ``giants``: larger than a share of the object.
* ``haze``: large and nearly transparent.
* ``needles``: long and far thinner.

Conventions
-----------
* Every rule gives a mask of its own; a splat may be in several. Nothing is removed here.
* Sizes are standard deviations as shares of the object's extent: the largest side of the box of the
  middle 90 % by axis, floaters left out. So the frame and the unit of the splats do not matter.
* Sets of fewer than ``FEWEST`` splats have no suspects: too few to tell what is usual.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.splats.filters import middle_and_extent
from gscomplete.splats.record import Splats
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import BoolArray, Float32Array, Float64Array

Reason = Literal["floaters", "giants", "haze", "needles"]

FEWEST = 100
"""Smaller sets have no suspects."""
DOUBTFUL_SHARE = 0.01
"""If a set has at least this share of suspects, a result made from it is doubtful."""
_NEIGHBOURS = 8
_REACH_SIGMAS = 3.0
"""A splat is drawn up to about this many standard deviations from its centre."""
_DENSE_QUANTILE = 0.05
"""Quantile of distances that stands for the dense part of a set; so an object is still found among
nineteen times as many floaters."""
_MOST_SAMPLED = 10_000
_MOST_CELLS = 1 << 20
"""Cells of the grid along an axis: three numbers of a cell fit into 64 bits."""
_FARTHEST = 1e3
"""Positions are clipped to this many extents from the middle, so that a tree of them is sound."""


@dataclass(frozen=True, slots=True)
class SuspectLimits:
    """Thresholds beyond which a splat is suspect."""

    floater_spacings: float = 4.0
    """A splat is a floater if its eighth neighbour is farther than this many times the usual
    distance in the dense part. On an evenly covered surface the ratio is at most 2.5."""
    giant_size: float = 0.25
    """Standard deviation of a giant, share of the extent."""
    haze_size: float = 0.05
    """Least standard deviation of haze along its second axis, share of the extent."""
    haze_opacity: float = 0.1
    """Largest opacity of haze."""
    needle_size: float = 0.05
    """Least standard deviation of a needle, share of the extent."""
    needle_ratio: float = 10.0
    """Least ratio of a needle's first to its second standard deviation."""


def suspect_rows(
    splats: Splats, limits: SuspectLimits | None = None
) -> dict[Reason, Tensor]:  # [N] bool each
    """Mark the suspects of a set, by reason.

    Args:
        splats: N splats in any frame that can be drawn (``filters.usable_rows``).
        limits: thresholds; None = the defaults.

    Returns:
        A mask [N] for every reason, some of them without a suspect.
    """
    means, scales, opacities = (
        values.detach().cpu().float().numpy()
        for values in (splats.means, splats.scales, splats.opacities)
    )
    found = find_suspects(means, scales, opacities, limits)
    return {name: torch.from_numpy(mask).to(splats.means.device) for name, mask in found.items()}


def suspect_counts(masks: Mapping[Reason, Tensor]) -> dict[Reason, int]:
    """Count the suspects by reason; reasons without any are left out."""
    counts: dict[Reason, int] = {name: int(mask.sum()) for name, mask in masks.items()}
    return {name: count for name, count in counts.items() if count}


def describe_suspects(splats: Splats) -> tuple[str, ...]:
    """Tell which kinds of suspects are so many that a result made from the set is doubtful.

    Args:
        splats: P that can be drawn, in any frame.
    """
    counts = suspect_counts(suspect_rows(splats))
    parts = [
        f"{count:,} {name} ({100 * count / len(splats):.2g} %)"
        for name, count in counts.items()
        if count >= DOUBTFUL_SHARE * len(splats)
    ]
    if not parts:
        return ()
    return (
        f"P has splats that may not belong to the object: {', '.join(parts)}; they are used, and "
        "guesses from P may be wrong (splatcomplete-data clean removes them)",
    )


def find_suspects(
    means: Float32Array,  # [N, 3] finite
    scales: Float32Array,  # [N, 3] standard deviations
    opacities: Float32Array,  # [N] in [0, 1]
    limits: SuspectLimits | None = None,
) -> dict[Reason, BoolArray]:  # [N] each
    """Mark the suspects of a set, by reason (``suspect_rows`` on bare arrays)."""
    chosen = limits or SuspectLimits()
    none = np.zeros(len(means), np.bool_)
    if len(means) < FEWEST:
        return {"floaters": none, "giants": none, "haze": none, "needles": none}
    ordered = np.sort(scales, axis=1)
    floating = _floaters(means, ordered[:, 2], chosen.floater_spacings)
    rest = means if floating.all() else means[~floating]
    extent = middle_and_extent(rest)[1]
    if not extent > 0:  # no size is large or small
        return {"floaters": floating, "giants": none, "haze": none, "needles": none}
    is_long = ordered[:, 2] > chosen.needle_size * extent
    is_wide = ordered[:, 1] > chosen.haze_size * extent
    return {
        "floaters": floating,
        "giants": ordered[:, 2] > chosen.giant_size * extent,
        "haze": is_wide & (opacities < chosen.haze_opacity),
        "needles": is_long & (ordered[:, 2] > chosen.needle_ratio * ordered[:, 1]),
    }


def _floaters(
    means: Float32Array,  # [N, 3]
    sizes: Float32Array,  # [N] largest standard deviation of each
    spacings: float,
) -> BoolArray:  # [N]
    """Mark splats whose eighth neighbour is far away and out of their reach."""
    floating = np.zeros(len(means), np.bool_)
    middle, extent = middle_and_extent(means)
    if not extent > 0:
        return floating
    points = np.clip((means - middle) / extent, -_FARTHEST, _FARTHEST)
    tree = cKDTree(points, balanced_tree=False)
    sample = every_nth(points, _MOST_SAMPLED)
    sampled = tree.query(sample, k=_NEIGHBOURS + 1)[0][:, -1]
    if not sampled.any():
        return floating
    limit = spacings * float(np.quantile(sampled[sampled > 0], _DENSE_QUANTILE))
    asked = np.flatnonzero(~_crowded(points, limit))
    distances, neighbours = tree.query(points[asked], k=_NEIGHBOURS + 1)
    reach = _REACH_SIGMAS * (sizes[asked] + sizes[neighbours[:, -1]]) / extent
    floating[asked] = distances[:, -1] > np.maximum(limit, reach)
    return floating


def _crowded(
    points: Float64Array,  # [N, 3]
    distance: float,
) -> BoolArray:  # [N]
    """Mark points that surely have eight others within a distance: those of one cell of a grid."""
    cells = (points - points.min(axis=0)) / (distance / np.sqrt(3.0))
    if cells.max() >= _MOST_CELLS:
        return np.zeros(len(points), np.bool_)
    cells = cells.astype(np.int64)
    keys = (cells[:, 0] * _MOST_CELLS + cells[:, 1]) * _MOST_CELLS + cells[:, 2]
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    return np.asarray(counts[inverse] > _NEIGHBOURS)
