"""PyTorch operations whose rounding depends on the number of threads, here with a fixed rounding.

Conventions
-----------
* On the CPU, PyTorch sums all elements of a large tensor, and the channels-last features of a group
  norm, in as many parts as there are threads. Sums over only some dimensions are safe, since one
  thread computes each result.
* Processors with a matrix unit (AMX) split the long inner sums of a matrix product into as many
  parts as there are threads, if the product itself is too small to be divided among them.
* Sigmoids, SiLUs, softmaxes over the first dimension and fractional powers of 32,768 elements and
  more are safe only in one thread, because the last elements of each thread's part are rounded
  differently from the others. Exponentials, logarithms and arithmetic are safe.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor, nn

_ROW = 4096
"""Elements that are added up by one thread; PyTorch divides sums of 32,768 and more."""


def fixed_sum(values: Tensor) -> Tensor:  # [...] -> []
    """Return the sum of all elements, with graph."""
    values = values.reshape(-1)
    while len(values) > _ROW:
        missing = -len(values) % _ROW
        rows = F.pad(values, (0, missing)) if missing else values
        values = rows.reshape(-1, _ROW).sum(dim=1)
    return values.sum()


def fixed_mean(values: Tensor) -> Tensor:  # [...] -> []
    """Return the mean of all elements, with graph."""
    return fixed_sum(values) / values.numel()


def fixed_sigmoid(values: Tensor) -> Tensor:  # [...] -> [...]
    """Return the sigmoid, with graph."""
    with one_thread(values):
        return torch.sigmoid(values)


def fixed_silu(values: Tensor) -> Tensor:  # [...] -> [...]
    """Return values times their sigmoids, with graph."""
    with one_thread(values):
        return F.silu(values)


def fixed_softmax(logits: Tensor, dim: int) -> Tensor:  # [...] -> [...]
    """Return the softmax over a dimension, with graph."""
    with one_thread(logits):
        return logits.softmax(dim)


def fixed_power(values: Tensor, exponent: float) -> Tensor:  # [...] -> [...]
    """Return values to a power, with graph."""
    with one_thread(values):
        return values**exponent


class GroupNorm(nn.GroupNorm):
    """A group norm that one thread computes on the CPU, which costs a network little time."""

    def forward(self, input: Tensor) -> Tensor:  # noqa: A002  # [B, C, ...]
        """Return the normalised features."""
        with one_thread(input):
            return super().forward(input)


class Linear(nn.Linear):
    """A linear layer of many inputs and few outputs that one thread computes on the CPU."""

    def forward(self, input: Tensor) -> Tensor:  # noqa: A002  # [..., K] -> [..., N]
        """Return the products."""
        with one_thread(input):
            return super().forward(input)


@contextlib.contextmanager
def one_thread(values: Tensor) -> Iterator[None]:
    """Limit PyTorch to one thread within the block, if ``values`` are on the CPU."""
    if values.device.type != "cpu":
        yield
        return
    before = torch.get_num_threads()
    if before == 1:
        yield
        return
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
