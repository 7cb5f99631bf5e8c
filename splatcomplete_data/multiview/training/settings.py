"""Every knob of the training of splats from photos.

Defaults are those of the original 3DGS (Kerbl et al. 2023, 30,000 steps) with its schedules as
shares of ``steps``. Runs of fewer than ``LONG_STEPS`` take larger steps and have no resets of
opacities.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

LONG_STEPS = 12_000
"""Runs of at least this many steps have the step sizes and resets of the original 3DGS."""
_LARGEST_FACTOR = 4.0
"""Most that step sizes are enlarged by in shorter runs."""


@dataclass(frozen=True, slots=True)
class LearningRates:
    """Adam's step sizes."""

    means: float = 1.6e-4
    """Of positions at the start, in units of the scene's extent."""
    means_final: float = 1.6e-6
    """Of positions at the end; in between the logarithm falls evenly."""
    quaternions: float = 1e-3
    log_scales: float = 5e-3
    opacity_logits: float = 5e-2
    sh_base: float = 2.5e-3
    """Of the constant band of colours."""
    sh_rest: float = 1.25e-4
    """Of the bands above."""

    @staticmethod
    def for_steps(steps: int) -> LearningRates:
        """Return the step sizes of a run: the fewer steps, the larger each.

        They grow with the square root of ``LONG_STEPS`` over ``steps``, except for those of
        opacities, which are large enough, and those of positions at the end, so that positions
        become as precise as in long runs.
        """
        factor = min(_LARGEST_FACTOR, max(1.0, math.sqrt(LONG_STEPS / steps)))
        rates = LearningRates()
        moved = ("means", "quaternions", "log_scales", "sh_base", "sh_rest")
        return dataclasses.replace(rates, **{k: factor * getattr(rates, k) for k in moved})


GROWTH_UNTIL_SHARE = 0.6
"""Share of the steps after which no splat is added or removed."""
GRADIENT = 2e-4
"""Splats whose mean screen gradient is larger are divided (loss per half image)."""
PRUNE_OPACITY = 0.005
"""Splats below this opacity are removed."""
SPLIT_EXTENT = 0.01
"""Splats larger than this share of the extent are split, smaller ones cloned."""
PRUNE_EXTENT = 0.1
"""Splats larger than this share of the extent are removed (after the first opacity reset)."""
RESET_OPACITY = 0.01
"""Opacities are lowered to this."""


@dataclass(frozen=True, slots=True)
class GrowthSettings:
    """Where splats are added and removed."""

    max_splats: int = 120_000
    """Never more than this many (gradients decide who is divided first)."""
    from_share: float = 0.04
    """Share of the steps after which splats are first divided."""
    every: int = 100
    """Steps between two divisions; fewer in runs shorter than 18 times this, but at least 10."""
    reset_share: float | None = 0.1
    """In runs of ``LONG_STEPS`` or more, opacities are lowered at intervals of this share of the
    steps while splats are divided; None = never. Splats that are needed recover, floaters do not.
    Shorter runs get worse by it."""


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """Everything that decides the result, given photos and initial splats."""

    steps: int = 3_500
    """Optimiser steps, one photo each."""
    seed: int = 0
    """Order of photos, split splats, and random backgrounds follow from it."""
    ssim_weight: float = 0.2
    """Loss = (1 - this) L1 + this (1 - SSIM)."""
    sh_degree: int = 3
    """Highest degree of the spherical harmonics, 0 to 3."""
    sh_share: float = 1 / 30
    """Share of the steps after which one more degree takes part."""
    half_size_share: float = 0.1
    """Share of the steps, from the first, taken at half the image size."""
    near_extent: float = 0.02
    """Splats nearer to a camera than this share of the extent are not drawn."""
    rates: LearningRates | None = None
    """Adam's step sizes; None = ``LearningRates.for_steps``."""
    growth: GrowthSettings = field(default_factory=GrowthSettings)

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            ValueError: a value is out of range; the message names it.
        """
        checks = {
            "steps": self.steps >= 1,
            "ssim_weight": 0 <= self.ssim_weight <= 1,
            "sh_degree": self.sh_degree in (0, 1, 2, 3),
            "sh_share": self.sh_share >= 0,
            "half_size_share": 0 <= self.half_size_share <= 1,
            "near_extent": 0 < self.near_extent < 1,
            "growth.max_splats": self.growth.max_splats >= 1,
            "growth.every": self.growth.every >= 1,
            "growth.reset_share": self.growth.reset_share is None or self.growth.reset_share > 0,
        }
        for name, passed in checks.items():
            if not passed:
                raise ValueError(f"{name}: out of range")

    @property
    def step_sizes(self) -> LearningRates:
        """Adam's step sizes of this run."""
        return self.rates or LearningRates.for_steps(self.steps)
