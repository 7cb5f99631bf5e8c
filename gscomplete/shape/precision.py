"""The precision that the networks run in."""

from __future__ import annotations

import contextlib

import torch


def cpu_precision(*, bfloat16: bool) -> contextlib.AbstractContextManager[None]:
    """Return the context that a network runs in on the CPU."""
    context: contextlib.AbstractContextManager[None] = torch.autocast(
        "cpu", torch.bfloat16, enabled=bfloat16
    )
    return context
