"""The new splats at the first step (paper section 3.3, "Initialization")."""

from __future__ import annotations

import torch

from gscomplete.fitting.randomness import generator_for, sphere_points
from gscomplete.splats import Splats, colors_to_sh

INITIAL_OPACITY = 0.1
"""As in the original 3DGS."""


def initial_splats(
    partial: Splats,
    count: int,
    diameter: float,
    seed: int,
    *,
    min_scale: float,
    max_scale: float,
) -> Splats:
    """Scatter new splats uniformly in the sphere about the object-frame origin.

    That is the centre of the whole as it was guessed or given; the paper's sphere is about the
    centre of P's box, from which what is missing may lie far off.

    Their scale is the mean spacing of ``count`` points in the sphere, their colour that of a random
    splat of P with noise, so that the start is neither dust nor a foreign colour.

    Args:
        partial: P in the object frame; only its colours are used.
        count: number of new splats.
        diameter: of the sphere; the paper takes the largest side of P's box.
        seed: of the run.
        min_scale: lower bound of the scales.
        max_scale: upper bound of the scales.
    """
    generator = generator_for(seed, 0, "initial splats")
    means = torch.from_numpy(sphere_points(count, generator)).float() * (0.5 * diameter)
    spacing = diameter * (torch.pi / 6 / count) ** (1 / 3)
    scale = min(max(0.5 * spacing, min_scale), max_scale)
    pick = torch.randint(len(partial), (count,), generator=generator)
    colors = partial.base_colors[pick].clamp(0.0, 1.0)
    colors = (colors + 0.1 * torch.randn(count, 3, generator=generator)).clamp(0.02, 0.98)
    quaternions = torch.randn(count, 4, generator=generator)
    quaternions /= quaternions.norm(dim=1, keepdim=True)
    return Splats(
        means,
        quaternions,
        torch.full((count, 3), scale),
        torch.full((count,), INITIAL_OPACITY),
        colors_to_sh(colors),
    )
