"""The number format that networks run in, by what the device multiplies in hardware."""

from __future__ import annotations

import contextlib
from typing import Literal

import torch

Precision = Literal["auto", "int8", "bfloat16", "float32"]


def is_bfloat16(precision: Precision, device: torch.device) -> bool:
    """Whether a network, except for its 8-bit layers, runs in bfloat16 on a device."""
    return precision == "bfloat16" or (precision != "float32" and multiplies_bfloat16(device))


def is_in_bytes(precision: Precision) -> bool:
    """Whether a network on the CPU runs in 8 bits where it can."""
    return precision == "int8" or (precision == "auto" and multiplies_bytes())


def multiplies_bfloat16(device: torch.device) -> bool:
    """Whether a device multiplies bfloat16 in hardware; emulated, it is slower than float32."""
    if device.type == "cpu":
        return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
    return device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)


def multiplies_bytes() -> bool:
    """Whether the CPU multiplies bytes in hardware and PyTorch has 8-bit convolutions."""
    return (
        torch.backends.mkldnn.is_available()
        and bool(getattr(torch.cpu, "_is_vnni_supported", bool)())
        and hasattr(torch.ops.onednn, "qconv3d_pointwise")
    )


def cpu_precision(*, bfloat16: bool) -> contextlib.AbstractContextManager[None]:
    """Return the context that a network runs in on the CPU."""
    context: contextlib.AbstractContextManager[None] = torch.autocast(
        "cpu", torch.bfloat16, enabled=bfloat16
    )
    return context
