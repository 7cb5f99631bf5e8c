"""Adam over named tensors whose rows come and go.

Conventions
-----------
* Every value has one row per splat; Adam's first and second moments follow their rows, and rows
  that are added start at rest.
* A state is flat, for checkpoints: ``value.NAME`` and ``adam.NAME.KEY``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import torch
from torch import Tensor

MOMENTS = ("exp_avg", "exp_avg_sq")


def carry_moments(
    old_values: Mapping[str, Tensor],
    old: torch.optim.Optimizer,
    values: Mapping[str, Tensor],
    new: torch.optim.Optimizer,
    keep: Tensor,  # [N] bool
    added: int,
) -> None:
    """Give a new optimiser the moments of the kept rows, and none for the ``added`` ones."""
    for name, value in old_values.items():
        if value not in old.state:
            continue
        moments = dict(old.state[value])
        for key in MOMENTS:
            rows = moments[key][keep]
            moments[key] = torch.cat([rows, rows.new_zeros(added, *rows.shape[1:])])
        new.state[values[name]] = moments


def flat_state(values: Mapping[str, Tensor], adam: torch.optim.Optimizer) -> dict[str, Tensor]:
    """Return values and moments by flat names."""
    out = {f"value.{name}": value.detach() for name, value in values.items()}
    for name, value in values.items():
        for key, moment in adam.state.get(value, {}).items():
            out[f"adam.{name}.{key}"] = moment
    return out


def values_of(state: Mapping[str, Tensor], names: Iterable[str]) -> dict[str, Tensor]:
    """Return fresh trainable values of a flat state."""
    return {name: state[f"value.{name}"].clone().requires_grad_() for name in names}


def restore_moments(
    state: Mapping[str, Tensor], values: Mapping[str, Tensor], adam: torch.optim.Optimizer
) -> None:
    """Give a new optimiser the moments of a flat state."""
    for name, value in values.items():
        prefix = f"adam.{name}."
        moments = {k[len(prefix) :]: v.clone() for k, v in state.items() if k.startswith(prefix)}
        if moments:
            adam.state[value] = moments
