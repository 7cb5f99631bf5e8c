"""Adam over named tensors whose rows come and go.

Conventions
-----------
* Every value has one row per splat; Adam's first and second moments follow their rows, and rows
  that are added start at rest.
* The numbers are those of ``torch.optim.Adam``, bit for bit. That class loads PyTorch's compiler on
  its first use, which takes longer than many runs that take no step.
* A state is flat, for checkpoints: ``value.NAME`` and ``adam.NAME.KEY``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import torch
from torch import Tensor

MOMENTS = ("exp_avg", "exp_avg_sq")
_BETAS = (0.9, 0.999)
_EPS = 1e-15


class RowAdam:
    """The optimiser of one set of values; rows are edited by making another."""

    def __init__(
        self, values: Mapping[str, Tensor], rates: Mapping[str, float], *, fused: bool = False
    ) -> None:
        """Start at rest.

        Args:
            values: what is moved, in place; each requires a gradient.
            rates: step size of each, which may be changed between steps.
            fused: update each tensor in one pass: faster for many rows, other roundings.
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
            update = self._update_fused if self._fused else _update
            update(value, gradient, self.moments[name], self.rates[name])

    def forget(self, name: str) -> None:
        """Put one value at rest, as if it had never moved; its count goes on."""
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


def _update(value: Tensor, gradient: Tensor, moments: dict[str, Tensor], rate: float) -> None:
    """Move one value."""
    first, second = _BETAS
    moments["step"] += 1
    step = moments["step"].item()
    mean, square = moments["exp_avg"], moments["exp_avg_sq"]
    mean.lerp_(gradient, 1 - first)
    square.mul_(second).addcmul_(gradient, gradient, value=1 - second)
    deviation = (square.sqrt() / (1 - second**step) ** 0.5).add_(_EPS)
    value.addcdiv_(mean, deviation, value=-(rate / (1 - first**step)))


def values_of(state: Mapping[str, Tensor], names: Iterable[str]) -> dict[str, Tensor]:
    """Return fresh trainable values of a flat state."""
    return {name: state[f"value.{name}"].clone().requires_grad_() for name in names}
