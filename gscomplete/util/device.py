"""Choose the device that a run computes on."""

from __future__ import annotations

import torch

from gscomplete.errors import UserError


def choose_device(name: str) -> torch.device:
    """Turn ``auto``, ``cpu``, ``cuda`` or ``cuda:N`` into a device.

    Raises:
        UserError: an unknown name, or a GPU that this machine or this PyTorch lacks.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:
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


def peak_gpu_bytes() -> int | None:
    """Return the most memory that tensors held on a GPU; None where there is none."""
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    return max((torch.cuda.max_memory_allocated(index) for index in range(count)), default=None)
