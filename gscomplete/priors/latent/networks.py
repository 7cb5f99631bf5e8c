"""Stable Diffusion's autoencoder and text tower as diffusers and transformers build them.

Conventions
-----------
* Defaults are the sizes of Stable Diffusion 2.1, which MVDream shares.
* Nothing here has weights: build under ``torch.device("meta")`` and let ``load_strictly`` fill in
  every tensor. A model that was not loaded therefore cannot run; it has no numbers at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from gscomplete.errors import UserError


@dataclass(frozen=True, slots=True)
class VAEConfig:
    """The autoencoder between pixels and latents: Stable Diffusion's."""

    base_channels: int = 128
    channel_mult: tuple[int, ...] = (1, 2, 4, 4)
    num_res_blocks: int = 2
    """Residual blocks per level of the encoder; the decoder has one more."""
    latent_channels: int = 4
    norm_groups: int = 32
    scaling_factor: float = 0.18215
    """Latents are the posterior's samples times this."""

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels of each level."""
        return tuple(self.base_channels * factor for factor in self.channel_mult)


@dataclass(frozen=True, slots=True)
class TextConfig:
    """The text tower: OpenCLIP ViT-H-14, read after its penultimate block and the final norm."""

    width: int = 1024
    heads: int = 16
    layers: int = 23
    """Blocks that are run; the original file holds one more, which is never used."""
    mlp_width: int = 4096
    vocabulary_size: int = 49408
    length: int = 77
    hidden_act: str = "gelu"
    """``gelu`` is the exact one; CLIP-L's towers use ``quick_gelu``."""


def require(package: str) -> Any:
    """Import an optional package of the extra ``mvdream``.

    Raises:
        UserError: it is not installed, or cannot be imported.
    """
    import importlib

    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise UserError(
            f"--prior: diffusion priors need the package {package} ({error}); install the extra "
            "gscomplete[mvdream]"
        ) from error


def build_vae(config: VAEConfig) -> Any:
    """Build the autoencoder on the current default device."""
    diffusers = require("diffusers")
    levels = len(config.widths)
    vae = diffusers.AutoencoderKL(
        in_channels=3,
        out_channels=3,
        latent_channels=config.latent_channels,
        block_out_channels=config.widths,
        layers_per_block=config.num_res_blocks,
        down_block_types=("DownEncoderBlock2D",) * levels,
        up_block_types=("UpDecoderBlock2D",) * levels,
        norm_num_groups=config.norm_groups,
        act_fn="silu",
        scaling_factor=config.scaling_factor,
    )
    return vae.eval().requires_grad_(False)


def build_text_tower(config: TextConfig) -> Any:
    """Build the text tower on the current default device; its output is ``last_hidden_state``."""
    transformers = require("transformers")
    settings = transformers.CLIPTextConfig(
        vocab_size=config.vocabulary_size,
        hidden_size=config.width,
        intermediate_size=config.mlp_width,
        num_hidden_layers=config.layers,
        num_attention_heads=config.heads,
        max_position_embeddings=config.length,
        hidden_act=config.hidden_act,
        attn_implementation="sdpa",
    )
    return transformers.CLIPTextModel(settings).eval().requires_grad_(False)


def load_strictly(module: Any, state: dict[str, Tensor]) -> Any:
    """Put tensors in place of a meta module's parameters; all of them and nothing else.

    Raises:
        RuntimeError: the tensors are not exactly those of the module (callers check names and
            shapes before, in words for users).
    """
    module.load_state_dict(state, strict=True, assign=True)
    for name, buffer in list(module.named_buffers()):
        if buffer.is_meta and name.endswith("position_ids"):  # not stored in files
            owner = module.get_submodule(name.rpartition(".")[0])
            owner.position_ids = torch.arange(buffer.shape[-1]).expand(buffer.shape).clone()
    left = [n for n, t in (*module.named_parameters(), *module.named_buffers()) if t.is_meta]
    if left:
        raise RuntimeError(f"tensors without values after loading: {', '.join(left[:5])}")
    return module.eval().requires_grad_(False)
