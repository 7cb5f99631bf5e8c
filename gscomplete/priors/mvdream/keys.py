"""Names of tensors: the published files' names for every tensor of the models built here.

Conventions
-----------
* "Original" names are those of layout (a), the single .pt, without their three prefixes
  (``PREFIXES``); "ours" are diffusers' and transformers'.
* A map goes from our name to a :class:`Source`: the original tensor, and which part of it. No
  value is changed; only names, a third of a stacked matrix, and trailing 1 x 1 axes.
* Maps follow from the configuration alone, so a model of other sizes needs no other table.
"""

from __future__ import annotations

import re

from gscomplete.priors.latent.networks import TextConfig
from gscomplete.priors.latent.tensor_files import Source
from gscomplete.priors.mvdream.config import UNetConfig

PREFIXES = {
    "unet": "model.diffusion_model.",
    "vae": "first_stage_model.",
    "text": "cond_stage_model.model.",
}
"""What stands before original names in layout (a)."""

SCHEDULE_VECTORS = (
    "betas",
    "alphas_cumprod",
    "alphas_cumprod_prev",
    "sqrt_alphas_cumprod",
    "sqrt_one_minus_alphas_cumprod",
    "log_one_minus_alphas_cumprod",
    "sqrt_recip_alphas_cumprod",
    "sqrt_recipm1_alphas_cumprod",
    "posterior_variance",
    "posterior_log_variance_clipped",
    "posterior_mean_coef1",
    "posterior_mean_coef2",
)
"""Vectors of the noise schedule at the top level of layout (a); computed here, not loaded."""

_UNET_RESNET = (
    ("time_emb_proj", "emb_layers.1"),
    ("conv_shortcut", "skip_connection"),
    ("norm1", "in_layers.0"),
    ("conv1", "in_layers.2"),
    ("norm2", "out_layers.0"),
    ("conv2", "out_layers.3"),
)
_UNET_ENDS = (
    ("time_embedding.linear_1", "time_embed.0"),
    ("time_embedding.linear_2", "time_embed.2"),
    ("class_embedding.linear_1", "camera_embed.0"),
    ("class_embedding.linear_2", "camera_embed.2"),
    ("conv_in", "input_blocks.0.0"),
    ("conv_norm_out", "out.0"),
    ("conv_out", "out.2"),
)
_VAE_ATTENTION = (
    ("group_norm", "norm"),
    ("to_q", "q"),
    ("to_k", "k"),
    ("to_v", "v"),
    ("to_out.0", "proj_out"),
)
_VAE_RESIZE = {"downsamplers": "downsample", "upsamplers": "upsample"}
_TEXT_BLOCK = (
    ("layer_norm1", "ln_1"),
    ("layer_norm2", "ln_2"),
    ("mlp.fc1", "mlp.c_fc"),
    ("mlp.fc2", "mlp.c_proj"),
    ("self_attn.out_proj", "attn.out_proj"),
)
_QKV = ("q_proj", "k_proj", "v_proj")


def unet_source(name: str, config: UNetConfig) -> Source:
    """Return the source of a tensor of diffusers' ``UNet2DConditionModel``."""
    for ours, original in _UNET_ENDS:
        if name.startswith(ours + "."):
            return Source(original + name[len(ours) :])
    if match := re.match(r"mid_block\.(resnets|attentions)\.(\d)\.(.+)", name):
        kind, index, rest = match.groups()
        place = 1 if kind == "attentions" else 2 * int(index)
        return Source(f"middle_block.{place}.{_unet_inner(kind, rest)}")
    match = re.match(r"(down|up)_blocks\.(\d+)\.(\w+?)\.(\d+)\.(.+)", name)
    if match is None:
        raise KeyError(name)
    way, block, kind, index, rest = match.groups()
    per_level, level = config.num_res_blocks + 1, int(block)
    if kind == "downsamplers":
        place = 1 + level * per_level + config.num_res_blocks
        return Source(f"input_blocks.{place}.0.{rest.replace('conv', 'op')}")
    if kind == "upsamplers":
        slot = 2 if tuple(reversed(config.has_attention))[level] else 1
        return Source(f"output_blocks.{level * per_level + per_level - 1}.{slot}.{rest}")
    first = 1 if way == "down" else 0
    original = f"{'input' if way == 'down' else 'output'}_blocks.{first + level * per_level}"
    stem, start = original.rsplit(".", 1)
    slot = 1 if kind == "attentions" else 0
    return Source(f"{stem}.{int(start) + int(index)}.{slot}.{_unet_inner(kind, rest)}")


