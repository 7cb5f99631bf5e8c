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


def choose_render_device(name: str, device: torch.device) -> tuple[torch.device, str | None]:
    """Choose where splats are rendered, next to a prior on ``device``.

    Args:
        name: what the user asked for; only ``auto`` may fall back to the CPU renderer.
        device: from :func:`choose_device`.

    Returns:
        The device, and a line for the user if it is not the prior's.

    Raises:
        UserError: a CUDA device was asked for by name and cannot render.
    """
    if device.type != "cuda":
        return device, None
    from gscomplete.render.cuda import check_cuda_renderer

    try:
        check_cuda_renderer(device)
    except UserError as error:
        if name != "auto":
            raise
        return torch.device("cpu"), f"rendering on the CPU: {error}"
    return device, None


def peak_gpu_bytes() -> int | None:
    """Return the most memory that tensors held on a GPU; None where there is none."""
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    return max((torch.cuda.max_memory_allocated(index) for index in range(count)), default=None)
