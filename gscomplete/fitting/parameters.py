"""Splats as optimiser parameters: raw values, Adam, and edits of rows.

Conventions
-----------
* Raw values are logits of opacities and logarithms of scales; nothing else here uses them.
* ``SplatParameters`` has all that optimisations share, ``BoundedParameters`` the bounds of new
  splats; training from photos has its own (``splatcomplete_data.multiview.training.parameters``).
* Rows of Adam's moments follow the rows of the splats; rows that are added start at zero.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from gscomplete.fitting.row_adam import Rate, RowAdam, values_of
from gscomplete.fitting.settings import LearningRates
from gscomplete.splats import SH_C0, Splats
from gscomplete.util.same_bits import fixed_sigmoid


class Rates(Protocol):
    """Adam's step sizes: besides these two, those that :meth:`SplatParameters.rate` reads."""

    @property
    def means(self) -> float:
        """Step size of positions at the start."""

    @property
    def means_final(self) -> float:
        """Step size of positions at the end; in between its logarithm is interpolated linearly."""


class SplatParameters:
    """Trainable splats and the optimiser that moves them."""

    names: tuple[str, ...] = ("means", "quaternions", "log_scales", "opacity_logits", "sh")
    fused = False
    """Whether Adam updates each tensor in one pass: faster for many splats, other roundings."""

    def __init__(self, splats: Splats, rates: Rates, length_unit: float = 1.0) -> None:
        """Start from activated splats.

        Args:
            splats: where they start.
            rates: Adam's step sizes.
            length_unit: what the step sizes of positions are multiples of.
        """
        self._rates, self._length_unit = rates, length_unit
        self._values = {
            name: value.clone().requires_grad_() for name, value in self.raw(splats).items()
        }
        self._adam = self._new_adam()

    def __len__(self) -> int:
        """Return the number of splats."""
        return int(self._values["means"].shape[0])

    def raw(self, splats: Splats) -> dict[str, Tensor]:
        """Turn activated splats into raw values by name."""
        values = (
            splats.means,
            splats.quaternions,
            splats.scales.clamp_min(1e-9).log(),
            torch.logit(splats.opacities.clamp(1e-4, 1 - 1e-4)),
            splats.sh,
        )
        return {name: value.detach() for name, value in zip(self.names, values, strict=True)}

    def splats(self, degree: int | None = None) -> Splats:
        """Return activated splats connected to the parameters, with harmonics up to ``degree``."""
        value = self._values
        bands = value["sh"].shape[1] if degree is None else (degree + 1) ** 2
        # A slice of all bands would be copied on the way back.
        sh = value["sh"] if bands == value["sh"].shape[1] else value["sh"][:, :bands]
        return Splats(
            value["means"],
            torch.nn.functional.normalize(value["quaternions"], dim=1),
            value["log_scales"].exp(),
            fixed_sigmoid(value["opacity_logits"]),
            sh,
        )

    def step(self, progress: float) -> None:
        """Apply one Adam step with the rates of ``progress`` (0 to 1)."""
        low, high = math.log(self._rates.means_final), math.log(self._rates.means)
        self._adam.rates["means"] = self._length_unit * math.exp(high + (low - high) * progress)
        self._adam.step()

    def values(self) -> dict[str, Tensor]:
        """Return the raw values by name."""
        return {name: value.detach() for name, value in self._values.items()}

    def gradients(self) -> dict[str, Tensor | None]:
        """Return the gradients of the raw values by name."""
        return {f"gradient of {name}": value.grad for name, value in self._values.items()}

    def edit(self, keep: Tensor, new: Splats | None = None) -> None:  # keep: [N] bool
        """Keep the rows of ``keep`` and append new splats after them."""
        values = {name: value.detach()[keep] for name, value in self._values.items()}
        if new is not None:
            raw = self.raw(new)
            values = {name: torch.cat([value, raw[name]]) for name, value in values.items()}
        self._values = {name: value.clone().requires_grad_() for name, value in values.items()}
        self._adam = self._adam.with_rows(self._values, keep, 0 if new is None else len(new))

    def state(self) -> dict[str, Tensor]:
        """Return values and moments for a checkpoint."""
        return self._adam.flat_state()

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take values and moments from :meth:`state`."""
        self._values = values_of(state, self.names)
        self._adam = self._new_adam()
        self._adam.restore(state)

    def rate(self, name: str) -> Rate:
        """Return Adam's step size of a value, of positions in length units."""
        rate: float = getattr(self._rates, name)
        return rate

    def _new_adam(self) -> RowAdam:
        rates = {name: self.rate(name) for name in self._values}
        rates["means"] *= self._length_unit
        return RowAdam(self._values, rates, fused=self.fused)


def splats_of_state(state: dict[str, Tensor]) -> Splats:
    """Return the activated splats of a completion's checkpoint, in the object frame."""
    value = {name.removeprefix("value."): tensor for name, tensor in state.items()}
    return Splats(
        value["means"],
        torch.nn.functional.normalize(value["quaternions"], dim=1),
        value["log_scales"].exp(),
        fixed_sigmoid(value["opacity_logits"]),
        value["sh"],
    )


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits that every new splat keeps to, in object-frame units."""

    min_scale: float
    max_scale: float

    def clamped(self, splats: Splats) -> Splats:
        """Return splats whose scales are within the bounds."""
        scales = splats.scales.clamp(max(self.min_scale, 1e-9), self.max_scale)
        return dataclasses.replace(splats, scales=scales)


class BoundedParameters(SplatParameters):
    """Splats that are projected onto their bounds after every step.

    So bounds on scales, colours and quaternion lengths hold exactly, without a saturating function,
    whose gradient vanishes near its bounds.
    """

    def __init__(self, splats: Splats, rates: LearningRates, bounds: Bounds) -> None:
        """Start from activated splats; see :class:`SplatParameters`."""
        self.bounds = bounds
        super().__init__(splats, rates)

    def raw(self, splats: Splats) -> dict[str, Tensor]:
        """Turn activated splats into raw values by name, within the bounds."""
        return super().raw(self.bounds.clamped(splats))

    def step(self, progress: float) -> None:
        """Apply one Adam step with the rates of ``progress`` (0 to 1), then the bounds."""
        super().step(progress)
        self._project()

    @torch.no_grad()
    def _project(self) -> None:
        low = math.log(max(self.bounds.min_scale, 1e-9))
        self._values["log_scales"].clamp_(low, math.log(self.bounds.max_scale))
        self._values["opacity_logits"].clamp_(-12.0, 12.0)
        limit = 0.5 / SH_C0
        self._values["sh"][:, 0].clamp_(-limit, limit)
        quaternions = self._values["quaternions"]
        quaternions.copy_(torch.nn.functional.normalize(quaternions, dim=1))
