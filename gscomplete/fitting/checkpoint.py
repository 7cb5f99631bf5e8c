"""Checkpoints of a completion: named tensors in one safetensors file, written atomically."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.util.atomic import atomic_path

FILE_NAME = "latest.safetensors"


def save_checkpoint(folder: Path, state: dict[str, Tensor]) -> Path:
    """Write the newest checkpoint over the one before."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / FILE_NAME
    # A tensor that shares storage with another is refused by safetensors, so each is made its own.
    own = {name: value.detach().contiguous().clone() for name, value in state.items()}
    with atomic_path(path) as temporary:
        save_file(own, str(temporary))
    return path


def load_checkpoint(folder: Path) -> dict[str, Tensor] | None:
    """Read the newest checkpoint; None when there is none.

    Raises:
        UserError: the file exists but cannot be read, or holds values that are not finite.
    """
    path = folder / FILE_NAME
    if not path.exists():
        return None
    try:
        state = load_file(str(path))
    except (SafetensorError, OSError) as error:
        raise UserError(f"{path}: cannot read the checkpoint: {error}") from error
    if "step" not in state or state["step"].dtype != torch.int64:
        raise UserError(f"{path}: expected a checkpoint of a completion with a step number")
    for name, value in state.items():
        if value.is_floating_point() and not bool(torch.isfinite(value).all()):
            raise UserError(f"{path}: {name}: expected finite values, found others")
    return state
