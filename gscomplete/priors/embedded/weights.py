"""Weights of the embedded prior on disk.

``model.safetensors`` holds the four-view denoiser, ``shape.safetensors`` the shape network (it may
be absent), ``config.json`` what goes with them, and ``CARD.md`` tells people about them. The
package's folder also holds ``planes.safetensors``, ``plane_judge.safetensors`` and
``answers.safetensors`` (scorers of ``shape.planes``), ``benefit.safetensors`` (``shape.benefit``),
``outlines.safetensors`` and ``capture_outlines.safetensors`` (``shape.outline``),
``surface_depth.safetensors`` (``shape.surface.depth``) and ``strays.safetensors``
(``splats.strays``). These are always read from the package's folder: like the grid, the first two
belong to what the shape network was trained with. ``shapes.safetensors`` (``shape.bank.store``) is
read from the package's folder if a folder has none.

Conventions
-----------
* Matrices and kernels are stored as int8 with one float16 scale per output channel (rows of the
  first axis): ``NAME`` and ``NAME.scale``, value = int8 * scale. Vectors are float16. ``float32``
  storage keeps everything as it is.
* ``config.json`` holds what inference needs (architecture, framing, vocabularies: each network
  has its own) and how the weights came to be; a network's file carries a digest of its words, so
  that files cannot be mixed up.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

from gscomplete.errors import UserError
from gscomplete.networks.packaged import PACKAGED_WEIGHTS
from gscomplete.priors.base import PriorViews
from gscomplete.priors.embedded.model import FourViewDenoiser, ModelConfig
from gscomplete.shape.network import (
    ShapeCompleter,
    ShapeModelConfig,
    laid_out,
)
from gscomplete.shape.voxels import COARSE_CELLS
from gscomplete.util.atomic import atomic_path
from gscomplete.util.digests import sha256_of
from gscomplete.util.jsonio import from_json, read_json, write_json

WEIGHTS_FILE = "model.safetensors"
SHAPE_FILE = "shape.safetensors"
CONFIG_FILE = "config.json"
FORMAT_VERSION = 3
_SCALE = ".scale"
_DIGEST = "words_digest"

_MOST_BLOCKS, _SIZE_PER_AXIS, _SMALL_AXIS = 64, 4, 64
"""No size of a network is above four times the longest axis of its tensors."""
Config = TypeVar("Config", ModelConfig, ShapeModelConfig)
Network = TypeVar("Network", bound=nn.Module)
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
class ShapeRecord:
    """Configuration that belongs to the weights of the shape network."""

    model: ShapeModelConfig
    words: tuple[str, ...]
    training: TrainingRecord


@dataclass(frozen=True, slots=True)
class PriorConfig:
    """Configuration that belongs to the weights."""

    format_version: int
    model: ModelConfig
    views: PriorViews
    words: tuple[str, ...]
    """Of the denoiser."""
    storage: Storage
    training: TrainingRecord
    shape: ShapeRecord | None = None
    """The shape network; None = there is none, and completions start without a first guess."""


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


def save_weights(
    folder: Path,
    state: dict[str, Tensor],
    config: PriorConfig,
    shape_state: dict[str, Tensor] | None = None,
) -> None:
    """Write weights and configuration to a folder, creating it.

    Args:
        folder: to write to.
        state: of the denoiser.
        config: what goes with them.
        shape_state: of the shape network; given exactly if ``config.shape`` is.

    Raises:
        UserError: the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    digests = _digests(config)
    states = {WEIGHTS_FILE: state}
    if shape_state is not None:
        states[SHAPE_FILE] = shape_state
    for name, tensors in states.items():
        packed = pack_tensors(tensors, config.storage)
        with atomic_path(folder / name) as temporary:
            temporary.write_bytes(save(packed, metadata={_DIGEST: digests[name]}))
    write_json(folder / CONFIG_FILE, config)


@dataclass(frozen=True, slots=True)
class StoredWeights:
    """The stored networks of a folder; a network is built only when it is asked for."""

    folder: Path
    config: PriorConfig
    _tensors: dict[str, dict[str, Tensor]]

    def denoiser(self) -> FourViewDenoiser:
        """Make the denoiser, in float32 on the CPU.

        Raises:
            UserError: the tensors are not those of the configuration.
        """
        return self._made(FourViewDenoiser, self.config.model, WEIGHTS_FILE)

    def shape(self) -> ShapeCompleter | None:
        """Make the shape network, in float32 on the CPU; None = there is none.

        Raises:
            UserError: the tensors are not those of the configuration.
        """
        if self.config.shape is None:
            return None
        return self._made(_shape_network, self.config.shape.model, SHAPE_FILE)

    def _made(self, make: Callable[[Config], Network], config: Config, name: str) -> Network:
        return _filled(make, config, self.folder / name, self._tensors[name])


def packaged_weights() -> Path:
    """Return the folder of the weights that ship with the package."""
    return PACKAGED_WEIGHTS


