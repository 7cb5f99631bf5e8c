"""Distillation through any latent diffusion model: what MVDream and single-view priors share.

Conventions
-----------
* Renders are placed over a background drawn for the step, resized to the model's resolution
  (bilinear, as the references do) and encoded; losses count differences of latents.
* Random numbers are drawn on the CPU in a fixed order: background, posterior noise, noise.
* Timesteps of the interface may be fractional and are rounded; the denoiser is never
  differentiated; the gradient reaches the renders through the encoder.
* These priors see neither alpha nor P. ``reconstruct`` mats its images against the colour of their
  border, which the model is free to choose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import torch
import torch.nn.functional as F
from torch import Tensor

from gscomplete.priors.base import Conditioning, FourViews, Guidance, PriorViews
from gscomplete.priors.ddim import ddim
from gscomplete.priors.latent.guidance import (
    NoiseSchedule,
    epsilon_loss,
    guided_noise,
    rescaled,
    x0_loss,
)
from gscomplete.priors.latent.settings import Background, LatentPriorSettings, MemoryPlan
from gscomplete.priors.latent.text import PromptEncoder
from gscomplete.priors.latent.vae import LatentCodec
from gscomplete.views import Cameras

VIEWS = 4
_MATTE_LOW, _MATTE_HIGH = 0.04, 0.16
"""Differences from the border's colour at which a pixel counts as clear and as covered."""


class Denoiser(Protocol):
    """A network that predicts noise for rings of four views."""

    schedule: NoiseSchedule
    group: int
    """Images that are denoised together: 4, or 1 where views know nothing of each other."""

    def __call__(
        self,
        noisy: Tensor,  # [passes * 4, C, h, w]
        timestep: int,
        context: Tensor,  # [passes, 77, width], one text per pass over the ring
        cameras: Cameras,  # 4
    ) -> Tensor:  # [passes * 4, C, h, w] predicted noise, float32
        """Predict the noise of one or more copies of a ring."""
        ...


@dataclass(frozen=True, slots=True)
class LatentConditioning:
    """Embeddings of a prompt and of what guidance leads away from."""

    context: Tensor  # [77, width]
    negative_context: Tensor  # [77, width]
    report: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PriorIdentity:
    """What of a prior decides a run's result."""

    weights: str
    """Digest of the weights."""
    settings: dict[str, Any]


@dataclass(frozen=True, slots=True)
class LatentModel:
    """A latent diffusion model as published: its networks, and how it is used."""

    name: str
    """For reports."""
    denoiser: Denoiser
    """Predicts noise."""
    codec: LatentCodec
    """Pixels to latents."""
    encoder: PromptEncoder
    """Prompts to embeddings."""
    views: PriorViews
    """Framing that the input renders must have."""
    guidance: Guidance
    """The default."""
    negative_prompt: str = ""
    """The default."""


