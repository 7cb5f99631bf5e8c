"""Priors of known strength: their denoised images are renders of objects that are known.

Conventions
-----------
* Everything is in the object frame. The framing (field of view, extent, elevations) and the noise
  schedule are MVDream's, so that conclusions from these priors apply to it.
* A prior answers with the posterior mean of a finite set of complete objects: with
  x_t = a x + s n, the weight of object k is softmax(-``SHARPNESS`` mean|x_t - a x_k|^2 / 2 s^2). It
  follows the nearest object where noise is low and averages all of them where it is high.
* Images are premultiplied RGBA in [-1, 1], or RGB over black or white for priors that see no alpha.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from gscomplete.priors.base import Conditioning, FourViews, Guidance
from gscomplete.priors.ddim import ddim
from gscomplete.priors.latent.guidance import NoiseSchedule, rescaled, x0_loss
from gscomplete.priors.latent.prior import draw_background, matte
from gscomplete.priors.mvdream.prior import MVDREAM_VIEWS
from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.views import Cameras

Kind = Literal["exact", "blurred", "plausible", "biased", "mvdream-like"]

SHARPNESS = 200.0
"""Independent numbers that an image of an object amounts to."""


@dataclass(frozen=True, slots=True)
class Strength:
    """How a prior's images differ from renders of the truth."""

    blur_px: float = 0.0
    """Standard deviation of the blur at the last timestep, pixels of 64 to the image's side;
    proportional to t below it."""
    noise: float = 0.0
    """Standard deviation of what is added at the last timestep, images in [-1, 1]."""
    sees_alpha: bool = True
    """False: colours over black or white alone."""
    latent_px: int | None = None
    """Images are averaged to this side before they are compared; None = as rendered."""
    overshoot: float = 0.0
    """Guidance: the image is led away from its blurred self by so much."""
    rescale: float = 0.0
    """Default of ``Guidance.rescale``: pull the contrast back to that before the overshoot."""


STRENGTHS: dict[Kind, Strength] = {
    "exact": Strength(),
    "blurred": Strength(blur_px=4.0, noise=0.2),
    "plausible": Strength(),
    "biased": Strength(blur_px=2.0, latent_px=32),
    "mvdream-like": Strength(
        blur_px=2.0, noise=0.1, sees_alpha=False, latent_px=32, overshoot=1.0, rescale=0.5
    ),
}
"""What is special about ``plausible`` and ``biased`` are their objects (``known_priors.objects``).
Latents of 32 x 32 decide how heavy the preservation loss is beside the prior's: as in the paper."""


@dataclass(frozen=True, slots=True)
class NoText:
    """The conditioning of a prior that ignores its prompt, since its objects are known."""

    report: tuple[str, ...] = ()


