"""MVDream behind the common interface: the prior of the paper.

Conventions
-----------
* Guidance 50, rescale 0.5, x0-reconstruction and the negative prompt are MVDream-threestudio's
  defaults; the suffix ", 3d asset" of its image demo is not added, as in its distillation.
* Framing: fov 40 degrees (trained: 15 to 60), elevations 0 to 30 (trained), visible extent 1.3 to
  1.6 object sizes, so that an object fills most of the image, as in training, and is not cut.
* 256 x 256 pixels, 32 x 32 latents.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gscomplete.priors.base import PriorViews
from gscomplete.priors.latent.guidance import NoiseSchedule
from gscomplete.priors.latent.on_device import deciding_settings, prepare, prepare_codec
from gscomplete.priors.latent.prior import (
    VIEWS,
    LatentModel,
    LatentPrior,
    PriorIdentity,
    default_guidance,
)
from gscomplete.priors.latent.settings import LatentPriorSettings, memory_plan, unet_dtype
from gscomplete.priors.latent.text import PromptEncoder, cache_home
from gscomplete.priors.latent.tokenizer import Tokenizer
from gscomplete.priors.mvdream.cameras import camera_matrices
from gscomplete.priors.mvdream.model import MultiViewUNet
from gscomplete.priors.mvdream.weights import Weights, open_weights
from gscomplete.views import Cameras

MVDREAM_VIEWS = PriorViews(
    fov_deg=40.0, extent_range=(1.3, 1.6), elevation_range_deg=(0.0, 30.0), resolution_px=256
)
GUIDANCE_SCALE = 50.0
NEGATIVE_PROMPT = (
    "ugly, bad anatomy, blurry, pixelated obscure, unnatural colors, poor lighting, dull, and "
    "unclear, cropped, lowres, low quality, artifacts, duplicate, morbid, mutilated, poorly drawn "
    "face, deformed, dehydrated, bad proportions"
)
"""MVDream-threestudio's and DreamGaussian's, letter for letter."""


class MultiViewDenoiser:
    """MVDream's UNet on a device, in its precision, given our cameras."""

    schedule = NoiseSchedule.stable_diffusion()
    group = VIEWS

    def __init__(
        self,
        network: MultiViewUNet,
        device: torch.device,
        dtype: torch.dtype,
        settings: LatentPriorSettings,
    ) -> None:
        """Move the network to the device and prepare it as the knobs say."""
        self._network: Any = prepare(network, device, dtype, settings)
        self._device, self._dtype = device, dtype
        self._front_azimuth_deg = settings.front_azimuth_deg
        self._has_graphs = settings.compile == "cuda-graphs" and device.type == "cuda"

    @torch.no_grad()
    def __call__(self, noisy: Tensor, timestep: int, context: Tensor, cameras: Cameras) -> Tensor:
        """Predict noise; see :class:`gscomplete.priors.latent.prior.Denoiser`."""
        passes = len(context)
        matrices = camera_matrices(cameras, self._front_azimuth_deg).to(self._device, self._dtype)
        if self._has_graphs:
            torch.compiler.cudagraph_mark_step_begin()
        noise = self._network(
            noisy.to(self._dtype),
            torch.full((len(noisy),), timestep, dtype=torch.int64, device=self._device),
            context.to(self._dtype).repeat_interleave(VIEWS, dim=0),
            matrices.repeat(passes, 1),
        )
        return torch.as_tensor(noise).to(torch.float32, copy=True)


def mvdream_prior(
    weights: Weights,
    device: torch.device,
    settings: LatentPriorSettings | None = None,
    cache: Path | None = None,
    views: PriorViews = MVDREAM_VIEWS,
) -> LatentPrior:
    """Build the prior from opened weights.

    Args:
        weights: of any layout.
        device: where the networks run.
        settings: knobs; None = the defaults.
        cache: folder of remembered prompt embeddings; None = remember nothing.
        views: framing.
    """
    settings = settings or LatentPriorSettings()
    plan = memory_plan(settings.memory, device)
    denoiser = MultiViewDenoiser(
        weights.unet(), device, unet_dtype(settings.precision, device), settings
    )
    text = weights.config.text
    encoder = PromptEncoder(
        Tokenizer(text.length),
        weights.text_tower,
        weights.text_fingerprint(),
        (text.length, text.width),
        device,
        cache,
    )
    guidance = default_guidance(settings, GUIDANCE_SCALE)
    codec = prepare_codec(weights.vae(), device, settings, plan)
    model = LatentModel("mvdream", denoiser, codec, encoder, views, guidance, NEGATIVE_PROMPT)
    identity = PriorIdentity(
        weights.fingerprint(), deciding_settings(settings, guidance, NEGATIVE_PROMPT)
    )
    return LatentPrior(model, settings, plan, device, identity)


def load_mvdream(
    path: Path, device: torch.device | str = "cpu", settings: LatentPriorSettings | None = None
) -> LatentPrior:
    """Load MVDream from its published file, a diffusers-style folder or a converted folder.

    Raises:
        UserError: the weights are missing, damaged, or not exactly MVDream's.
    """
    cache = cache_home() / "prompts"
    return mvdream_prior(open_weights(path), torch.device(device), settings, cache)
