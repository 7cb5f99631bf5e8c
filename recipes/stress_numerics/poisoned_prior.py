"""A prior that knows the answer and fails on demand: a test double for completion runs."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from gscomplete.priors.base import Conditioning, FourViews, Guidance
from gscomplete.splats import Splats
from recipes.known_priors.priors import KnownPrior

Poison = Literal["none", "loss", "gradient", "huge gradient", "target"]
"""What goes wrong: a NaN loss, a finite loss whose gradient is NaN or too large for float32 to
square, or a NaN in a pixel of the targets."""
_RESOLUTION_PX = 32


class PoisonedPrior(KnownPrior):
    """Leads every view to a render of a known complete object, until it fails."""

    def __init__(self, truth: Splats, poison: Poison = "none", after: int = 0) -> None:
        """Know an object; the poison comes after this many healthy calls."""
        super().__init__("exact", (truth,), _RESOLUTION_PX)
        self._poison, self._healthy = poison, after

    def distill(
        self,
        views: FourViews,
        timestep: float,
        conditioning: Conditioning,
        generator: torch.Generator,
        input_views: FourViews | None = None,
        guidance: Guidance | None = None,
    ) -> Tensor:
        """Return the distillation loss, or the poison."""
        spoilt = self._is_spoilt()
        if spoilt and self._poison == "loss":
            return views.color.sum() * torch.nan
        if spoilt:
            bad = torch.nan if self._poison == "gradient" else 1e25
            views.color.register_hook(lambda gradient: gradient + bad)
        return super().distill(views, timestep, conditioning, generator, input_views, guidance)

    def reconstruct(
        self,
        views: FourViews,
        timestep: float,
        conditioning: Conditioning,
        generator: torch.Generator,
        input_views: FourViews | None = None,
        guidance: Guidance | None = None,
        num_steps: int = 8,
    ) -> tuple[Tensor, Tensor]:
        """Return clean targets, or the poison."""
        color, alpha = super().reconstruct(
            views, timestep, conditioning, generator, input_views, guidance, num_steps
        )
        if self._is_spoilt():
            color[1, 5, 5, 2] = torch.nan
        return color, alpha

    def _is_spoilt(self) -> bool:
        """Count a call; return whether it is one of those that go wrong."""
        self._healthy -= 1
        return self._poison != "none" and self._healthy < 0
