"""Weights of MVDream on disk, in three layouts, opened strictly.

Conventions
-----------
* (a) ``original``: the one published file, ``sd-v2.1-base-4view.pt`` (or its tensors as
  safetensors). A model of other sizes has its sizes in a JSON file of the same name beside it.
* (b) ``folder``: the diffusers-style folder whose UNet keeps its original names (class
  ``MultiViewUNetModel``). diffusers' own loader accepts such a folder and returns random numbers.
* (c) ``converted``: ours (``convert``): ``gscomplete_mvdream.json`` and three safetensors files
  under the names of the models built here.
* Names and shapes of all three networks are checked when weights are opened; values are read when
  a network is asked for.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch

from gscomplete.errors import UserError
from gscomplete.priors.latent.folders import (
    Part,
    find_tensor_file,
    read_text_config,
    read_vae_config,
    text_part,
    vae_part,
)
from gscomplete.priors.latent.guidance import NoiseSchedule
from gscomplete.priors.latent.networks import build_text_tower, build_vae, load_strictly
from gscomplete.priors.latent.tensor_files import (
    Shape,
    Source,
    TensorFile,
    check_tensors,
    fingerprint,
)
from gscomplete.priors.mvdream import keys
from gscomplete.priors.mvdream.config import PUBLISHED, MVDreamConfig, UNetConfig
from gscomplete.priors.mvdream.model import MultiViewUNet, build_unet
from gscomplete.util.jsonio import from_json, read_json

MANIFEST_FILE = "gscomplete_mvdream.json"
MANIFEST_SCHEMA = "gscomplete.mvdream"
MANIFEST_VERSION = 1
COMPONENTS = ("unet", "vae", "text")

Sources = Mapping[str, tuple[Source, Shape]]
"""Our name to its source and our shape."""

Layout = Literal["original", "folder", "converted"]


@dataclass(frozen=True, slots=True)
class Weights:
    """Opened and checked weights; each network is read when asked for."""

    path: Path
    layout: Layout
    config: MVDreamConfig
    parts: dict[str, Part]

    @property
    def files(self) -> tuple[Path, ...]:
        """The files behind the weights, each once."""
        return tuple(dict.fromkeys(part.file.path for part in self.parts.values()))

    def fingerprint(self) -> str:
        """Return a digest of all files."""
        return fingerprint(self.files)

    def text_fingerprint(self) -> str:
        """Return a digest of the file that holds the text tower."""
        return fingerprint((self.parts["text"].file.path,))

    def unet(self) -> MultiViewUNet:
        """Read the denoiser, on the CPU in the file's precision."""
        module = _on_meta(lambda: build_unet(self.config.unet))
        loaded = load_strictly(module, self.parts["unet"].state())
        return MultiViewUNet(loaded, self.config.unet.num_views)

    def vae(self) -> Any:
        """Read the autoencoder, on the CPU in the file's precision."""
        module = _on_meta(lambda: build_vae(self.config.vae))
        return load_strictly(module, self.parts["vae"].state())

    def text_tower(self) -> Any:
        """Read the text tower, on the CPU in the file's precision."""
        module = _on_meta(lambda: build_text_tower(self.config.text))
        return load_strictly(module, self.parts["text"].state())


def open_weights(path: Path) -> Weights:
    """Open weights of any of the three layouts.

    Raises:
        UserError: there are none, or they are not exactly those of an MVDream model.
    """
    if path.is_file():
        return _open_original(path)
    if (path / MANIFEST_FILE).is_file():
        return _open_converted(path)
    if (path / "unet" / "config.json").is_file():
        return _open_folder(path)
    raise UserError(
        f"{path}: expected MVDream's weights: its .pt file, a folder with unet/config.json, or a "
        f"converted folder with {MANIFEST_FILE}"
    )


def is_mvdream_folder(path: Path) -> bool:
    """Whether a folder claims to hold MVDream in layout (b) or (c)."""
    if (path / MANIFEST_FILE).is_file():
        return True
    config = path / "unet" / "config.json"
    if not config.is_file():
        return False
    data = read_json(config)
    return isinstance(data, dict) and data.get("_class_name") == "MultiViewUNetModel"


@functools.cache
def component_sources(config: MVDreamConfig, name: str) -> Sources:
    """Return every tensor of a network: our name to its original source and our shape."""
    builders = {"unet": _unet_sources, "vae": _vae_sources, "text": _text_sources}
    return builders[name](config)


def expected_original(config: MVDreamConfig, name: str) -> dict[str, Shape]:
    """Return the original names (without prefix) and shapes of a network, unused ones included."""
    table = component_sources(config, name).values()
    expected = {source.name: source.original_shape(shape) for source, shape in table}
    if name == "text":
        expected.update(keys.unused_text_shapes(config.text))
    return expected


