"""Choose the largest of many amounts, up to a share or an amount of their sum."""

from __future__ import annotations

import torch
from torch import Tensor

from gscomplete.util.same_bits import fixed_sum


def largest_share(amounts: Tensor, share: float) -> Tensor:  # [N] >= 0 -> [N] bool
    """Mark the fewest amounts that make up a share of their sum."""
    order = torch.argsort(amounts, descending=True, stable=True)
    before = amounts[order].double().cumsum(0) - amounts[order].double()
    marked = torch.zeros_like(amounts, dtype=torch.bool)
    marked[order] = (before < share * fixed_sum(amounts.double())) & (amounts[order] > 0)
    return marked


def enough_of(amounts: Tensor, needed: float) -> Tensor:  # [N] -> [N] bool
    """Mark the fewest positive amounts whose sum is at least ``needed``; all if they fall short."""
    order = torch.argsort(amounts, descending=True, stable=True)
    positive = amounts[order].clamp_min(0.0).double()
    marked = torch.zeros_like(amounts, dtype=torch.bool)
    marked[order] = (positive.cumsum(0) - positive < needed) & (positive > 0)
    return marked
