"""Between pixels and latents, with the gradient that distillation needs.

Conventions
-----------
* Images [V, 3, H, W] in [-1, 1]; latents [V, 4, H/8, W/8] are the posterior's sample times the
  scaling factor, in float32 whatever the network's precision.
* Weights are frozen: the gradient goes through the encoder to the images and nowhere else.
* The noise of the posterior is passed in, so that an encoding that is computed twice is the same.
* On a GPU the decoder stays in main memory but for the moments it is used.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from gscomplete.priors.latent.settings import MemoryPlan


class LatentCodec:
    """An autoencoder on a device, under a memory plan."""

    def __init__(
        self,
        vae: Any,
        plan: MemoryPlan,
        device: torch.device,
        dtype: torch.dtype,
        *,
        channels_last: bool = False,
    ) -> None:
        """Take a loaded ``AutoencoderKL``, or an ``AutoencoderTiny`` as a fast approximation.

        Args:
            vae: in evaluation mode, frozen.
            plan: how many views at once, and whether activations are computed again.
            device: where it runs.
            dtype: of the network.
            channels_last: memory format of the network.
        """
        self._vae, self._plan, self._device, self._dtype = vae, plan, device, dtype
        self._format = torch.channels_last if channels_last else torch.contiguous_format
        for name, part in vae.named_children():
            part.to(device=self._home(name), dtype=dtype, memory_format=self._format)
        self._is_tiny = not hasattr(vae, "quant_conv")
        self._factor = float(vae.config.scaling_factor)
        self._encoder = vae.encoder

    @property
    def latent_channels(self) -> int:
        """Channels of the latents."""
        return int(self._vae.config.latent_channels)

    @property
    def downsampling(self) -> int:
        """Pixels per latent along a side."""
        widths = self._vae.config[
            "encoder_block_out_channels" if self._is_tiny else "block_out_channels"
        ]
        return int(2 ** (len(widths) - 1))

    def compile(self, mode: str | None = None) -> None:
        """Compile the encoder."""
        self._encoder = torch.compile(self._vae.encoder, mode=mode)

    def encode(self, images: Tensor, noise: Tensor | None) -> Tensor:  # [V, 4, h, w] float32
        """Encode images, with graph.

        Args:
            images: [V, 3, H, W] in [-1, 1].
            noise: [V, 4, h, w] standard normal, for a sample of the posterior; None = its mean.
        """
        images = images.to(self._device)
        step = self._plan.vae_views
        parts = []
        for start in range(0, len(images), step):
            part = images[start : start + step]
            drawn = None if noise is None else noise[start : start + step].to(self._device)
            if self._plan.recompute and torch.is_grad_enabled():
                parts.append(checkpoint(self._encode, part, drawn, use_reentrant=False))
            else:
                parts.append(self._encode(part, drawn))
        return torch.cat(parts)

    @torch.no_grad()
    def decode(self, latents: Tensor) -> Tensor:  # [V, 3, H, W] about [-1, 1]
        """Decode latents, without graph."""
        self._move_decoder(self._device)
        try:
            parts = []
            for latent in latents.split(self._plan.vae_views):
                latent = (latent / self._factor).to(self._device, self._dtype)
                parts.append(self._vae.decode(latent, return_dict=False)[0].float())
            return torch.cat(parts)
        finally:
            self._move_decoder(self._home("decoder"))

    def _encode(self, images: Tensor, noise: Tensor | None) -> Tensor:
        images = images.to(self._dtype, memory_format=self._format)
        if self._is_tiny:
            return self._encoder(images).float() * self._factor
        moments = self._encoder(images)
        if self._vae.quant_conv is not None:
            moments = self._vae.quant_conv(moments)
        mean, log_variance = moments.float().chunk(2, dim=1)
        if noise is None:
            return mean * self._factor
        deviation = torch.exp(0.5 * log_variance.clamp(-30.0, 20.0))
        return (mean + deviation * noise.to(mean)) * self._factor

    def _home(self, part: str) -> torch.device:
        """Where a part of the network stays while it is not used."""
        waits = part in ("decoder", "post_quant_conv") and self._device.type == "cuda"
        return torch.device("cpu") if waits else self._device

    def _move_decoder(self, device: torch.device) -> None:
        for name in ("post_quant_conv", "decoder"):
            part = getattr(self._vae, name, None)
            if part is not None:
                part.to(device)
