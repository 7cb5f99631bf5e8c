"""Adaptive density control of the original 3DGS: clone, split, prune, within a fixed cap.

Conventions
-----------
* Nothing is removed without a count of the reason.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from gscomplete.fitting.densify import GradientStatistics, halves_of
from gscomplete.splats import concatenate
from gscomplete.util.randomness import generator_for
from splatcomplete_data.multiview.training.parameters import PhotoParameters
from splatcomplete_data.multiview.training.settings import (
    GRADIENT,
    PRUNE_EXTENT,
    PRUNE_OPACITY,
    SPLIT_EXTENT,
    GrowthSettings,
)


@dataclass(frozen=True, slots=True)
class GrowthReport:
    """What one round of division and pruning did."""

    cloned: int
    split: int
    transparent: int
    large: int


def grow(
    parameters: PhotoParameters,
    statistics: GradientStatistics,
    settings: GrowthSettings,
    *,
    extent: float,
    prune_large: bool,
    seed: int,
    step: int,
) -> GrowthReport:
    """Divide the splats with the largest screen gradients, and remove those that show nothing.

    If that would remove every splat, none is removed, because nothing could grow again.

    Args:
        parameters: the splats, changed in place.
        statistics: gradients since the last round.
        settings: thresholds and the cap.
        extent: of the scene, in world units.
        prune_large: whether splats larger than ``PRUNE_EXTENT`` are removed, too.
        seed: seed of the run.
        step: number of the step, so that a resumed run divides alike.
    """
    splats = parameters.splats().detach()
    largest = splats.scales.amax(dim=1)
    transparent = splats.opacities < PRUNE_OPACITY
    large = ~transparent & (largest > PRUNE_EXTENT * extent) & prune_large
    stays = ~(transparent | large)
    if not bool(stays.any()):
        transparent, large = torch.zeros_like(stays), torch.zeros_like(stays)
        stays = ~stays
    mean = torch.where(stays, statistics.mean(), 0.0)
    room = settings.max_splats - int(stays.sum())
    ranked = torch.argsort(mean, descending=True, stable=True)[: max(room, 0)]
    chosen = ranked[mean[ranked] > GRADIENT]
    wide = largest[chosen] > SPLIT_EXTENT * extent
    halves = halves_of(splats.select(chosen[wide]), generator_for(seed, step, "split"))
    clones = splats.select(chosen[~wide])
    keep = stays.clone()
    keep[chosen[wide]] = False
    parameters.edit(keep, concatenate([clones, halves]))
    return GrowthReport(len(clones), len(halves) // 2, int(transparent.sum()), int(large.sum()))
