"""Splats under training from photos, with the colours' constant band apart from the others.

Conventions
-----------
* As in the original 3DGS, colours are unbounded, and their constant band has its own step size.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from gscomplete.fitting.parameters import SplatParameters
from gscomplete.splats import Splats


class PhotoParameters(SplatParameters):
    """Trainable splats and the optimiser that moves them."""

    names = ("means", "quaternions", "log_scales", "opacity_logits", "sh_base", "sh_rest")
    fused = True

    def raw(self, splats: Splats) -> dict[str, Tensor]:
        """Turn activated splats into raw values by name."""
        values = (
            splats.means,
            splats.quaternions,
            splats.scales.clamp_min(1e-12).log(),
            torch.logit(splats.opacities.clamp(1e-6, 1 - 1e-6)),
            splats.sh[:, :1],
            splats.sh[:, 1:],
        )
        pairs = zip(self.names, values, strict=True)
        return {name: value.detach().contiguous() for name, value in pairs}

    def harmonics(self) -> Tensor:  # [N, K, 3]
        """Return the colours, connected to the parameters."""
        return torch.cat([self._values["sh_base"], self._values["sh_rest"]], dim=1)

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
