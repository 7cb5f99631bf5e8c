"""What a render returns."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True, slots=True)
class Render:
    """Images of V views of H x W pixels, differentiable with respect to the splats."""

    color: Tensor  # [V, H, W, 3] over the background that was asked for
    alpha: Tensor  # [V, H, W] accumulated opacity in [0, 1]
    depth: Tensor  # [V, H, W] expected camera-space z of what is seen, 0 where alpha is 0