class LatentPrior:
    """A :class:`gscomplete.priors.base.Prior` on a latent diffusion model."""

    sees_input = False
    presets: ClassVar[dict[str, str]] = {
        "default": "latent",
        "fast": "text only",
        "reconstruct": "text only",
        "distill": "latent",
        "paper": "paper",
    }
    """Which settings of ``completion.presets`` a preset stands for."""

    def __init__(
        self,
        model: LatentModel,
        settings: LatentPriorSettings,
        plan: MemoryPlan,
        device: torch.device,
        identity: PriorIdentity,
    ) -> None:
        """Take a model.

        Args:
            model: its networks are on ``device``.
            settings: knobs.
            plan: what is traded for memory.
            device: where the networks run.
            identity: what decides a run's result.
        """
        self.name, self.views, self.identity = model.name, model.views, identity
        self.num_timesteps = len(model.denoiser.schedule)
        self._denoiser, self._codec, self._encoder = model.denoiser, model.codec, model.encoder
        self._settings, self._plan, self._guidance = settings, plan, model.guidance
        self._negative_prompt, self._device = model.negative_prompt, device

    def default_guidance(self, *, sees_input: bool) -> Guidance:
        """Return the settings' scales, whatever is seen; see :class:`base.Prior`."""
        return self._guidance

    def condition(self, prompt: str, negative_prompt: str | None = None) -> LatentConditioning:
        """Encode a prompt; None as negative prompt = the prior's own, "" = no text."""
        negative = self._negative_prompt if negative_prompt is None else negative_prompt
        context, away = self._encoder.encode([prompt, negative])
        report = self._encoder.report("prompt", prompt)
        if negative_prompt is None and negative:
            report += (f'negative prompt (the default of {self.name}): "{negative[:40]}..."',)
        else:
            report += self._encoder.report("negative prompt", negative)
        return LatentConditioning(context.to(self._device), away.to(self._device), report)

    def distill(
        self,
        views: FourViews,
        timestep: float,
        conditioning: Conditioning,
        generator: torch.Generator,
        input_views: FourViews | None = None,
        guidance: Guidance | None = None,
    ) -> Tensor:  # []
        """Return the distillation loss; see :class:`gscomplete.priors.base.Prior`."""
        background = draw_background(self._settings.background, generator)
        latents = self._encode(views, background, generator)
        at, scales = self._checked(timestep), guidance or self._guidance
        with torch.no_grad():
            noise = _randn_like(latents, generator)
            noisy = self._denoiser.schedule.add_noise(latents.detach(), noise, at)
            guided, conditional = self._predict(noisy, at, conditioning, views.cameras, scales)
            if self._settings.loss == "x0":
                center = self._rescale_center(background, latents, scales)
                target = self._clean(noisy, guided, conditional, at, scales, center)
        if self._settings.loss == "epsilon":
            return epsilon_loss(latents, guided, noise)
        return x0_loss(latents, target)

    @torch.no_grad()
    def reconstruct(
        self,
        views: FourViews,
        timestep: float,
        conditioning: Conditioning,
        generator: torch.Generator,
        input_views: FourViews | None = None,
        guidance: Guidance | None = None,
        num_steps: int = 8,
    ) -> tuple[Tensor, Tensor]:  # [4, h, w, 3] premultiplied, [4, h, w]
        """Return clean targets; see :class:`gscomplete.priors.base.Prior`."""
        background = draw_background(self._settings.background, generator)
        latents = self._encode(views, background, generator)
        schedule, scales = self._denoiser.schedule, guidance or self._guidance
        center = self._rescale_center(background, latents, scales)
        start = self._checked(min(timestep, self.num_timesteps - 1))
        noise = _randn_like(latents, generator)
        pure = timestep >= self.num_timesteps - 1
        noisy = noise if pure else schedule.add_noise(latents, noise, start)

        def clean_at(x_t: Tensor, now: int) -> Tensor:
            guided, conditional = self._predict(x_t, now, conditioning, views.cameras, scales)
            return self._clean(x_t, guided, conditional, now, scales, center)

        clean = ddim(clean_at, schedule.scales, noisy, schedule.steps(start, num_steps))
        images = (self._codec.decode(clean) * 0.5 + 0.5).clamp(0, 1)
        color, alpha = matte(images)
        return color.to(views.color.device), alpha.to(views.color.device)

    def _encode(self, views: FourViews, background: Tensor, generator: torch.Generator) -> Tensor:
        """Return the latents of the renders over a background, with graph."""
        size = self.views.resolution_px
        color = views.color + (1 - views.alpha)[..., None] * background.to(views.color)
        images = color.permute(0, 3, 1, 2).to(self._device)
        if images.shape[-1] != size:
            images = F.interpolate(images, (size, size), mode="bilinear", align_corners=False)
        small = size // self._codec.downsampling
        shape = (VIEWS, self._codec.latent_channels, small, small)
        noise = torch.randn(shape, generator=generator, device=generator.device)
        sampled = noise if self._settings.sample_posterior else None
        return self._codec.encode(images * 2 - 1, sampled)

    def _predict(
        self,
        noisy: Tensor,  # [4, C, h, w]
        timestep: int,
        conditioning: Conditioning,
        cameras: Cameras,
        scales: Guidance,
    ) -> tuple[Tensor, Tensor]:
        """Return the guided noise and the conditional one."""
        if not isinstance(conditioning, LatentConditioning):
            raise TypeError(f"{self.name}: expected its own conditioning, found {conditioning}")
        texts = [conditioning.context]
        if scales.text_scale != 1.0:
            texts.append(conditioning.negative_context)
        if self._plan.split_guidance:
            outputs = [self._denoiser(noisy, timestep, t[None], cameras) for t in texts]
        else:
            repeated = noisy.repeat(len(texts), 1, 1, 1)
            together = self._denoiser(repeated, timestep, torch.stack(texts), cameras)
            outputs = list(together.chunk(len(texts)))
        if len(outputs) == 1:
            return outputs[0], outputs[0]
        return guided_noise(outputs[0], outputs[1], scales.text_scale), outputs[0]

    def _clean(
        self,
        noisy: Tensor,  # [4, C, h, w]
        guided: Tensor,
        conditional: Tensor,
        timestep: int,
        scales: Guidance,
        center: Tensor | None,  # [1, C, h, w]
    ) -> Tensor:  # [4, C, h, w]
        """Return the guided, rescaled x0."""
        schedule = self._denoiser.schedule
        clean = schedule.clean_of(guided, noisy, timestep)
        if scales.rescale == 0 or guided is conditional:
            return clean
        reference = schedule.clean_of(conditional, noisy, timestep)
        return rescaled(clean, reference, scales.rescale, self._denoiser.group, center)

    @torch.no_grad()
    def _rescale_center(
        self, background: Tensor, latents: Tensor, scales: Guidance
    ) -> Tensor | None:  # [1, C, h, w]
        """Return the latents of the background alone; None where contrast is that about zero."""
        if scales.rescale == 0 or scales.rescale_about == "zero":
            return None
        side = latents.shape[-1] * self._codec.downsampling
        plain = background.to(latents)[None, :, None, None].expand(1, 3, side, side)
        return self._codec.encode(plain * 2 - 1, None)

    def _checked(self, timestep: float) -> int:
        if not 0 <= timestep <= self.num_timesteps - 1:
            raise ValueError(
                f"{self.name}: timestep: expected 0 to {self.num_timesteps - 1}, found {timestep}"
            )
        return round(timestep)


