"""What a render returns."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

Background = Tensor | Sequence[float]
"""A colour [3], or colours that spread to [V, H, W, 3]."""


@dataclass(frozen=True, slots=True)
class Render:
    """Images of V views of H x W pixels, differentiable with respect to the splats."""

    color: Tensor  # [V, H, W, 3] over the background that was asked for
    alpha: Tensor  # [V, H, W] accumulated opacity in [0, 1]
    depth: Tensor  # [V, H, W] expected camera-space z of what is seen, 0 where alpha is 0

    def __getitem__(self, views: slice) -> Render:
        """Return the chosen views; nothing is copied."""
        return Render(self.color[views], self.alpha[views], self.depth[views])

    @property
    def nbytes(self) -> int:
        """Memory that the images take, in bytes."""
        return self.color.nbytes + self.alpha.nbytes + self.depth.nbytes

    def over(self, background: Background | None) -> Render:  # None = black
        """Put what is drawn over black over a background."""
        if background is None:
            return self
        behind = torch.as_tensor(background, dtype=self.color.dtype, device=self.color.device)
        color = self.color + (1.0 - self.alpha)[..., None] * behind
        return dataclasses.replace(self, color=color)


def join_renders(parts: Sequence[Render]) -> Render:
    """Join the views of renders of one image size, in order; copies them."""
    return Render(
        torch.cat([part.color for part in parts]),
        torch.cat([part.alpha for part in parts]),
        torch.cat([part.depth for part in parts]),
    )


def render_from_sums(
    sums: Tensor,  # [V, H, W, 5] red, green, blue, sum of w * depth, alpha
) -> Render:
    """Return a render over black: its depth is the expected one."""
    summed_depth, alpha = sums[..., 3], sums[..., 4]
    depth = torch.where(alpha > 0, summed_depth / alpha.clamp_min(1e-8), 0.0)
    return Render(sums[..., :3], alpha, depth)
