"""Splats under training from photos: raw values, Adam, and edits of rows.

Conventions
-----------
* Raw values are logits of opacities and logarithms of scales; nothing else here uses them.
* Colours are unbounded and their constant band has its own step size, as in the original 3DGS
  (``completion.parameters``, which keeps new splats within bounds, differs in both).
* Rows of Adam's moments follow the rows of the splats; new rows start at zero.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from gscomplete.fitting.row_adam import (
    MOMENTS,
    carry_moments,
    flat_state,
    restore_moments,
    values_of,
)
from gscomplete.splats import Splats
from gscomplete.util.same_bits import fixed_sigmoid
from splatcomplete_data.multiview.training.settings import LearningRates

NAMES = ("means", "quaternions", "log_scales", "opacity_logits", "sh_base", "sh_rest")
ADAM_EPS = 1e-15


class GaussianParameters:
    """Trainable splats and the optimiser that moves them."""

    def __init__(self, splats: Splats, rates: LearningRates, extent: float) -> None:
        """Start from activated splats; ``extent`` scales the step size of positions."""
        self._rates, self._extent = rates, extent
        values = _raw(splats)
        self._values = {name: value.clone().requires_grad_() for name, value in values.items()}
        self._adam = self._new_adam()

    def __len__(self) -> int:
        """Return the number of splats."""
        return int(self._values["means"].shape[0])

    def splats(self, degree: int | None = None) -> Splats:
        """Return activated splats connected to the parameters, with harmonics up to ``degree``."""
        value = self._values
        rest = value["sh_rest"]
        if degree is not None:
            rest = rest[:, : (degree + 1) ** 2 - 1]
        return Splats(
            value["means"],
            torch.nn.functional.normalize(value["quaternions"], dim=1),
            value["log_scales"].exp(),
            fixed_sigmoid(value["opacity_logits"]),
            torch.cat([value["sh_base"], rest], dim=1),
        )

    def step(self, progress: float) -> None:
        """Apply one Adam step with the rates of ``progress`` (0 to 1)."""
        for group in self._adam.param_groups:
            if group["name"] == "means":
                low, high = math.log(self._rates.means_final), math.log(self._rates.means)
                group["lr"] = self._extent * math.exp(high + (low - high) * progress)
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def first_nonfinite(self) -> str | None:
        """Return the name of the first parameter that is not finite."""
        for name, value in self._values.items():
            if not bool(torch.isfinite(value.detach().sum())):
                return name
        return None

    def edit(self, keep: Tensor, new: Splats | None = None) -> None:  # keep: [N] bool
        """Keep the rows of ``keep`` and append new splats after them."""
        values = {name: value.detach()[keep] for name, value in self._values.items()}
        added = 0
        if new is not None:
            added = len(new)
            raw = _raw(new)
            values = {name: torch.cat([value, raw[name]]) for name, value in values.items()}
        old_values, old_adam = self._values, self._adam
        self._values = {name: value.clone().requires_grad_() for name, value in values.items()}
        self._adam = self._new_adam()
        carry_moments(old_values, old_adam, self._values, self._adam, keep, added)

    def lower_opacities(self, limit: float) -> None:
        """Lower opacities to at most ``limit`` and forget how they were moving."""
        logits = self._values["opacity_logits"]
        with torch.no_grad():
            logits.clamp_(max=math.log(limit / (1 - limit)))
        for key in MOMENTS:
            if key in self._adam.state.get(logits, {}):
                self._adam.state[logits][key].zero_()

    def state(self) -> dict[str, Tensor]:
        """Return values and moments for a checkpoint."""
        return flat_state(self._values, self._adam)

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take values and moments from :meth:`state`."""
        self._values = values_of(state, NAMES)
        self._adam = self._new_adam()
        restore_moments(state, self._values, self._adam)

    def _new_adam(self) -> torch.optim.Adam:
        groups = [
            {
                "params": [value],
                "lr": getattr(self._rates, name) * (self._extent if name == "means" else 1.0),
                "name": name,
            }
            for name, value in self._values.items()
        ]
        return torch.optim.Adam(groups, eps=ADAM_EPS, fused=True)


def _raw(splats: Splats) -> dict[str, Tensor]:
    """Turn activated splats into raw values."""
    values = (
        splats.means,
        splats.quaternions,
        splats.scales.clamp_min(1e-12).log(),
        torch.logit(splats.opacities.clamp(1e-6, 1 - 1e-6)),
        splats.sh[:, :1],
        splats.sh[:, 1:],
    )
    return {n: value.detach().contiguous() for n, value in zip(NAMES, values, strict=True)}
