"""Subdivide splats whose screen gradients are large, and prune splats that contribute nothing.

Gradient statistics cover all views that were rendered, not only one of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.fitting.parameters import SplatParameters
from gscomplete.fitting.settings import DensifySettings
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.util.randomness import generator_for

PRUNE_OPACITY = 0.01
"""Splats with a lower opacity are removed."""
FINAL_OPACITY = 0.1
"""And late, where settings say so, those below this one."""
SPLIT_SHRINK = 1.6
"""Scales of the two halves of a split splat are divided by this (Kerbl et al. 2023)."""


@dataclass(frozen=True, slots=True)
class PruneReport:
    """How many new splats were removed, and why (one reason each, the first that applies)."""

    transparent: int
    far: int

    @property
    def total(self) -> int:
        """All removed splats."""
        return self.transparent + self.far


class GradientStatistics:
    """Mean length of the screen-space gradient of every splat over all views that saw it."""

    def __init__(self, count: int, device: torch.device | str = "cpu") -> None:
        """Start with no views."""
        self.total = torch.zeros(count, device=device)
        self.views = torch.zeros(count, device=device)

    def add(self, gradient: Tensor, width: int, height: int) -> None:  # [V, N, 2] dL/dpixel
        """Add views; pixels are scaled to half image sizes, so resolution hardly matters."""
        scaled = (gradient[..., 0] * (0.5 * width), gradient[..., 1] * (0.5 * height))
        length = torch.stack(scaled, dim=-1).norm(dim=-1)
        self.total += length.sum(dim=0)
        self.views += (length > 0).sum(dim=0)

    def mean(self) -> Tensor:  # [N]
        """Return the mean gradient length, 0 for splats that no view has seen."""
        return self.total / self.views.clamp_min(1)


def subdivide(
    parameters: SplatParameters,
    statistics: GradientStatistics,
    settings: DensifySettings,
    seed: int,
    step: int,
) -> int:
    """Split or clone the splats with the largest mean gradient; return how many were added."""
    splats = parameters.splats().detach()
    count = len(splats)
    room = settings.max_new - count
    budget = min(int(settings.growth * count), room)
    if budget <= 0:
        return 0
    mean = statistics.mean()
    ranked = torch.argsort(mean, descending=True, stable=True)[:budget]
    chosen = ranked[mean[ranked] > 0.0]
    if len(chosen) == 0:
        return 0
    large = splats.scales[chosen].amax(dim=1) > settings.split_scale
    halves = halves_of(splats.select(chosen[large]), generator_for(seed, step, "split"))
    clones = splats.select(chosen[~large])
    keep = torch.ones(count, dtype=torch.bool, device=chosen.device)
    keep[chosen[large]] = False
    parameters.edit(keep, concatenate([halves, clones]))
    return len(parameters) - count


def halves_of(splats: Splats, generator: torch.Generator) -> Splats:
    """Replace every splat by two smaller ones, whose centres are drawn from its Gaussian."""
    twice = concatenate([splats, splats])
    local = torch.randn(twice.means.shape, generator=generator).to(twice.scales) * twice.scales
    offset = (rotation_matrices(twice.quaternions) @ local[:, :, None])[:, :, 0]
    return Splats(
        twice.means + offset,
        twice.quaternions,
        twice.scales / SPLIT_SHRINK,
        twice.opacities,
        twice.sh,
    )


def prune_mask(
    splats: Splats, prune_opacity: float, max_radius: float
) -> tuple[Tensor, PruneReport]:  # [N] bool: keep
    """Return which splats stay, and the reasons for the others."""
    transparent = splats.opacities < prune_opacity
    far = ~transparent & (splats.means.norm(dim=1) > max_radius)
    return ~(transparent | far), PruneReport(int(transparent.sum()), int(far.sum()))
