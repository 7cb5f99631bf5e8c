"""Knobs of fitting splats: step sizes and subdivision.

Conventions
-----------
* Lengths are in the object frame (largest side of the object = 1).
* A stage of a schedule ends at a fraction of all steps, so that one schedule fits any step count.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from gscomplete.errors import UserError


@dataclass(frozen=True, slots=True)
class LearningRates:
    """Adam's step sizes per parameter."""

    means: float = 1e-3
    """Positions at the first step; decays exponentially to ``means_final``."""
    means_final: float = 2e-5
    quaternions: float = 5e-3
    log_scales: float = 5e-3
    opacity_logits: float = 5e-2
    sh: float = 1e-2

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            UserError: a rate is not positive and finite.
        """
        for field in dataclasses.fields(self):
            rate = getattr(self, field.name)
            if not 0.0 < rate < math.inf:
                raise UserError(f"learning_rates.{field.name}: expected above 0, found {rate}")


@dataclass(frozen=True, slots=True)
class DensifySettings:
    """Adaptive subdivision of new splats (paper section 3.3, Kerbl et al. 2023)."""

    until: float = 0.25
    """Fraction of all steps after which splats are no longer subdivided."""
    every: int = 50
    """Steps between subdivisions, and between prunings (which go on to the end)."""
    growth: float = 0.15
    """Largest share of the splats subdivided at once."""
    max_new: int = 150_000
    """Hard cap on new splats."""
    split_scale: float = 0.02
    """Splats with a larger scale are split in two smaller ones, others are cloned."""
    final_from: float = 1.0
    """From this fraction of all steps on, ``densify.FINAL_OPACITY`` takes the place of
    ``PRUNE_OPACITY``, so that what is left of failed splats does not stay as dust."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            UserError: a value is outside its range.
        """
        for name in ("until", "growth", "final_from"):
            if not 0 <= getattr(self, name) <= 1:
                raise UserError(f"densify.{name}: expected 0 to 1, found {getattr(self, name)}")
        for name, low in (("every", 1), ("max_new", 0), ("split_scale", 0)):
            value = getattr(self, name)
            if not low <= value < math.inf:
                raise UserError(f"densify.{name}: expected at least {low}, found {value}")
