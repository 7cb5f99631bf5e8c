"""A GPU that is not there: tensors with shapes and devices but no numbers, on ``cuda:0``.

PyTorch's fake tensors follow the device of every operation and refuse to mix devices, which finds
what a missing ``.to(device)`` would break on a real one. A PyTorch built without CUDA lacks a few
of the methods that tensors there need; they are given here in terms of others. There is no
autograd, and every number read from a tensor is made up.
"""

import contextlib
from collections.abc import Iterator
from types import SimpleNamespace
from unittest import mock

import torch
from torch import Tensor
from torch._subclasses.fake_tensor import FakeTensorMode

GPU = torch.device("cuda:0")
PROPERTIES = SimpleNamespace(total_memory=24 * 2**30)

_contiguous, _copy = Tensor.contiguous, Tensor.copy_
_get, _set = Tensor.__getitem__, Tensor.__setitem__


def _view(tensor: Tensor, index: object) -> Tensor:
    """Index by integers, slices of step 1, None, an ellipsis or rows."""
    items = index if isinstance(index, tuple) else (index,)
    if any(item is Ellipsis for item in items):
        at = [item is Ellipsis for item in items].index(True)
        fill = tensor.ndim - sum(item is not None and item is not Ellipsis for item in items)
        items = (*items[:at], *([slice(None)] * fill), *items[at + 1 :])
    axis = 0
    for item in items:
        if item is None:
            tensor = tensor.unsqueeze(axis)
        elif isinstance(item, slice):
            start, stop, _ = item.indices(tensor.shape[axis])
            tensor = tensor.narrow(axis, start, max(0, stop - start))
        elif isinstance(item, int):
            tensor = tensor.select(axis, item % tensor.shape[axis])
            axis -= 1
        else:
            tensor = tensor.index_select(axis, item)
        axis += 1
    return tensor


def _put(tensor: Tensor, index: object, value: object) -> None:
    if tensor.is_cuda:
        view = _view(tensor, index)
        view.copy_(value) if isinstance(value, Tensor) else view.fill_(value)
    else:
        _set(tensor, index, value)


def _apply(module: torch.nn.Module, change, recurse: bool = True) -> torch.nn.Module:
    """Replace every parameter, for fake ones cannot be changed in place."""
    for part in module.modules():
        for name, value in part._parameters.items():
            if value is not None:
                part._parameters[name] = torch.nn.Parameter(change(value), requires_grad=False)
        for name, value in part._buffers.items():
            if value is not None:
                part._buffers[name] = change(value)
    return module


@contextlib.contextmanager
def simulated_gpu() -> Iterator[torch.device]:
    """Make ``cuda:0`` usable, for shapes and devices only."""
    methods = {
        "contiguous": lambda t, **k: t.clone() if t.is_cuda else _contiguous(t, **k),
        "copy_": lambda t, v, **k: t.mul_(0).add_(v) if t.is_cuda else _copy(t, v, **k),
        "__getitem__": lambda t, index: _view(t, index) if t.is_cuda else _get(t, index),
        "__setitem__": _put,
        "__float__": lambda t: 0.5,
        "__bool__": lambda t: True,
        "__int__": lambda t: 1,
        "item": lambda t: 1,
    }
    with contextlib.ExitStack() as stack:
        for name, method in methods.items():
            stack.enter_context(mock.patch.object(Tensor, name, method))
        stack.enter_context(mock.patch.object(torch.nn.Module, "_apply", _apply))
        for name, value in (("get_device_properties", PROPERTIES), ("is_bf16_supported", True)):
            stack.enter_context(
                mock.patch.object(torch.cuda, name, lambda *a, value=value, **k: value)
            )
        stack.enter_context(torch.no_grad())
        # autograd on a device that is not there ends the process, so nobody may turn it on again
        stack.enter_context(mock.patch.object(torch, "enable_grad", torch.no_grad))
        stack.enter_context(FakeTensorMode(allow_non_fake_inputs=True))
        yield GPU