class KnownPrior:
    """A :class:`gscomplete.priors.base.Prior` whose objects are given."""

    sees_input = False
    num_timesteps = 1000

    def __init__(self, kind: Kind, objects: tuple[Splats, ...], resolution_px: int) -> None:
        """Take the complete objects.

        Args:
            kind: for reports, and which of ``STRENGTHS``.
            objects: complete objects in the object frame, all as likely.
            resolution_px: side of the images.
        """
        self.name, self.calls = f"known {kind}", 0
        self.views = dataclasses.replace(MVDREAM_VIEWS, resolution_px=resolution_px)
        self._strength, self._objects = STRENGTHS[kind], objects
        self._schedule = NoiseSchedule.stable_diffusion()

    def default_guidance(self, *, sees_input: bool) -> Guidance:
        """Return the strength's rescale; other scales change nothing."""
        return Guidance(rescale=self._strength.rescale)

    def condition(self, prompt: str, negative_prompt: str | None = None) -> NoText:
        """Leave the prompt out."""
        return NoText()

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
        background = draw_background("black_or_white", generator)
        images = self._images(views.color, views.alpha, background)
        with torch.no_grad():
            at = round(timestep)
            noise = torch.randn(images.shape, generator=generator)
            noisy = self._schedule.add_noise(images.detach(), noise, at)
            scales = guidance or self.default_guidance(sees_input=False)
            target = self._denoised(noisy, at, views.cameras, background, scales, generator)
        return x0_loss(images, target)

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
        background = draw_background("black_or_white", generator)
        images = self._images(views.color, views.alpha, background)
        scales = guidance or self.default_guidance(sees_input=False)
        start = round(min(timestep, self.num_timesteps - 1))
        noise = torch.randn(images.shape, generator=generator)
        noisy = self._schedule.add_noise(images, noise, start)

        def clean_at(x_t: Tensor, now: int) -> Tensor:
            return self._denoised(x_t, now, views.cameras, background, scales, generator)

        times = self._schedule.steps(start, num_steps)
        clean = ddim(clean_at, self._schedule.scales, noisy, times)
        unit = (clean * 0.5 + 0.5).clamp(0, 1)
        if not self._strength.sees_alpha:
            return matte(unit)
        alpha = unit[:, 3]
        return torch.minimum(unit[:, :3], alpha[:, None]).permute(0, 2, 3, 1), alpha

    def _images(self, color: Tensor, alpha: Tensor, background: Tensor) -> Tensor:  # [4, C, s, s]
        """Turn renders into what this prior compares, with graph."""
        strength = self._strength
        if strength.sees_alpha:
            images = torch.cat([color, alpha[..., None]], dim=-1)
        else:
            images = color + (1 - alpha)[..., None] * background
        images = images.permute(0, 3, 1, 2)
        side = strength.latent_px or self.views.resolution_px
        if images.shape[-1] != side:
            images = F.adaptive_avg_pool2d(images, side)
        return images * 2 - 1

    def _denoised(
        self,
        noisy: Tensor,  # [4, C, s, s]
        timestep: int,
        cameras: Cameras,
        background: Tensor,  # [3]
        scales: Guidance,
        generator: torch.Generator,
    ) -> Tensor:  # [4, C, s, s]
        """Return the posterior mean of the known objects, weakened as the strength says."""
        self.calls += 1
        strength, share = self._strength, timestep / (self.num_timesteps - 1)
        drawn = [render(splats, cameras) for splats in self._objects]
        known = torch.stack([self._images(r.color, r.alpha, background) for r in drawn])
        a, s = self._schedule.scales(timestep)
        distance = (noisy - a * known).square().mean(dim=(1, 2, 3, 4))
        weights = torch.softmax(-SHARPNESS * distance / (2 * s * s), dim=0)
        mean = (weights[:, None, None, None, None] * known).sum(dim=0)
        scale = mean.shape[-1] / 64
        clean = blurred(mean, strength.blur_px * share * scale)
        if strength.overshoot:
            away = blurred(clean, 4.0 * scale)
            led = clean + strength.overshoot * (clean - away)
            center = None
            if scales.rescale_about == "background":
                empty = torch.zeros_like(drawn[0].color), torch.zeros_like(drawn[0].alpha)
                center = self._images(*empty, background)
            clean = rescaled(led, clean, scales.rescale, 4, center)
        if strength.noise:
            noise = torch.randn(clean.shape, generator=generator)
            clean = clean + strength.noise * share * noise
        return clean


def blurred(images: Tensor, sigma_px: float) -> Tensor:  # [V, C, s, s]
    """Blur by a Gaussian, edges repeated; no blur below a tenth of a pixel."""
    if sigma_px < 0.1:
        return images
    reach = max(1, int(3 * sigma_px + 0.5))
    offset = torch.arange(-reach, reach + 1, dtype=images.dtype)
    kernel = torch.exp(-0.5 * (offset / sigma_px).square())
    kernel = (kernel / kernel.sum()).expand(images.shape[1], 1, -1)
    padded = F.pad(images, (reach,) * 4, mode="replicate")
    across = F.conv2d(padded, kernel[:, :, None, :], groups=images.shape[1])
    return F.conv2d(across, kernel[:, :, :, None], groups=images.shape[1])
