"""Put the networks of a latent prior on a device, as the knobs say."""

from __future__ import annotations

import dataclasses
from typing import Any

import torch

from gscomplete.priors.base import Guidance
from gscomplete.priors.latent.folders import find_tensor_file
from gscomplete.priors.latent.settings import LatentPriorSettings, MemoryPlan, vae_dtype
from gscomplete.priors.latent.tensor_files import fingerprint
from gscomplete.priors.latent.tiny_vae import load_tiny_vae
from gscomplete.priors.latent.vae import LatentCodec
from gscomplete.util.jsonio import to_json

_ONLY_SPEED = ("memory", "channels_last", "compile")


def prepare(
    network: Any, device: torch.device, dtype: torch.dtype, settings: LatentPriorSettings
) -> Any:
    """Move a UNet to its device, and on a GPU set its memory format and compile it."""
    is_gpu = device.type == "cuda"
    layout = torch.channels_last if is_gpu and settings.channels_last else torch.contiguous_format
    # torch's own ``to``: diffusers' warns of precisions that this network does not ask for
    move: Any = torch.nn.Module.to
    move(network, device=device, dtype=dtype, memory_format=layout)
    if is_gpu and settings.compile != "off":
        mode = "reduce-overhead" if settings.compile == "cuda-graphs" else None
        return torch.compile(network, mode=mode)
    return network


def prepare_codec(
    vae: Any, device: torch.device, settings: LatentPriorSettings, plan: MemoryPlan
) -> LatentCodec:
    """Put an autoencoder on its device as the knobs say, or the tiny one in its place."""
    chosen = vae if settings.tiny_vae is None else load_tiny_vae(settings.tiny_vae)
    codec = LatentCodec(
        chosen,
        plan,
        device,
        vae_dtype(settings.vae_precision, device),
        channels_last=settings.channels_last and device.type == "cuda",
    )
    if settings.compile != "off" and device.type == "cuda":
        codec.compile()
    return codec


def deciding_settings(
    settings: LatentPriorSettings, guidance: Guidance, negative_prompt: str
) -> dict[str, Any]:
    """Return what decides a result by more than rounding, defaults filled in, as JSON values."""
    values = dataclasses.asdict(settings)
    values |= {"guidance": guidance.text_scale, "rescale": guidance.rescale}
    values["negative_prompt"] = negative_prompt
    if settings.tiny_vae is not None:  # what it is, wherever it lies
        values["tiny_vae"] = fingerprint((find_tensor_file(settings.tiny_vae),))
    return {k: to_json(v) for k, v in values.items() if k not in _ONLY_SPEED}
