"""The new splats as optimiser parameters: raw values, Adam, and edits of rows.

Conventions
-----------
* Raw values are logits of opacities and logarithms of scales; nothing else here uses them.
* After every step values are projected onto their bounds (scales, colours, quaternion length), so
  a bound holds exactly and no saturating function slows the gradient.
* Rows of Adam's moments follow the rows of the splats; copies made by subdivision start at zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.fitting.row_adam import (
    carry_moments,
    flat_state,
    restore_moments,
    values_of,
)
from gscomplete.fitting.settings import LearningRates
from gscomplete.splats import SH_C0, Splats
from gscomplete.util.same_bits import fixed_sigmoid

NAMES = ("means", "quaternions", "log_scales", "opacity_logits", "sh")
ADAM_EPS = 1e-15


@dataclass(frozen=True, slots=True)
class Bounds:
    """What every new splat keeps to, in object-frame units."""

    min_scale: float
    max_scale: float


class SplatParameters:
    """Trainable splats and the optimiser that moves them."""

    def __init__(self, splats: Splats, bounds: Bounds, rates: LearningRates) -> None:
        """Start from activated splats."""
        self.bounds = bounds
        self._rates = rates
        opacities = splats.opacities.clamp(1e-4, 1 - 1e-4)
        values = (
            splats.means,
            splats.quaternions,
            splats.scales.clamp(max(bounds.min_scale, 1e-9), bounds.max_scale).log(),
            torch.logit(opacities),
            splats.sh,
        )
        self._values = {
            name: value.detach().clone().requires_grad_()
            for name, value in zip(NAMES, values, strict=True)
        }
        self._adam = self._new_adam()

    def __len__(self) -> int:
        """Return the number of splats."""
        return int(self._values["means"].shape[0])

    def splats(self) -> Splats:
        """Return the splats with activated values, connected to the parameters."""
        value = self._values
        return Splats(
            value["means"],
            torch.nn.functional.normalize(value["quaternions"], dim=1),
            value["log_scales"].exp(),
            fixed_sigmoid(value["opacity_logits"]),
            value["sh"],
        )

    def step(self, progress: float) -> None:
        """Apply one Adam step with the rates of ``progress`` (0 to 1), then the bounds."""
        for group in self._adam.param_groups:
            if group["name"] == "means":
                low, high = math.log(self._rates.means_final), math.log(self._rates.means)
                group["lr"] = math.exp(high + (low - high) * progress)
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)
        self._project()

    def values(self) -> dict[str, Tensor]:
        """Return the raw values by name."""
        return {name: value.detach() for name, value in self._values.items()}

    def gradients(self) -> dict[str, Tensor | None]:
        """Return the gradients of the raw values by name."""
        return {f"gradient of {name}": value.grad for name, value in self._values.items()}

    def keep(self, mask: Tensor) -> None:  # [N] bool
        """Keep the rows of ``mask``."""
        self._edit({name: value.detach()[mask] for name, value in self._values.items()}, mask, 0)

    def extend(self, splats: Splats, keep: Tensor) -> None:  # keep: [N] bool
        """Keep the rows of ``keep`` and append new splats after them."""
        new = SplatParameters(splats, self.bounds, self._rates)
        joined = {
            name: torch.cat([value.detach()[keep], new._values[name].detach()])
            for name, value in self._values.items()
        }
        self._edit(joined, keep, len(splats))

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
            {"params": [value], "lr": getattr(self._rates, name), "name": name}
            for name, value in self._values.items()
        ]
        return torch.optim.Adam(groups, eps=ADAM_EPS, foreach=False)

    def _edit(self, values: dict[str, Tensor], keep: Tensor, added: int) -> None:
        """Replace all values, carrying the kept rows' moments along."""
        old_values, old_adam = self._values, self._adam
        self._values = {name: value.clone().requires_grad_() for name, value in values.items()}
        self._adam = self._new_adam()
        carry_moments(old_values, old_adam, self._values, self._adam, keep, added)

    @torch.no_grad()
    def _project(self) -> None:
        low = math.log(max(self.bounds.min_scale, 1e-9))
        self._values["log_scales"].clamp_(low, math.log(self.bounds.max_scale))
        self._values["opacity_logits"].clamp_(-12.0, 12.0)
        limit = 0.5 / SH_C0
        self._values["sh"][:, 0].clamp_(-limit, limit)
        quaternions = self._values["quaternions"]
        quaternions.copy_(torch.nn.functional.normalize(quaternions, dim=1))
