"""What a render returns."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Render:
    """Images of V views of H x W pixels, differentiable with respect to the splats."""

    color: Tensor  # [V, H, W, 3] over the background that was asked for
    alpha: Tensor  # [V, H, W] accumulated opacity in [0, 1]
    depth: Tensor  # [V, H, W] expected camera-space z of what is seen, 0 where alpha is 0


def render_from_sums(
    sums: Tensor,  # [V, H, W, 5] red, green, blue, sum of w * depth, alpha
    background: Tensor | None,  # [3] or broadcastable to [V, H, W, 3]; None = black
) -> Render:
    """Put what a backend drew over a background, and make its depth the expected one."""
    color, summed_depth, alpha = sums[..., :3], sums[..., 3], sums[..., 4]
    if background is not None:
        color = color + (1.0 - alpha)[..., None] * background.to(color)
    depth = torch.where(alpha > 0, summed_depth / alpha.clamp_min(1e-8), 0.0)
    return Render(color, alpha, depth)
