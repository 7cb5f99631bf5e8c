"""Reduced-width MVDreams with random numbers, in every layout. The package makes none."""

import json
import math
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor

from gscomplete.priors.base import PriorViews
from gscomplete.priors.latent.guidance import NoiseSchedule
from gscomplete.priors.latent.networks import TextConfig, VAEConfig
from gscomplete.priors.mvdream import keys
from gscomplete.priors.mvdream.config import MVDreamConfig, UNetConfig
from gscomplete.priors.mvdream.weights import COMPONENTS, expected_original
from gscomplete.util.jsonio import to_json, write_json

TINY = MVDreamConfig(
    UNetConfig(
        model_channels=32,
        channel_mult=(1, 2),
        num_res_blocks=1,
        attention_resolutions=(2,),
        num_head_channels=16,
        context_dim=24,
    ),
    VAEConfig(base_channels=8, channel_mult=(1, 1, 2, 2), num_res_blocks=1, norm_groups=4),
    TextConfig(width=24, heads=3, layers=2, mlp_width=48),
)
TINY_VIEWS = PriorViews(40.0, (1.3, 1.6), (0.0, 30.0), 32)


def random_tensors(shapes: dict[str, tuple[int, ...]], seed: int) -> dict[str, Tensor]:
    """Random numbers in float16's precision that keep activations near 1; none are zero."""
    g = torch.Generator().manual_seed(seed)
    out = {}
    for name, shape in shapes.items():
        value = torch.randn(shape, generator=g)
        if len(shape) >= 2:
            value = value / math.sqrt(math.prod(shape[1:]))
        elif name.endswith("bias"):
            value = value * 0.1
        else:
            value = 1 + 0.2 * value
        out[name] = value.to(torch.float16).float()
    return out


def original_tensors(config: MVDreamConfig = TINY, seed: int = 0) -> dict[str, Tensor]:
    """All tensors of layout (a), with prefixes and schedule."""
    shapes = {
        keys.PREFIXES[component] + name: shape
        for component in COMPONENTS
        for name, shape in expected_original(config, component).items()
    }
    tensors = random_tensors(shapes, seed)
    for name in keys.SCHEDULE_VECTORS:
        tensors[name] = torch.zeros(1000)
    tensors["alphas_cumprod"] = torch.tensor(NoiseSchedule.stable_diffusion().alphas_bar)
    return tensors


def component(tensors: dict[str, Tensor], name: str) -> dict[str, Tensor]:
    """The tensors of one network under their original names, float64."""
    prefix = keys.PREFIXES[name]
    return {k[len(prefix) :]: v.double() for k, v in tensors.items() if k.startswith(prefix)}


def write_original(folder: Path, config: MVDreamConfig = TINY, seed: int = 0) -> Path:
    """Layout (a): the .pt and its sizes."""
    path = folder / "tiny-4view.pt"
    torch.save(original_tensors(config, seed), path)
    write_json(path.with_suffix(".json"), config)
    return path


def write_folder(folder: Path, config: MVDreamConfig = TINY, seed: int = 0) -> Path:
    """Layout (b), from the same numbers as layout (a), with the names that old files have."""
    tensors = original_tensors(config, seed)
    for name in ("unet", "vae", "text_encoder"):
        (folder / name).mkdir(parents=True)
    unet = {k: v.half() for k, v in component(tensors, "unet").items()}
    save_file(unet, folder / "unet/diffusion_pytorch_model.safetensors")
    sizes = to_json(config.unet)
    views = sizes.pop("num_views")
    assert views == 4
    sizes |= {"_class_name": "MultiViewUNetModel", "image_size": 32, "use_checkpoint": False}
    (folder / "unet/config.json").write_text(json.dumps(sizes))
    write_vae_folder(folder / "vae", config, tensors)
    write_text_folder(folder / "text_encoder", config, tensors)
    return folder


def write_vae_folder(folder: Path, config: MVDreamConfig, tensors: dict[str, Tensor]) -> None:
    from gscomplete.priors.mvdream.weights import component_sources

    original, stored = component(tensors, "vae"), {}
    for ours, (source, _) in component_sources(config, "vae").items():
        value = original[source.name].half()  # 1 x 1 kernels stay kernels, as in old files
        for new, old in (("to_q", "query"), ("to_k", "key"), ("to_v", "value")):
            ours = ours.replace(f".{new}.", f".{old}.")
        stored[ours.replace(".to_out.0.", ".proj_attn.")] = value.contiguous()
    save_file(stored, folder / "diffusion_pytorch_model.safetensors")
    sizes = {
        "_class_name": "AutoencoderKL",
        "block_out_channels": list(config.vae.widths),
        "layers_per_block": config.vae.num_res_blocks,
        "latent_channels": 4,
        "norm_num_groups": config.vae.norm_groups,
    }
    (folder / "config.json").write_text(json.dumps(sizes))


def write_text_folder(folder: Path, config: MVDreamConfig, tensors: dict[str, Tensor]) -> None:
    from gscomplete.priors.mvdream.weights import component_sources

    original = component(tensors, "text")
    stored = {
        "text_model." + ours.removeprefix("text_model."): source.take(original[source.name])
        .half()
        .clone()
        .contiguous()
        for ours, (source, _) in component_sources(config, "text").items()
    }
    stored["text_model.embeddings.position_ids"] = torch.arange(77)[None]
    save_file(stored, folder / "model.safetensors")
    text = config.text
    sizes = {
        "architectures": ["CLIPTextModel"],
        "hidden_size": text.width,
        "num_attention_heads": text.heads,
        "num_hidden_layers": text.layers,
        "intermediate_size": text.mlp_width,
        "hidden_act": "gelu",
    }
    (folder / "config.json").write_text(json.dumps(sizes))
