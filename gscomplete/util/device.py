"""Choose the device that a run computes on, and have PyTorch as it comes.

Conventions
-----------
* Gradients, inference mode, autocast and the default device are the calling thread's. The default
  type is one for all threads: it is changed only where it is not float32, and changed back when no
  thread needs it any more.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import threading
from collections.abc import Iterator

import torch

from gscomplete.errors import UserError

_logger = logging.getLogger(__name__)


def choose_device(name: str) -> torch.device:
    """Turn ``auto``, ``cpu``, ``cuda`` or ``cuda:N`` into a device.

    A PyTorch built for GPUs on a machine without one gives a note, once per process: that build is
    many times as large as the one for CPUs, and plain ``pip install`` chooses it on Linux.

    Raises:
        UserError: an unknown name, or a GPU that this machine or this PyTorch lacks.
    """
    if name == "auto":
        is_there = torch.cuda.is_available()
        if not is_there and torch.version.cuda is not None:
            _tell_of_unused_cuda()
        return torch.device("cuda" if is_there else "cpu")
    try:
        device = torch.device(name)
    except (RuntimeError, TypeError) as error:
        raise UserError(f"--device: expected auto, cpu, cuda or cuda:N, found {name!r}") from error
    if device.type not in ("cpu", "cuda"):
        raise UserError(f"--device: expected auto, cpu, cuda or cuda:N, found {name!r}")
    if device.type == "cuda" and not torch.cuda.is_available():
        raise UserError(f"--device {name}: PyTorch {torch.__version__} finds no CUDA device here")
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise UserError(
            f"--device {name}: this machine has {torch.cuda.device_count()} CUDA devices"
        )
    return device


@functools.cache
def _tell_of_unused_cuda() -> None:
    """Note, once per process, that this PyTorch is built for GPUs and the machine has none."""
    _logger.warning(
        "note: PyTorch %s is built for CUDA %s but finds no GPU here, so the CPU is used; "
        "PyTorch's CPU build does the same in a fraction of the disk space (see README.md)",
        torch.__version__,
        torch.version.cuda,
    )


def peak_gpu_bytes() -> int | None:
    """Return the most memory that tensors held on a GPU; None where there is none."""
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    return max((torch.cuda.max_memory_allocated(index) for index in range(count)), default=None)


@contextlib.contextmanager
def plain_torch() -> Iterator[None]:
    """Have gradients, float32 on the CPU by default, and no autocast in the block."""
    with contextlib.ExitStack() as stack:
        stack.enter_context(torch.inference_mode(False))
        stack.enter_context(torch.enable_grad())
        for device in ("cpu", "cuda"):
            if torch.is_autocast_enabled(device):
                stack.enter_context(torch.autocast(device, enabled=False))
        if torch.get_default_device().type != "cpu":
            stack.enter_context(torch.device("cpu"))
        stack.enter_context(_DEFAULT_TYPE.float32())
        yield


class _DefaultType:
    """PyTorch's default type, which threads that need float32 share."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._needed_by = 0
        self._before = torch.float32

    @contextlib.contextmanager
    def float32(self) -> Iterator[None]:
        """Have float32 by default here: the first of several sets it, the last undoes it."""
        with self._lock:
            if self._needed_by == 0:
                self._before = torch.get_default_dtype()
                if self._before != torch.float32:
                    torch.set_default_dtype(torch.float32)
            self._needed_by += 1
        try:
            yield
        finally:
            with self._lock:
                self._needed_by -= 1
                if self._needed_by == 0 and self._before != torch.float32:
                    torch.set_default_dtype(self._before)


_DEFAULT_TYPE = _DefaultType()
