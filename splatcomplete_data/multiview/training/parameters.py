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

    def rates(self) -> dict[str, Rate]:
        """Return Adam's step sizes at the start by name."""
        bands = self._values["sh"].shape[1]
        sh = torch.full((bands, 3), self._rates.sh_rest)
        sh[0] = self._rates.sh_base
        rates = {name: getattr(self._rates, name) for name in self.names if name != "sh"}
        rates["means"] *= self._length_unit
        return {**rates, "sh": sh.flatten()}

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