def _open_original(path: Path) -> Weights:
    """Open layout (a)."""
    sizes = path.with_suffix(".json")
    config = PUBLISHED
    if sizes.is_file():
        config = from_json(MVDreamConfig, read_json(sizes), str(sizes))
    file = TensorFile(path)
    expected, parts = {}, {}
    for name in COMPONENTS:
        prefix = keys.PREFIXES[name]
        for original, shape in expected_original(config, name).items():
            expected[prefix + original] = shape
        parts[name] = Part(
            file,
            {
                ours: Source(prefix + source.name, source.third, source.squeeze)
                for ours, (source, _) in component_sources(config, name).items()
            },
        )
    schedule = [name for name in keys.SCHEDULE_VECTORS if name in file.shapes]
    if schedule:  # all twelve or none: they are computed here, and only checked against the file
        expected.update(dict.fromkeys(keys.SCHEDULE_VECTORS, (1000,)))
    check_tensors(path, file.shapes, expected, what="MVDream (sd-v2.1-base-4view)")
    if schedule:
        _check_schedule(file)
    return Weights(path, "original", config, parts)


def _open_folder(path: Path) -> Weights:
    """Open layout (b)."""
    unet_json = path / "unet" / "config.json"
    data = read_json(unet_json)
    found = data.get("_class_name") if isinstance(data, dict) else None
    if found != "MultiViewUNetModel":
        raise UserError(f"{unet_json}: _class_name: expected MultiViewUNetModel, found {found}")
    config = MVDreamConfig(
        UNetConfig.from_original(data, str(unet_json)),
        read_vae_config(path / "vae" / "config.json"),
        read_text_config(path / "text_encoder" / "config.json"),
    )
    file = TensorFile(find_tensor_file(path / "unet"))
    check_tensors(file.path, file.shapes, expected_original(config, "unet"), what="MVDream's UNet")
    sources = {ours: s for ours, (s, _) in component_sources(config, "unet").items()}
    return Weights(
        path,
        "folder",
        config,
        {
            "unet": Part(file, sources),
            "vae": vae_part(path / "vae", _on_meta(lambda: build_vae(config.vae))),
            "text": text_part(
                path / "text_encoder", _on_meta(lambda: build_text_tower(config.text))
            ),
        },
    )


def _open_converted(path: Path) -> Weights:
    """Open layout (c)."""
    manifest_path = path / MANIFEST_FILE
    manifest = read_json(manifest_path)
    for field, expected in (("schema", MANIFEST_SCHEMA), ("version", MANIFEST_VERSION)):
        found = manifest.get(field) if isinstance(manifest, dict) else None
        if found != expected:
            raise UserError(f"{manifest_path}: {field}: expected {expected!r}, found {found!r}")
    config = from_json(MVDreamConfig, manifest.get("config"), str(manifest_path))
    parts = {}
    for name in COMPONENTS:
        file = TensorFile(path / f"{name}.safetensors")
        table = component_sources(config, name)
        stored = {ours: stored_name(ours) for ours in table}
        shapes = {stored[ours]: shape for ours, (_, shape) in table.items()}
        check_tensors(file.path, file.shapes, shapes, what=f"MVDream's {name}")
        parts[name] = Part(file, {ours: Source(stored[ours]) for ours in table})
    return Weights(path, "converted", config, parts)


def stored_name(ours: str) -> str:
    """Return a tensor's name in layout (c): ours, without the prefix some transformers add."""
    return ours.removeprefix("text_model.")


def _check_schedule(file: TensorFile) -> None:
    """Refuse a file whose noise schedule is not the one that is computed here."""
    stored = file.get("alphas_cumprod").double()
    ours = torch.tensor(NoiseSchedule.stable_diffusion().alphas_bar, dtype=torch.float64)
    worst = float((stored - ours).abs().max())
    if not worst < 1e-4:
        raise UserError(
            f"{file.path}: alphas_cumprod: expected the schedule linear in sqrt(beta), 0.00085 to "
            f"0.012, found one that differs by {worst:.3g}"
        )


def _unet_sources(config: MVDreamConfig) -> Sources:
    state = _on_meta(lambda: build_unet(config.unet)).state_dict()
    return {n: (keys.unet_source(n, config.unet), tuple(v.shape)) for n, v in state.items()}


def _vae_sources(config: MVDreamConfig) -> Sources:
    state = _on_meta(lambda: build_vae(config.vae)).state_dict()
    levels = len(config.vae.channel_mult)
    return {n: (keys.vae_source(n, levels), tuple(v.shape)) for n, v in state.items()}


def _text_sources(config: MVDreamConfig) -> Sources:
    state = _on_meta(lambda: build_text_tower(config.text)).state_dict()
    return {n: (keys.text_source(n), tuple(v.shape)) for n, v in state.items()}


def _on_meta(build: Any) -> Any:
    """Build a module that has shapes and no numbers."""
    with torch.device("meta"):
        return build()
