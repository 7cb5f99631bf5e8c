"""Splats under training from photos.

Conventions
-----------
* As in the original 3DGS, colours are unbounded, and their constant band has its own step size.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from gscomplete.fitting.parameters import SplatParameters
from gscomplete.fitting.row_adam import Rate
from gscomplete.splats import Splats
from splatcomplete_data.multiview.training.settings import LearningRates


class PhotoParameters(SplatParameters):
    """Trainable splats and the optimiser that moves them."""

    fused = True
    _rates: LearningRates

    def raw(self, splats: Splats) -> dict[str, Tensor]:
        """Turn activated splats into raw values by name."""
        values = (
            splats.means,
            splats.quaternions,
            splats.scales.clamp_min(1e-12).log(),
            torch.logit(splats.opacities.clamp(1e-6, 1 - 1e-6)),
            splats.sh,
        )
        pairs = zip(self.names, values, strict=True)
        return {name: value.detach().contiguous() for name, value in pairs}

    def rate(self, name: str) -> Rate:
        """Return Adam's step size of a value; colours have one for each column."""
        if name != "sh":
            return super().rate(name)
        rates = torch.full((self._values["sh"].shape[1], 3), self._rates.sh_rest)
        rates[0] = self._rates.sh_base
        return rates.flatten()

    def first_nonfinite(self) -> str | None:
        """Return the name of the first parameter that is not finite."""
        for name, value in self.values().items():
            if not bool(torch.isfinite(value.sum())):
                return name
        return None

    def lower_opacities(self, limit: float) -> None:
        """Lower opacities to at most ``limit`` and forget how they were moving."""
        logits = self._values["opacity_logits"]
        with torch.no_grad():
            logits.clamp_(max=math.log(limit / (1 - limit)))
        self._adam.forget("opacity_logits")
