"""Checkpoints of a completion: named tensors in one safetensors file, written atomically."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.fitting.row_adam import MOMENTS
from gscomplete.util.atomic import atomic_path

FILE_NAME = "latest.safetensors"


def save_checkpoint(folder: Path, state: dict[str, Tensor]) -> Path:
    """Write the newest checkpoint over the one before."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / FILE_NAME
    # A tensor that shares storage with another is refused by safetensors, so each is made its own.
    own = {name: value.detach().contiguous().clone() for name, value in state.items()}
    with atomic_path(path) as temporary:
        temporary.write_bytes(save(own))  # safetensors' own writer hides what the system says
    return path


def check_fits(path: Path, state: dict[str, Tensor], fresh: dict[str, Tensor], steps: int) -> None:
    """Check that a job can go on from a checkpoint.

    Args:
        path: the checkpoint, for messages.
        state: what it holds.
        fresh: the state of the same job at step 0; rows may have come and gone since, where there
            were any.
        steps: of the complete job.

    Raises:
        UserError: the step is out of range, or a tensor is missing, of another type or shape.
    """
    step = state["step"]
    if step.ndim or not 0 <= int(step) <= steps:
        raise UserError(f"{path}: step: expected 0 to {steps}, found {step.tolist()}")
    rows = len(state["value.means"]) if state.get("value.means", step).ndim else 0
    if rows == 0 and len(fresh["value.means"]):
        raise UserError(f"{path}: value.means: expected one row a splat, found none")
    for name, expected in fresh.items():
        found = state.get(name)
        shape = (rows, *expected.shape[1:]) if expected.ndim else ()
        _require(path, name, found, expected.dtype, shape)
    for name in (name.removeprefix("value.") for name in fresh if name.startswith("value.")):
        value = state[f"value.{name}"]
        moments = {key: state.get(f"adam.{name}.{key}") for key in ("step", *MOMENTS)}
        if all(moment is None for moment in moments.values()):
            continue  # a value that does not move has none
        _require(path, f"adam.{name}.step", moments["step"], torch.float32, ())
        for key in MOMENTS:
            _require(path, f"adam.{name}.{key}", moments[key], value.dtype, tuple(value.shape))


def _require(
    path: Path, name: str, found: Tensor | None, dtype: torch.dtype, shape: tuple[int, ...]
) -> None:
    """Check one tensor of a checkpoint."""
    if found is None or found.dtype != dtype or tuple(found.shape) != shape:
        what = "none" if found is None else f"{found.dtype} {tuple(found.shape)}"
        raise UserError(f"{path}: {name}: expected {dtype} {shape}, found {what}")


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