def default_guidance(settings: LatentPriorSettings, scale: float) -> Guidance:
    """Return the guidance that the knobs ask for; ``scale`` is the prior's default."""
    return Guidance(
        text_scale=scale if settings.guidance is None else settings.guidance,
        rescale=0.5 if settings.rescale is None else settings.rescale,
    )


def draw_background(choice: Background, generator: torch.Generator) -> Tensor:  # [3]
    """Draw the background of a step; always uses three random numbers."""
    drawn = torch.rand(3, generator=generator, device=generator.device)
    table: dict[str, Callable[[], Tensor]] = {
        "black_or_white": lambda: (drawn[:1] < 0.5).float().expand(3),
        "random": lambda: drawn,
        "black": lambda: torch.zeros_like(drawn),
        "white": lambda: torch.ones_like(drawn),
    }
    return table[choice]()


def matte(images: Tensor) -> tuple[Tensor, Tensor]:
    """Estimate what covers the background of opaque images.

    The background is the median colour of each image's border (a sixteenth of the side).

    Args:
        images: [V, 3, h, w] in [0, 1].

    Returns:
        Premultiplied colour [V, h, w, 3] with 0 <= colour <= alpha, and alpha [V, h, w].
    """
    side = images.shape[-1]
    width = max(1, side // 16)
    strips = [images[:, :, :width], images[:, :, side - width :]]
    strips += [
        images[:, :, width : side - width, part] for part in (slice(width), slice(-width, None))
    ]
    border = torch.cat([strip.flatten(2) for strip in strips], dim=2)
    background = border.median(dim=2).values[:, :, None, None]
    difference = (images - background).abs().amax(dim=1)
    alpha = ((difference - _MATTE_LOW) / (_MATTE_HIGH - _MATTE_LOW)).clamp(0, 1)
    color = (images - (1 - alpha)[:, None] * background).clamp(min=0)
    return torch.minimum(color, alpha[:, None]).permute(0, 2, 3, 1), alpha


def _randn_like(latents: Tensor, generator: torch.Generator) -> Tensor:
    drawn = torch.randn(latents.shape, generator=generator, device=generator.device)
    return drawn.to(latents)
