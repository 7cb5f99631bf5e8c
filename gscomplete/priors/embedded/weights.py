"""Weights of the embedded prior on disk: ``model.safetensors``, ``config.json``, ``CARD.md``.

Conventions
-----------
* Matrices and kernels are stored as int8 with one float16 scale per output channel (rows of the
  first axis): ``NAME`` and ``NAME.scale``, value = int8 * scale. Vectors are float16. ``float32``
  storage keeps everything as it is.
* ``config.json`` holds what inference needs (architecture, framing, vocabulary) and how the
  weights came to be; both files carry one digest, so that they cannot be mixed up.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from gscomplete.atomic import atomic_path
from gscomplete.errors import UserError
from gscomplete.jsonio import from_json, read_json, write_json
from gscomplete.priors.base import PriorViews
from gscomplete.priors.embedded.model import FourViewDenoiser, ModelConfig

WEIGHTS_FILE = "model.safetensors"
CONFIG_FILE = "config.json"
FORMAT_VERSION = 1
_SCALE = ".scale"
_DIGEST = "words_digest"

Storage = Literal["int8", "float16", "float32"]


@dataclass(frozen=True, slots=True)
class TrainingRecord:
    """How the weights came to be."""

    steps: int
    sets: int
    hours: float
    machine: str
    seed: int


@dataclass(frozen=True, slots=True)
class PriorConfig:
    """All that goes with a file of weights."""

    format_version: int
    model: ModelConfig
    views: PriorViews
    words: tuple[str, ...]
    storage: Storage
    training: TrainingRecord


def words_digest(words: tuple[str, ...]) -> str:
    """Return a short digest of a vocabulary in its order."""
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:16]


def pack_tensors(state: dict[str, Tensor], storage: Storage) -> dict[str, Tensor]:
    """Return what is stored for a state dictionary."""
    packed: dict[str, Tensor] = {}
    for name, value in state.items():
        value = value.detach().float().cpu().contiguous()
        if storage == "int8" and value.ndim >= 2:
            largest = value.flatten(1).abs().amax(dim=1)
            scale = (largest / 127).clamp(min=2.0**-24).to(torch.float16)
            wide = scale.float().reshape(-1, *[1] * (value.ndim - 1))
            packed[name] = (value / wide).round().clamp(-127, 127).to(torch.int8)
            packed[name + _SCALE] = scale
        else:
            packed[name] = value if storage == "float32" else value.to(torch.float16)
    return packed


def unpack_tensors(packed: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return the float32 state dictionary behind stored tensors."""
    state = {}
    for name, value in packed.items():
        if value.dtype == torch.int8:
            scale = packed[name + _SCALE].float()
            state[name] = value.float() * scale.reshape(-1, *[1] * (value.ndim - 1))
        elif not (name.endswith(_SCALE) and name.removesuffix(_SCALE) in packed):
            state[name] = value.float()
    return state


def save_weights(folder: Path, state: dict[str, Tensor], config: PriorConfig) -> None:
    """Write weights and configuration to a folder, creating it.

    Raises:
        UserError: the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    metadata = {_DIGEST: words_digest(config.words)}
    with atomic_path(folder / WEIGHTS_FILE) as temporary:
        temporary.write_bytes(save(pack_tensors(state, config.storage), metadata=metadata))
    write_json(folder / CONFIG_FILE, config)


def load_weights(folder: Path) -> tuple[FourViewDenoiser, PriorConfig]:
    """Read a denoiser in float32 on the CPU.

    Raises:
        UserError: a file is missing, damaged, of another version, or does not belong to the other.
    """
    for name in (WEIGHTS_FILE, CONFIG_FILE):
        if not (folder / name).is_file():
            raise UserError(
                f"{folder / name}: weights of the embedded prior are missing; expected a folder "
                f"with {WEIGHTS_FILE} and {CONFIG_FILE}"
            )
    config = _read_config(folder / CONFIG_FILE)
    path = folder / WEIGHTS_FILE
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            packed = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise UserError(f"{path}: expected a safetensors file, found damage ({error})") from error
    expected = words_digest(config.words)
    if metadata.get(_DIGEST) != expected:
        raise UserError(
            f"{path}: {_DIGEST}: expected {expected} as in {CONFIG_FILE}, found "
            f"{metadata.get(_DIGEST)}; the two files are not of one export"
        )
    model = FourViewDenoiser(config.model)
    try:
        model.load_state_dict(unpack_tensors(packed))
    except (RuntimeError, KeyError) as error:
        raise UserError(
            f"{path}: tensors do not fit the model of {CONFIG_FILE}: {error}"
        ) from error
    return model.eval().requires_grad_(False), config


def _read_config(path: Path) -> PriorConfig:
    data = read_json(path)
    found = data.get("format_version") if isinstance(data, dict) else None
    if found != FORMAT_VERSION:
        raise UserError(f"{path}: format_version: expected {FORMAT_VERSION}, found {found}")
    return from_json(PriorConfig, data, str(path))
