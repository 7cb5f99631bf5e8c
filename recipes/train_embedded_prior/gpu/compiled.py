"""The shape network and its loss as one compiled function: fewer, larger kernels on a GPU.

Conventions
-----------
* Features stay in channels-last order, in which convolutions of sixteen bits run on a GPU's matrix
  units. PyTorch's own group norm returns another order, and autocast widens its result to float32;
  ``LaidOutGroupNorm`` keeps order and precision.
* The compiled network shares its parameters with the one that it is made of.
"""

from __future__ import annotations

import functools
import logging
import time
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from gscomplete.shape.network import laid_out
from recipes.train_embedded_prior.data.shape_dataset import ShapeBatch, decode_sets, set_dtype
from recipes.train_embedded_prior.evaluate import autocast
from recipes.train_embedded_prior.shape_task import LossOf, ShapeTask, total_loss

_LOG = logging.getLogger(__name__)
_TIMED_STEPS = 4
BatchLoss = Callable[[ShapeBatch, np.random.Generator], Tensor]
"""(sets, generator) -> loss [] of the network in training."""


class LaidOutGroupNorm(nn.Module):
    """A group norm that keeps the order and the precision of its input."""

    def __init__(self, norm: nn.GroupNorm) -> None:
        """Take over a group norm's parameters, by reference."""
        super().__init__()
        self.groups, self.eps = norm.num_groups, norm.eps
        self.weight, self.bias = norm.weight, norm.bias

    def forward(self, x: Tensor) -> Tensor:  # [B, C, n, n, n]
        """Return the normalised features."""
        grouped = x.unflatten(1, (self.groups, -1)).float()
        variance, mean = torch.var_mean(grouped, dim=(2, 3, 4, 5), correction=0, keepdim=True)
        normal = ((grouped - mean) * torch.rsqrt(variance + self.eps)).flatten(1, 2)
        scale, shift = (p[:, None, None, None] for p in (self.weight, self.bias))
        return torch.addcmul(shift, normal, scale).to(x.dtype)


def fastest_loss(task: ShapeTask, model: nn.Module, *, compiled: bool) -> BatchLoss:
    """Return how the loss is computed fastest: as it is, or compiled, which is tried.

    Args:
        task: whose loss.
        model: the network, on its device; its parameters are laid out for the loss returned.
        compiled: try it.
    """
    plain = functools.partial(task.batch_loss, model)
    _contiguous(model)
    if not compiled:
        return plain
    began = time.monotonic()
    try:
        slow = _seconds(task, plain)
        other = functools.partial(
            task.batch_loss, laid_out_twin(task, model), loss_of=compiled_loss()
        )
        quick = _seconds(task, other)
    except Exception as error:
        _LOG.warning("not compiled: %s: %s", type(error).__name__, str(error)[:500])
        _contiguous(model)
        return plain
    finally:
        model.zero_grad(set_to_none=True)
    _LOG.info(
        "a step takes %.1f ms compiled, %.1f ms as it is; found out in %.0f s",
        1000 * quick,
        1000 * slow,
        time.monotonic() - began,
    )
    if quick < slow:
        return other
    _contiguous(model)
    return plain


def _contiguous(model: nn.Module) -> None:
    """Lay kernels out as the network as it is runs fastest: by a tenth on an H200."""
    for parameter in model.parameters():
        parameter.data = parameter.data.contiguous()


def lay_out_like(network: nn.Module, model: nn.Module) -> None:
    """Lay a network's parameters out as a model's: averages of unlike ones are slow."""
    for own, other in zip(network.parameters(), model.parameters(), strict=True):
        own.data = torch.empty_like(other).copy_(own)


def _seconds(task: ShapeTask, batch_loss: BatchLoss) -> float:
    """Return the time of a loss and its gradients, on empty sets."""
    config = task.config
    batch = decode_sets(np.zeros(config.batch_sets, set_dtype())).to(config.device)
    began = 0.0
    for step in range(_TIMED_STEPS + 2):
        if step == 2:  # the first ones compile and choose kernels
            began = _clock(config.device)
        with autocast(config.device, config.precision):
            loss = batch_loss(batch, np.random.default_rng(step))
        loss.backward()
    return (_clock(config.device) - began) / _TIMED_STEPS


def _clock(device: str) -> float:
    """Return the time once a device has nothing left to do."""
    if device.startswith("cuda"):
        torch.cuda.synchronize()
    return time.perf_counter()


def laid_out_twin(task: ShapeTask, model: nn.Module) -> nn.Module:
    """Return a network of the same parameters, laid out anew, whose norms keep channels last."""
    twin = task.make_model()
    twin.load_state_dict(model.state_dict(keep_vars=True), assign=True)
    for parent in list(twin.modules()):
        for name, child in list(parent.named_children()):
            if isinstance(child, nn.GroupNorm):
                setattr(parent, name, LaidOutGroupNorm(child))
    return laid_out(twin)


def compiled_loss() -> LossOf:
    """Return ``shape_task.total_loss``, compiled at its first call."""

    # Tensors go in one by one: records with slots are not followed while compiling.
    def whole(
        model: nn.Module, tensors: tuple[Tensor, ...], weights: Tensor, oblique: Tensor
    ) -> Tensor:
        return total_loss(model, ShapeBatch(*tensors), weights, oblique)

    inner = torch.compile(whole, dynamic=False)

    def loss(model: nn.Module, batch: ShapeBatch, weights: Tensor, oblique: Tensor) -> Tensor:
        tensors = batch.volumes, batch.evidence, batch.scores, batch.tokens
        found: Tensor = inner(model, (*tensors, batch.solid, batch.surface), weights, oblique)
        return found

    return loss
