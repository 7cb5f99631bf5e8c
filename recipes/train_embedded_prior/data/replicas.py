"""Data-parallel training on one machine: single-threaded replicas that share gradients.

In one process with many threads, the threads would meet at a barrier in every operation, and a
single busy neighbour on one core made a training step 45 times slower. Replicas meet only once per
step.

Conventions
-----------
* Every replica holds the whole state and makes the same update from the same summed gradients, in
  replica order, so all stay equal bit for bit.
* Two sets of buffers are used in turn. A replica that writes the buffers for step s + 2 has passed
  the meeting of step s + 1, which all replicas reach only after they have read the buffers of step
  s.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from gscomplete.errors import UserError

_TIMEOUT_S = 900.0


@dataclass(frozen=True, slots=True)
class Signals:
    """What the first replica tells all at each meeting."""

    progress: float
    stop: bool


@dataclass(frozen=True, slots=True)
class GradientExchange:
    """Shared memory and a meeting point; picklable to spawned processes."""

    gradients: Tensor  # [2, R, P] shared
    losses: Tensor  # [2, R] shared
    signals: Tensor  # [2, 2] shared: progress, stop
    barrier: Any

    @classmethod
    def create(cls, context: Any, replicas: int, parameters: Iterable[nn.Parameter]) -> Any:
        """Allocate for a model's parameters."""
        count = sum(parameter.numel() for parameter in parameters)
        return cls(
            torch.zeros(2, replicas, count).share_memory_(),
            torch.zeros(2, replicas, dtype=torch.float64).share_memory_(),
            torch.zeros(2, 2, dtype=torch.float64).share_memory_(),
            context.Barrier(replicas),
        )

    def average(
        self, step: int, rank: int, parameters: list[nn.Parameter], loss: float, signals: Signals
    ) -> tuple[float, Signals]:
        """Replace the parameters' gradients by the mean over replicas.

        Args:
            step: number of the step, equal in all replicas.
            rank: this replica; replica 0's signals count.
            parameters: the model's, with gradients.
            loss: this replica's loss.
            signals: what this replica would tell the others.

        Returns:
            The mean loss and replica 0's signals.

        Raises:
            UserError: another replica is gone.
        """
        turn = step % 2
        row = self.gradients[turn, rank]
        offset = 0
        for parameter in parameters:
            if parameter.grad is not None:
                row[offset : offset + parameter.numel()].copy_(_flat(parameter.grad))
            offset += parameter.numel()
        self.losses[turn, rank] = loss
        if rank == 0:
            self.signals[turn, 0] = signals.progress
            self.signals[turn, 1] = float(signals.stop)
        try:
            self.barrier.wait(_TIMEOUT_S)
        except threading.BrokenBarrierError as error:
            raise UserError("training: another replica of the trainer has gone") from error
        mean = self.gradients[turn].mean(dim=0)
        offset = 0
        for parameter in parameters:
            part = mean[offset : offset + parameter.numel()]
            if parameter.grad is not None:
                _flat(parameter.grad).copy_(part)
            offset += parameter.numel()
        told = self.signals[turn]
        return float(self.losses[turn].mean()), Signals(float(told[0]), bool(told[1]))


def _flat(gradient: Tensor) -> Tensor:
    """View a gradient as a vector in memory order, whatever its layout."""
    if gradient.is_contiguous():
        return gradient.view(-1)
    if gradient.ndim == 4 and gradient.is_contiguous(memory_format=torch.channels_last):
        return gradient.permute(0, 2, 3, 1).reshape(-1)
    if gradient.ndim == 5 and gradient.is_contiguous(memory_format=torch.channels_last_3d):
        return gradient.permute(0, 2, 3, 4, 1).reshape(-1)
    raise ValueError(f"gradient of shape {tuple(gradient.shape)} is not dense")
