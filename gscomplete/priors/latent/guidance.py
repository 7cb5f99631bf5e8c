"""Noise schedule, classifier-free guidance, rescaling and the two distillation losses.

Conventions
-----------
* ``x_t = a x + s n`` with ``a = sqrt(alpha_bar)``, ``s = sqrt(1 - alpha_bar)``; timesteps are
  integers 0 (almost clean) to 999.
* Stable Diffusion's schedule is linear in sqrt(beta) ("scaled_linear"; its code says "linear").
* e is predicted noise; guided: ``e = e_u + g (e_c - e_u)``. A group is the images that a model
  denoises together: four views for MVDream, one image for single-view models.
* Losses are sums over latents divided by the number of images, in float32.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from gscomplete.priors.ddim import even_times

Prediction = Literal["epsilon", "v_prediction"]


@dataclass(frozen=True, slots=True)
class NoiseSchedule:
    """How much of the image is left at every timestep."""

    alphas_bar: tuple[float, ...]
    prediction: Prediction = "epsilon"
    """What the network's output means."""

    @classmethod
    def stable_diffusion(cls, prediction: Prediction = "epsilon") -> NoiseSchedule:
        """Return the schedule that Stable Diffusion and MVDream were trained with."""
        betas = torch.linspace(0.00085**0.5, 0.012**0.5, 1000, dtype=torch.float64) ** 2
        return cls(tuple(torch.cumprod(1 - betas, 0).tolist()), prediction)

    def __len__(self) -> int:
        """Return the number of timesteps."""
        return len(self.alphas_bar)

    def scales(self, timestep: int) -> tuple[float, float]:
        """Return a and s."""
        alpha_bar = self.alphas_bar[timestep]
        return alpha_bar**0.5, (1 - alpha_bar) ** 0.5

    def steps(self, start: int, num_steps: int) -> list[int]:
        """Return timesteps that fall from ``start`` about evenly, for ``ddim``.

        Raises:
            ValueError: ``num_steps`` is below 1.
        """
        return [round(timestep) for timestep in even_times(start, num_steps)]

    def add_noise(self, clean: Tensor, noise: Tensor, timestep: int) -> Tensor:
        """Return x_t."""
        a, s = self.scales(timestep)
        return a * clean + s * noise

    def noise_of(self, output: Tensor, noisy: Tensor, timestep: int) -> Tensor:
        """Return the noise that the network's output means."""
        if self.prediction == "epsilon":
            return output
        a, s = self.scales(timestep)
        return a * output + s * noisy

    def clean_of(self, noise: Tensor, noisy: Tensor, timestep: int) -> Tensor:
        """Return x0, the clean latents that predicted noise implies."""
        a, s = self.scales(timestep)
        return (noisy - s * noise) / a


def guided_noise(conditional: Tensor, unconditional: Tensor, scale: float) -> Tensor:
    """Return e = e_u + g (e_c - e_u)."""
    return unconditional + scale * (conditional - unconditional)


def rescaled(
    guided: Tensor,
    conditional: Tensor,
    rescale: float,
    group: int,
    center: Tensor | None = None,
) -> Tensor:
    """Pull the contrast of guided latents back to the conditional ones' (Lin et al. 2023).

    Args:
        guided: [B, ...] x0 of the guided noise.
        conditional: [B, ...] x0 of the conditional noise.
        rescale: fraction f; 0 = leave as is.
        group: images whose standard deviation is taken together (unbiased, over all views,
            channels and pixels).
        center: [..., C, h, w] what contrast is the distance from; None = zero, as published.
    """
    if rescale == 0:
        return guided
    if center is not None:
        away = rescaled(guided - center, conditional - center, rescale, group)
        return center + away
    flat = guided.reshape(-1, group * guided[0].numel())
    ratio = (conditional.reshape_as(flat).std(dim=1, keepdim=True) + 1e-8) / (
        flat.std(dim=1, keepdim=True) + 1e-8
    )
    return (rescale * ratio * flat + (1 - rescale) * flat).reshape_as(guided)


def x0_loss(latents: Tensor, target: Tensor) -> Tensor:  # []
    """Half the squared distance to the denoised latents, per image (paper, Equation 2).

    With neither rescaling its gradient is (s/a) (e - n) / B.
    """
    return 0.5 * (latents.float() - target.detach()).square().sum() / latents.shape[0]


def epsilon_loss(latents: Tensor, predicted: Tensor, noise: Tensor) -> Tensor:  # []
    """Score distillation (Poole et al. 2022) without a weight of t: gradient (e - n) / B."""
    target = latents.detach().float() - (predicted - noise)
    return 0.5 * (latents.float() - target).square().sum() / latents.shape[0]