def read_weights(folder: Path) -> StoredWeights:
    """Read the files of a folder.

    Raises:
        UserError: a file is missing, damaged, of another version, or does not belong to the others.
    """
    _require(folder / CONFIG_FILE)
    config = _read_config(folder / CONFIG_FILE)
    packed = {name: _packed(folder / name, digest) for name, digest in _digests(config).items()}
    return StoredWeights(folder, config, packed)


def load_weights(folder: Path) -> tuple[FourViewDenoiser, ShapeCompleter | None, PriorConfig]:
    """Make all networks of a folder.

    Raises:
        UserError: as from :func:`read_weights` and the networks of what it returns.
    """
    stored = read_weights(folder)
    shape = stored.shape()
    return stored.denoiser(), None if shape is None else laid_out(shape), stored.config


def weights_digest(folder: Path) -> str:
    """Return a digest of all files in a folder that decide what the prior answers.

    Raises:
        UserError: a file is missing.
    """
    digest = hashlib.sha256()
    for name in (CONFIG_FILE, WEIGHTS_FILE):
        _require(folder / name)
    for path in sorted((folder / CONFIG_FILE, *folder.glob("*.safetensors"))):
        digest.update(f"{path.name} {sha256_of(path)}\n".encode())
    return digest.hexdigest()[:32]


def _digests(config: PriorConfig) -> dict[str, str]:
    """Return the digests of the words that the files of networks carry."""
    found = {WEIGHTS_FILE: words_digest(config.words)}
    return found if config.shape is None else found | {SHAPE_FILE: words_digest(config.shape.words)}


def _require(path: Path) -> None:
    if not path.is_file():
        raise UserError(
            f"{path}: weights of the embedded prior are missing; expected a folder with "
            f"{WEIGHTS_FILE} and {CONFIG_FILE}"
        )


def _check_sizes(path: Path, config: ModelConfig | ShapeModelConfig, largest: int) -> None:
    """Refuse sizes that the file's tensors cannot have, before a network is made of them.

    Raises:
        UserError: a size is out of range.
    """
    most = _SIZE_PER_AXIS * max(largest, _SMALL_AXIS)
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        numbers = value if isinstance(value, tuple) else (value,)
        limit = _MOST_BLOCKS if field.name in ("blocks", "transformers") else most
        if not all(isinstance(n, int | float) and 0 <= n <= limit for n in numbers):
            raise UserError(
                f"{path.parent / CONFIG_FILE}: {field.name}: expected 0 to {limit} as by the "
                f"tensors of {path.name}, found {value}"
            )


def _shape_network(config: ShapeModelConfig) -> ShapeCompleter:
    """Make the shape network for the one grid it is trained on."""
    return ShapeCompleter(config, COARSE_CELLS)


def _packed(path: Path, digest: str) -> dict[str, Tensor]:
    """Read the tensors of a file that goes with the words of a digest."""
    _require(path)
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            packed = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise UserError(f"{path}: expected a safetensors file, found damage ({error})") from error
    if metadata.get(_DIGEST) != digest:
        raise UserError(
            f"{path}: {_DIGEST}: expected {digest} as in {CONFIG_FILE}, found "
            f"{metadata.get(_DIGEST)}; the files are not of one export"
        )
    return packed


_FILLING = (Tensor.fill_, Tensor.zero_)
"""What modules call besides the functions of ``torch.nn.init``."""


class _NoInitialValues(TorchFunctionMode):
    """Within it, modules do not initialise their parameters, because stored values replace them.

    PyTorch's meta device would serve the same purpose, but its first use takes a second.
    """

    def __torch_function__(
        self,
        func: Callable[..., Any],
        types: Sequence[type],
        args: Sequence[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        """Call a function of PyTorch unless it fills a tensor."""
        named = kwargs or {}
        if getattr(func, "__module__", None) == nn.init.__name__:
            return named["tensor"]
        return args[0] if func in _FILLING else func(*args, **named)


def _filled(
    make: Callable[[Config], Network], config: Config, path: Path, packed: dict[str, Tensor]
) -> Network:
    """Make a network of stored tensors, for evaluation."""
    try:
        _check_sizes(path, config, max(max(t.shape, default=1) for t in packed.values()))
        with _NoInitialValues():
            model = make(config)
        model.load_state_dict(unpack_tensors(packed), assign=True)
    except UserError:
        raise
    except Exception as error:  # sizes that do not fit each other fail anywhere
        raise UserError(
            f"{path}: tensors do not fit the model of {CONFIG_FILE}: {error}"
        ) from error
    model.eval().requires_grad_(False)
    return model


def _read_config(path: Path) -> PriorConfig:
    data = read_json(path)
    found = data.get("format_version") if isinstance(data, dict) else None
    if found != FORMAT_VERSION:
        raise UserError(f"{path}: format_version: expected {FORMAT_VERSION}, found {found}")
    return from_json(PriorConfig, data, str(path))
