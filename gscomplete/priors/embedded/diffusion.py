"""Noise schedule, conversions between x0, noise and v, and guidance.

Conventions
-----------
* ``x_t = alpha_t x0 + sigma_t eps`` with ``alpha = cos(pi/2 u)``, ``sigma = sin(pi/2 u)`` and
  ``u = (t + 1) / 1000``: t = 999 is pure noise exactly, t = -1 would be clean exactly. Fractional
  timesteps are the same formula.
* ``v = alpha_t eps - sigma_t x0``, hence ``x0 = alpha_t x_t - sigma_t v`` and
  ``eps = sigma_t x_t + alpha_t v``: no division, so pure noise needs no special case.
* Timesteps are scalars or tensors that broadcast from the left: [B] against [B, ...].
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

NUM_TIMESTEPS = 1000
SNR_CAP = 5.0
TRANSPARENT = -1.0
"""Every channel of an image where nothing is: premultiplied RGBA in [-1, 1]."""


def alpha_sigma(timestep: Tensor) -> tuple[Tensor, Tensor]:
    """Return signal and noise scales at timesteps of any shape."""
    angle = (timestep + 1) * (math.pi / 2 / NUM_TIMESTEPS)
    return torch.cos(angle).clamp(min=0), torch.sin(angle)


def add_noise(x0: Tensor, noise: Tensor, timestep: Tensor) -> Tensor:
    """Return x_t."""
    alpha, sigma = _scales(timestep, x0)
    return alpha * x0 + sigma * noise


def velocity(x0: Tensor, noise: Tensor, timestep: Tensor) -> Tensor:
    """Return v, what the network is trained to predict."""
    alpha, sigma = _scales(timestep, x0)
    return alpha * noise - sigma * x0


def x0_from_v(x_t: Tensor, v: Tensor, timestep: Tensor) -> Tensor:
    """Return the clean image that v implies."""
    alpha, sigma = _scales(timestep, x_t)
    return alpha * x_t - sigma * v


def loss_weight(timestep: Tensor) -> Tensor:
    """Weight of the squared error of v in training.

    The squared error of v is 1/sigma^2 = (SNR + 1) times that of x0. The weight
    ``min(1, SNR_CAP / (SNR + 1))`` leaves it so where the image is mostly noise and holds the
    weight on x0 at SNR_CAP where it is mostly signal, where small errors of x0 matter little
    (a min-SNR weighting).
    """
    _, sigma = alpha_sigma(timestep)
    return (SNR_CAP * sigma**2).clamp(max=1.0)


def guided_x0(
    denoise: Callable[[list[tuple[bool, bool]]], list[Tensor]],
    *,
    has_input: bool,
    has_text: bool,
    input_scale: float,
    text_scale: float,
    rescale: float = 0.0,
) -> Tensor:
    """Combine denoised images under different conditions into one.

    ``x(-,-) + input_scale (x(P,-) - x(-,-)) + text_scale (x(P,y) - x(P,-))``; without P the middle
    term is zero and the last is ``x(-,y) - x(-,-)``. Passes whose factor is zero are not run.

    Args:
        denoise: given a list of (with input, with text), returns x0 for each, in one batch.
        has_input: whether renders of P are there to be seen.
        has_text: whether there is a prompt (or anything that differs from "no text").
        input_scale: pull towards P.
        text_scale: pull towards the prompt.
        rescale: fraction (0 to 1) by which the standard deviation of the result is brought back
            to that of the fully conditional image (Lin et al. 2023), per ring. Contrast is the
            distance from ``TRANSPARENT``: about zero, what is empty would turn to fog.
    """
    factors: dict[tuple[bool, bool], float] = {}
    top = text_scale if has_text else 0.0
    for key, factor in (
        ((False, False), 1.0 - (input_scale if has_input else 0.0)),
        ((has_input, False), (input_scale if has_input else 0.0) - top),
        ((has_input, has_text), top),
    ):
        factors[key] = factors.get(key, 0.0) + factor
    passes = [key for key, factor in factors.items() if factor != 0.0]
    full = (has_input, has_text)
    if rescale > 0 and passes != [full] and full not in passes:
        passes.append(full)
    images = dict(zip(passes, denoise(passes), strict=True))
    result = sum(
        (factors[key] * image for key, image in images.items() if factors[key] != 0.0),
        start=torch.zeros_like(images[passes[0]]),
    )
    if rescale > 0 and passes != [full]:
        dims = tuple(range(1, result.ndim))
        ratio = images[full].std(dim=dims, keepdim=True) / result.std(dim=dims, keepdim=True).clamp(
            min=1e-6
        )
        result = TRANSPARENT + (result - TRANSPARENT) * (1 - rescale + rescale * ratio)
    return result


def scales_like(x_t: Tensor) -> Callable[[float], tuple[Tensor, Tensor]]:
    """Return the schedule for ``ddim``: signal and noise scales at a timestep, on x_t's device."""
    return lambda timestep: _scales(x_t.new_tensor(timestep), x_t)


def _scales(timestep: Tensor, like: Tensor) -> tuple[Tensor, Tensor]:
    alpha, sigma = alpha_sigma(timestep)
    shape = alpha.shape + (1,) * (like.ndim - alpha.ndim)
    return alpha.reshape(shape).to(like.dtype), sigma.reshape(shape).to(like.dtype)
