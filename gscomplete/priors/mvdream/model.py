"""MVDream's denoiser as diffusers builds it; the other networks are Stable Diffusion's.

Conventions
-----------
* Nothing here has weights: build under ``torch.device("meta")`` and let ``weights`` fill in every
  tensor. A model that was not loaded therefore cannot run; it has no numbers at all.
* The UNet is diffusers' ``UNet2DConditionModel`` as SD 2.1 configures it. Two things differ: a
  projection "class" embedding takes the camera matrix (16 numbers, added to the time embedding),
  and self-attention is joint (``attention``).
* In diffusers' configuration ``attention_head_dim`` holds the NUMBER of heads for this UNet.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from gscomplete.priors.latent.networks import require
from gscomplete.priors.mvdream.attention import check_joint_attention, install_joint_attention
from gscomplete.priors.mvdream.config import UNetConfig


def build_unet(config: UNetConfig) -> Any:
    """Build the denoiser on the current default device, with joint attention installed."""
    diffusers = require("diffusers")
    down = ["CrossAttnDownBlock2D" if has else "DownBlock2D" for has in config.has_attention]
    up = ["CrossAttnUpBlock2D" if has else "UpBlock2D" for has in reversed(config.has_attention)]
    unet = diffusers.UNet2DConditionModel(
        in_channels=config.in_channels,
        out_channels=config.out_channels,
        block_out_channels=config.widths,
        layers_per_block=config.num_res_blocks,
        down_block_types=tuple(down),
        mid_block_type="UNetMidBlock2DCrossAttn",
        up_block_types=tuple(up),
        attention_head_dim=tuple(width // config.num_head_channels for width in config.widths),
        transformer_layers_per_block=config.transformer_depth,
        cross_attention_dim=config.context_dim,
        use_linear_projection=True,
        class_embed_type="projection",
        projection_class_embeddings_input_dim=config.camera_dim,
        flip_sin_to_cos=True,
        freq_shift=0,
        norm_num_groups=32,
        norm_eps=1e-5,
        downsample_padding=1,
        act_fn="silu",
    )
    install_joint_attention(unet, config.num_views)
    return unet.eval().requires_grad_(False)


class MultiViewUNet(torch.nn.Module):
    """The denoiser with the call that guidance needs: noise from noisy latents and cameras."""

    def __init__(self, unet: Any, num_views: int) -> None:
        """Wrap a loaded UNet.

        Raises:
            RuntimeError: its self-attention is not joint.
        """
        super().__init__()
        check_joint_attention(unet, num_views)
        self.unet = unet
        self.num_views = num_views

    def forward(
        self,
        latents: Tensor,  # [groups * num_views, 4, h, w] noisy
        timesteps: Tensor,  # [groups * num_views] int64
        context: Tensor,  # [groups * num_views, 77, context_dim]
        cameras: Tensor,  # [groups * num_views, 16], see ``cameras``
    ) -> Tensor:  # [groups * num_views, 4, h, w] predicted noise
        """Predict the noise. The timestep embedding is computed in float32, then cast."""
        return self.unet(
            latents,
            timesteps,
            encoder_hidden_states=context,
            class_labels=cameras,
            return_dict=False,
        )[0]
