"""Autoencoders and text towers in diffusers-style folders (``vae/``, ``text_encoder/``).

Conventions
-----------
* Networks are built from ``config.json`` and filled strictly; ``from_pretrained`` is not used,
  for it fills what a file lacks with random numbers and only logs it.
* Older files differ in names and trailing axes alone: the autoencoder's attention was called
  query, key, value, proj_attn and kept 1 x 1 kernels; text towers of transformers 4 have a prefix
  ``text_model.`` and store position ids.
* A file may be safetensors or PyTorch's, and may carry ``.fp16`` in its name.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.priors.latent.networks import TextConfig, VAEConfig
from gscomplete.priors.latent.tensor_files import Source, TensorFile, check_tensors
from gscomplete.util.jsonio import read_json

_OLD_ATTENTION = (("to_q", "query"), ("to_k", "key"), ("to_v", "value"), ("to_out.0", "proj_attn"))
_PREFIX = "text_model."
_LARGEST_SIZE = 1_000_000
"""Of widths, layers, words: larger ones are a damaged file's."""
_POSITION_IDS = ("embeddings.position_ids", _PREFIX + "embeddings.position_ids")


@dataclass(frozen=True, slots=True)
class Part:
    """The tensors of one network in one file."""

    file: TensorFile
    sources: dict[str, Source]
    """By the network's name of a tensor; the name in the file is the full one."""

    def state(self) -> dict[str, Tensor]:
        """Read all tensors under our names."""
        stored = self.file.get_all(sorted({source.name for source in self.sources.values()}))
        return {name: source.take(stored[source.name]) for name, source in self.sources.items()}


def find_tensor_file(folder: Path) -> Path:
    """Return the file of weights in a component's folder.

    Raises:
        UserError: there is none.
    """
    stems = ("diffusion_pytorch_model", "model", "pytorch_model")
    endings = (".safetensors", ".fp16.safetensors", ".bin", ".fp16.bin")
    names = [stem + ending for ending in endings for stem in stems]
    for name in names:
        if (folder / name).is_file():
            return folder / name
    raise UserError(f"{folder}: expected a file of weights such as {names[0]}, found none")


def read_vae_config(path: Path) -> VAEConfig:
    """Read the sizes of an autoencoder from diffusers' ``config.json``.

    Raises:
        UserError: it is missing, or of an autoencoder that is not Stable Diffusion's.
    """
    data = _config(path, "AutoencoderKL")
    widths = data.get("block_out_channels", [64])
    if not isinstance(widths, list) or not widths or not all(map(_is_size, widths)):
        raise UserError(f"{path}: block_out_channels: expected a list of widths, found {widths!r}")
    base = widths[0]
    if any(width % base for width in widths):
        raise UserError(f"{path}: block_out_channels: expected multiples of the first, {widths}")
    factor = data.get("scaling_factor", 0.18215)
    if not isinstance(factor, float | int) or not 0 < factor < 1e6:
        raise UserError(f"{path}: scaling_factor: expected a positive number, found {factor!r}")
    return VAEConfig(
        base_channels=base,
        channel_mult=tuple(width // base for width in widths),
        num_res_blocks=_size(path, data, "layers_per_block", 1),
        latent_channels=_size(path, data, "latent_channels", 4),
        norm_groups=_size(path, data, "norm_num_groups", 32),
        scaling_factor=float(factor),
    )


def read_text_config(path: Path) -> TextConfig:
    """Read the sizes of a text tower from transformers' ``config.json``.

    Raises:
        UserError: it is missing, or of another kind of text encoder.
    """
    data = _config(path, None)
    found = data.get("architectures")
    if not isinstance(found, list) or found[:1] != ["CLIPTextModel"]:
        raise UserError(f"{path}: architectures: expected CLIPTextModel, found {found!r}")
    width = _size(path, data, "hidden_size", 512)
    return TextConfig(
        width=width,
        heads=_size(path, data, "num_attention_heads", 8),
        layers=_size(path, data, "num_hidden_layers", 12),
        mlp_width=_size(path, data, "intermediate_size", 4 * width),
        vocabulary_size=_size(path, data, "vocab_size", 49408),
        length=_size(path, data, "max_position_embeddings", 77),
        hidden_act=str(data.get("hidden_act", "quick_gelu")),
    )


def vae_part(folder: Path, module: Any) -> Part:
    """Match the file in ``vae/`` with an autoencoder.

    Raises:
        UserError: the file does not hold exactly its tensors.
    """
    file = TensorFile(find_tensor_file(folder))
    shapes = {name: tuple(value.shape) for name, value in module.state_dict().items()}
    sources = {}
    for name, shape in shapes.items():
        stored = name
        if name not in file.shapes and ".attentions." in name:
            for new, old in _OLD_ATTENTION:
                stored = stored.replace(f".{new}.", f".{old}.")
        squeeze = file.shapes.get(stored) == (*shape, 1, 1)
        sources[name] = Source(stored, squeeze=squeeze)
    expected = {source.name: source.original_shape(shapes[n]) for n, source in sources.items()}
    check_tensors(file.path, file.shapes, expected, what="the autoencoder in config.json")
    return Part(file, sources)


def text_part(folder: Path, module: Any) -> Part:
    """Match the file in ``text_encoder/`` with a text tower.

    Raises:
        UserError: the file does not hold exactly its tensors.
    """
    file = TensorFile(find_tensor_file(folder))
    prefix = _PREFIX if any(name.startswith(_PREFIX) for name in file.shapes) else ""
    shapes = {name: tuple(value.shape) for name, value in module.state_dict().items()}
    sources = {name: Source(prefix + name.removeprefix(_PREFIX)) for name in shapes}
    expected = {source.name: shapes[name] for name, source in sources.items()}
    check_tensors(
        file.path,
        file.shapes,
        expected,
        optional=_POSITION_IDS,
        what="the text tower in config.json",
    )
    return Part(file, sources)


def _is_size(value: object) -> bool:
    """Tell whether a value is a number of something in a network."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value <= _LARGEST_SIZE


def _size(path: Path, data: dict[str, Any], name: str, default: int) -> int:
    """Return a network's size by name.

    Raises:
        UserError: it is none.
    """
    value = data.get(name, default)
    if not _is_size(value):
        raise UserError(f"{path}: {name}: expected 1 to {_LARGEST_SIZE:,}, found {value!r}")
    return int(value)


def _config(path: Path, class_name: str | None) -> dict[str, Any]:
    data = read_json(path)
    if not isinstance(data, dict):
        raise UserError(f"{path}: expected an object, found {type(data).__name__}")
    found = data.get("_class_name", class_name)
    if class_name is not None and found != class_name:
        raise UserError(f"{path}: _class_name: expected {class_name}, found {found}")
    return data
