"""States of PyTorch that callers may have set, none of which changes a result."""

import contextlib
from collections.abc import Iterator

import torch


@contextlib.contextmanager
def default_type(dtype: torch.dtype) -> Iterator[None]:
    """Have another default type in the block."""
    torch.set_default_dtype(dtype)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


STATES = {
    "no gradients": torch.no_grad,
    "inference mode": torch.inference_mode,
    "autocast": lambda: torch.autocast("cpu", dtype=torch.bfloat16),
    "another device": lambda: torch.device("meta"),
    "float64": lambda: default_type(torch.float64),
    "bfloat16": lambda: default_type(torch.bfloat16),
}
