"""Deterministic denoising in few steps (DDIM, Song et al. 2021), whatever the noise schedule."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TypeVar

from torch import Tensor

Time = TypeVar("Time", int, float)
Scale = TypeVar("Scale", float, Tensor)


def ddim(
    clean_at: Callable[[Tensor, Time], Tensor],
    scales: Callable[[Time], tuple[Scale, Scale]],
    noisy: Tensor,
    times: Sequence[Time],
) -> Tensor:
    """Denoise from the first of several timesteps to a clean image.

    Every image between two calls of the denoiser is the last clean image with the noise that the
    last noisy image had, at the scales of the next timestep.

    Args:
        clean_at: denoiser, (x_t, timestep) to x0.
        scales: scales of image and noise in x_t at a timestep.
        noisy: x_t at the first timestep.
        times: timesteps of the calls of the denoiser, in falling order.

    Returns:
        The last x0.
    """
    clean = clean_at(noisy, times[0])
    for now, then in pairwise(times):
        signal, sigma = scales(now)
        noise = (noisy - signal * clean) / sigma
        signal, sigma = scales(then)
        noisy = signal * clean + sigma * noise
        clean = clean_at(noisy, then)
    return clean


def even_times(start: float, num_steps: int) -> list[float]:
    """Return timesteps that fall from ``start`` evenly towards 0, which is not among them.

    Raises:
        ValueError: ``num_steps`` is below 1.
    """
    if num_steps < 1:
        raise ValueError(f"num_steps: expected at least 1, found {num_steps}")
    return [start * (1 - k / num_steps) for k in range(num_steps)]
