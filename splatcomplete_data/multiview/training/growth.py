"""Adaptive density control of the original 3DGS: clone, split, prune, within a fixed cap.

Conventions
-----------
* Gradients are lengths of dL/d(projected centre), per half image width and height, averaged over
  the steps in which a splat was seen; so they hardly depend on the image size.
* Nothing is removed without a count of the reason.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.splats import Splats, concatenate
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.util.randomness import generator_for
from splatcomplete_data.multiview.training.parameters import GaussianParameters
from splatcomplete_data.multiview.training.settings import GrowthSettings

SPLIT_SHRINK = 1.6
"""Scales of the two halves of a split splat are divided by this (Kerbl et al. 2023)."""


@dataclass(frozen=True, slots=True)
class GrowthReport:
    """What one round of division and pruning did."""

    cloned: int
    split: int
    transparent: int
    large: int


class GradientStatistics:
    """Mean length of every splat's screen gradient over the steps that saw it."""

    def __init__(self, count: int, device: torch.device | None = None) -> None:
        """Start with no steps."""
        self.total = torch.zeros(count, device=device)
        self.seen = torch.zeros(count, device=device)

    def add(self, gradient: Tensor, width: int, height: int) -> None:  # [1, N, 2] dL/dpixel
        """Add one step."""
        half = gradient.new_tensor([0.5 * width, 0.5 * height])
        length = (gradient[0] * half).norm(dim=1)
        self.total += length
        self.seen += length > 0

    def mean(self) -> Tensor:  # [N]
        """Return the mean, 0 for splats that no step has seen."""
        return self.total / self.seen.clamp_min(1)


def grow(
    parameters: GaussianParameters,
    statistics: GradientStatistics,
    settings: GrowthSettings,
    *,
    extent: float,
    prune_large: bool,
    seed: int,
    step: int,
) -> GrowthReport:
    """Divide the splats that the picture pulls at most, and remove those that show nothing.

    Where that would remove every splat, none is removed: nothing could grow again.

    Args:
        parameters: the splats, changed in place.
        statistics: gradients since the last round.
        settings: thresholds and the cap.
        extent: of the scene, in world units.
        prune_large: whether splats larger than ``prune_extent`` are removed, too.
        seed: seed of the run.
        step: number of the step, so that a resumed run divides alike.
    """
    splats = parameters.splats().detach()
    largest = splats.scales.amax(dim=1)
    transparent = splats.opacities < settings.prune_opacity
    large = ~transparent & (largest > settings.prune_extent * extent) & prune_large
    stays = ~(transparent | large)
    if not bool(stays.any()):
        transparent, large = torch.zeros_like(stays), torch.zeros_like(stays)
        stays = ~stays
    mean = torch.where(stays, statistics.mean(), 0.0)
    room = settings.max_splats - int(stays.sum())
    ranked = torch.argsort(mean, descending=True, stable=True)[: max(room, 0)]
    chosen = ranked[mean[ranked] > settings.gradient]
    wide = largest[chosen] > settings.split_extent * extent
    halves = _halves(splats.select(chosen[wide]), generator_for(seed, step, "split"))
    clones = splats.select(chosen[~wide])
    keep = stays.clone()
    keep[chosen[wide]] = False
    parameters.edit(keep, concatenate([clones, halves]))
    return GrowthReport(len(clones), len(halves) // 2, int(transparent.sum()), int(large.sum()))


def _halves(splats: Splats, generator: torch.Generator) -> Splats:
    """Replace every splat by two smaller ones drawn from it."""
    twice = concatenate([splats, splats])
    noise = torch.randn(twice.means.shape, generator=generator).to(twice.means)
    offset = (rotation_matrices(twice.quaternions) @ (noise * twice.scales)[:, :, None])[:, :, 0]
    return Splats(
        twice.means + offset,
        twice.quaternions,
        twice.scales / SPLIT_SHRINK,
        twice.opacities,
        twice.sh,
    )
