"""A prior that knows the answer, and can be told to fail: a test object for runs."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from gscomplete.priors.base import Conditioning, FourViews, Guidance, PriorViews
from gscomplete.render import render
from gscomplete.splats import Splats

Poison = Literal["none", "loss", "gradient", "huge gradient", "target"]
"""What goes wrong: a NaN loss, a finite loss whose gradient is NaN or too large for float32 to
square, or a NaN in a pixel of the targets."""


class NoPrompt:
    """The conditioning of a prior that needs no prompt."""

    report = ("the known object needs no prompt",)


class KnownObject:
    """Denoises every view to a render of a known complete object."""

    name = "known object"
    sees_input = False
    num_timesteps = 1000
    views = PriorViews(40.0, (1.4, 1.8), (-5.0, 30.0), 32)

    def __init__(self, truth: Splats, poison: Poison = "none", after: int = 0) -> None:
        """Know an object; the poison comes after this many healthy calls."""
        self._truth, self._poison, self._healthy = truth, poison, after

    def default_guidance(self, *, sees_input: bool) -> Guidance:
        """Return scales that are never used."""
        return Guidance()

    def condition(self, prompt: str, negative_prompt: str | None = None) -> Conditioning:
        """Take any prompt."""
        return NoPrompt()

    def distill(
        self,
        views: FourViews,
        timestep: float,
        conditioning: Conditioning,
        generator: torch.Generator,
        input_views: FourViews | None = None,
        guidance: Guidance | None = None,
    ) -> Tensor:
        """Return the squared distance to renders of the known object, or the poison."""
        spoilt = self._is_spoilt()
        if spoilt and self._poison == "loss":
            return views.color.sum() * torch.nan
        if spoilt:
            bad = torch.nan if self._poison == "gradient" else 1e25
            views.color.register_hook(lambda gradient: gradient + bad)
        with torch.no_grad():
            truth = render(self._truth, views.cameras)
        color, alpha = views.color - truth.color, views.alpha - truth.alpha
        return 0.5 * (color.square().sum() + alpha.square().sum()) / 4

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
        """Return renders of the known object, or the poison."""
        truth = render(self._truth, views.cameras)
        color = truth.color.clone()
        if self._is_spoilt():
            color[1, 5, 5, 2] = torch.nan
        return color, truth.alpha

    def _is_spoilt(self) -> bool:
        """Count a call; return whether it is one of those that go wrong."""
        self._healthy -= 1
        return self._poison != "none" and self._healthy < 0