def vae_source(name: str, levels: int) -> Source:
    """Return the source of a tensor of diffusers' ``AutoencoderKL``."""
    name = name.replace("conv_norm_out", "norm_out").replace("conv_shortcut", "nin_shortcut")
    if match := re.match(r"(encoder|decoder)\.mid_block\.(resnets|attentions)\.(\d)\.(.+)", name):
        side, kind, index, rest = match.groups()
        if kind == "resnets":
            return Source(f"{side}.mid.block_{int(index) + 1}.{rest}")
        for ours, original in _VAE_ATTENTION:
            if rest.startswith(ours + "."):
                squeeze = ours != "group_norm" and rest.endswith("weight")
                return Source(f"{side}.mid.attn_1.{original}{rest[len(ours) :]}", squeeze=squeeze)
        raise KeyError(name)
    if match := re.match(
        r"(encoder|decoder)\.(?:down|up)_blocks\.(\d+)\.(\w+?)\.(\d+)\.(.+)", name
    ):
        side, block, kind, index, rest = match.groups()
        level = int(block) if side == "encoder" else levels - 1 - int(block)
        stem = f"{side}.{'down' if side == 'encoder' else 'up'}.{level}"
        if kind == "resnets":
            return Source(f"{stem}.block.{index}.{rest}")
        return Source(f"{stem}.{_VAE_RESIZE[kind]}.{rest}")
    return Source(name)


def text_source(name: str) -> Source:
    """Return the source of a tensor of transformers' ``CLIPTextModel``, prefix or not."""
    name = name.removeprefix("text_model.")
    plain = {
        "embeddings.token_embedding.weight": "token_embedding.weight",
        "embeddings.position_embedding.weight": "positional_embedding",
        "final_layer_norm.weight": "ln_final.weight",
        "final_layer_norm.bias": "ln_final.bias",
    }
    if name in plain:
        return Source(plain[name])
    match = re.match(r"encoder\.layers\.(\d+)\.(.+)", name)
    if match is None:
        raise KeyError(name)
    stem, rest = f"transformer.resblocks.{match[1]}", match[2]
    for ours, original in _TEXT_BLOCK:
        if rest.startswith(ours + "."):
            return Source(f"{stem}.{original}{rest[len(ours) :]}")
    _, projection, kind = rest.split(".")
    return Source(f"{stem}.attn.in_proj_{kind}", third=_QKV.index(projection))


def unused_text_shapes(config: TextConfig) -> dict[str, tuple[int, ...]]:
    """Return the text tower's original tensors that are stored but never used."""
    width, wide, stem = config.width, config.mlp_width, f"transformer.resblocks.{config.layers}"
    return {
        "text_projection": (width, width),
        "logit_scale": (),
        f"{stem}.ln_1.weight": (width,),
        f"{stem}.ln_1.bias": (width,),
        f"{stem}.attn.in_proj_weight": (3 * width, width),
        f"{stem}.attn.in_proj_bias": (3 * width,),
        f"{stem}.attn.out_proj.weight": (width, width),
        f"{stem}.attn.out_proj.bias": (width,),
        f"{stem}.ln_2.weight": (width,),
        f"{stem}.ln_2.bias": (width,),
        f"{stem}.mlp.c_fc.weight": (wide, width),
        f"{stem}.mlp.c_fc.bias": (wide,),
        f"{stem}.mlp.c_proj.weight": (width, wide),
        f"{stem}.mlp.c_proj.bias": (width,),
    }


def _unet_inner(kind: str, rest: str) -> str:
    """Rename within a residual block; names within attention are the same."""
    if kind == "resnets":
        for ours, original in _UNET_RESNET:
            if rest.startswith(ours + "."):
                return original + rest[len(ours) :]
        raise KeyError(rest)
    return rest
