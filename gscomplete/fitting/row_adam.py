"""Adam over named tensors whose rows come and go.

Conventions
-----------
* Every value has one row per splat; Adam's first and second moments follow their rows, and the
  moments of added rows start at zero ("at rest").
* Results equal those of ``torch.optim.Adam`` bit for bit (with rates that differ by column, within
  rounding). This class exists because ``torch.optim.Adam`` loads PyTorch's compiler on its first
  use, which takes longer than many a run that takes no step.
* A step size is a number, or [C]: one for each column of a value's rows.
* A state is flat, for checkpoints: ``value.NAME`` and ``adam.NAME.KEY``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from gscomplete.util.kernels import KERNEL, run_kernel

Rate = float | Tensor

MOMENTS = ("exp_avg", "exp_avg_sq")
_BETAS = (0.9, 0.999)
_EPS = 1e-15
_ROWS_PER_RUN = 4096
"""Fewest rows that are handed to a thread at once."""


class RowAdam:
    """The optimiser of one set of values; rows are edited by making another."""

    def __init__(
        self, values: Mapping[str, Tensor], rates: Mapping[str, Rate], *, fused: bool = False
    ) -> None:
        """Start at rest.

        Args:
            values: what is moved, in place; each requires a gradient.
            rates: step size of each, which may be changed between steps.
            fused: update each tensor in one pass: faster for many rows, but rounded differently.
        """
        self.values, self.rates = dict(values), dict(rates)
        self.moments: dict[str, dict[str, Tensor]] = {}
        """Of the values that were moved: ``step``, a count, and ``MOMENTS``."""
        self._fused = fused

    @torch.no_grad()
    def step(self) -> None:
        """Move the values that have a gradient, and forget the gradients."""
        for name, value in self.values.items():
            gradient, value.grad = value.grad, None
            if gradient is None:
                continue
            if name not in self.moments:
                at_rest = {key: torch.zeros_like(value) for key in MOMENTS}
                count = torch.zeros((), device=value.device if self._fused else "cpu")
                self.moments[name] = {"step": count, **at_rest}
            rate, moments = self.rates[name], self.moments[name]
            if not isinstance(rate, Tensor):
                update = self._update_fused if self._fused else _update
                update(value, gradient, moments, rate)
            elif value.device.type == "cpu":
                _update_columns(value, gradient, moments, rate)
            else:
                _update(value, gradient, moments, rate.to(value.device))

    def forget(self, name: str) -> None:
        """Set one value's moments to zero, as if it had never moved; its step count goes on."""
        for key in MOMENTS:
            if name in self.moments:
                self.moments[name][key].zero_()

    def with_rows(self, values: Mapping[str, Tensor], keep: Tensor, added: int) -> RowAdam:
        """Return the optimiser of edited values: kept rows, then ``added`` ones at rest.

        Args:
            values: the edited ones.
            keep: [N] bool, the rows that are left.
            added: how many follow them.
        """
        new = RowAdam(values, self.rates, fused=self._fused)
        for name, old in self.moments.items():
            new.moments[name] = dict(old)
            for key in MOMENTS:
                rows = old[key][keep]
                rows = torch.cat([rows, rows.new_zeros(added, *rows.shape[1:])])
                new.moments[name][key] = rows
        return new

    def flat_state(self) -> dict[str, Tensor]:
        """Return values and moments by flat names."""
        out = {f"value.{name}": value.detach() for name, value in self.values.items()}
        for name, moments in self.moments.items():
            for key, moment in moments.items():
                out[f"adam.{name}.{key}"] = moment
        return out

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take the moments of a flat state."""
        for name in self.values:
            prefix = f"adam.{name}."
            moments = {
                k[len(prefix) :]: v.clone() for k, v in state.items() if k.startswith(prefix)
            }
            if moments:
                self.moments[name] = moments

    @staticmethod
    def _update_fused(
        value: Tensor, gradient: Tensor, moments: dict[str, Tensor], rate: float
    ) -> None:
        """Move one value in one pass."""
        moments["step"] += 1
        torch._fused_adam_(
            [value],
            [gradient],
            [moments["exp_avg"]],
            [moments["exp_avg_sq"]],
            [],
            [moments["step"]],
            amsgrad=False,
            lr=rate,
            beta1=_BETAS[0],
            beta2=_BETAS[1],
            weight_decay=0.0,
            eps=_EPS,
            maximize=False,
        )


def _update(value: Tensor, gradient: Tensor, moments: dict[str, Tensor], rate: Rate) -> None:
    """Move one value."""
    first, second = _BETAS
    moments["step"] += 1
    step = moments["step"].item()
    mean, square = moments["exp_avg"], moments["exp_avg_sq"]
    mean.lerp_(gradient, 1 - first)
    square.mul_(second).addcmul_(gradient, gradient, value=1 - second)
    deviation = (square.sqrt() / (1 - second**step) ** 0.5).add_(_EPS)
    if isinstance(rate, Tensor):
        scaled = mean / (1 - first**step) * rate.reshape(value.shape[1:])
        value.addcdiv_(scaled, deviation, value=-1.0)
    else:
        value.addcdiv_(mean, deviation, value=-(rate / (1 - first**step)))


def _update_columns(
    value: Tensor, gradient: Tensor, moments: dict[str, Tensor], rate: Tensor
) -> None:
    """Move one value on the CPU in one pass, each column at its own rate."""
    first, second = _BETAS
    moments["step"] += 1
    step = moments["step"].item()
    arrays = (value.detach(), gradient.contiguous(), *(moments[key] for key in MOMENTS))
    rows = [array.numpy().reshape(len(value), -1) for array in arrays]
    rates = (rate.double() / (1 - first**step)).float().numpy()
    scale = np.float32((1 - second**step) ** -0.5)
    run_kernel(_move_rows, len(value), _ROWS_PER_RUN, *rows, rates, scale)


@numba.njit(**KERNEL)
def _move_rows(
    first: int,
    last: int,
    value: Any,  # [N, C] float32, moved
    gradient: Any,  # [N, C]
    mean: Any,  # [N, C] moments, moved along
    square: Any,
    rates: Any,  # [C] over the bias of the means
    scale: Any,  # float32: of the deviations, for their bias
) -> None:
    """Do Adam's step for the rows from ``first`` up to ``last``."""
    keep, add = np.float32(_BETAS[1]), np.float32(1 - _BETAS[1])
    move, eps = np.float32(1 - _BETAS[0]), np.float32(_EPS)
    for i in range(first, last):
        for c in range(np.uint64(0), np.uint64(value.shape[1])):
            g = gradient[i, c]
            m = mean[i, c] + move * (g - mean[i, c])
            s = keep * square[i, c] + add * g * g
            mean[i, c], square[i, c] = m, s
            value[i, c] -= rates[c] * m / (np.sqrt(s) * scale + eps)


def values_of(state: Mapping[str, Tensor], names: Iterable[str]) -> dict[str, Tensor]:
    """Return fresh trainable values of a flat state."""
    return {name: state[f"value.{name}"].clone().requires_grad_() for name in names}
