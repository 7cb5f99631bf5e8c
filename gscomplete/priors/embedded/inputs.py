"""Renders to network images and back: the one place that fixes what the network sees.

Conventions
-----------
* Images are premultiplied RGBA, channels first, mapped from [0, 1] to [-1, 1].
* The input map is what the cameras see of P: premultiplied RGB and alpha in [0, 1], and relief,
  ``alpha * clamp(radius - depth, -1, 1)``: how far the surface stands out of the plane through
  the ring's target, in object frame units. Withheld P is all zeros, like P out of sight.
* The shape map is what the cameras see of a known shape without colours: alpha and relief. No shape
  is all zeros.
* Larger renders are averaged over areas (antialiased), smaller ones interpolated.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def resize_images(images: Tensor, size_px: int) -> Tensor:  # [V, C, H, W] -> [V, C, s, s]
    """Resize differentiably, by area averages when shrinking."""
    height = images.shape[-1]
    if height == size_px:
        return images
    if height > size_px:
        return F.adaptive_avg_pool2d(images, size_px)
    return F.interpolate(images, size=(size_px, size_px), mode="bilinear", align_corners=False)


def network_images(
    color: Tensor,  # [V, H, W, 3] premultiplied
    alpha: Tensor,  # [V, H, W]
    size_px: int,
) -> Tensor:  # [V, 4, size, size] in [-1, 1]
    """Turn renders into images for the network, with graph."""
    stacked = torch.cat([color.permute(0, 3, 1, 2), alpha[:, None]], dim=1)
    return resize_images(stacked, size_px) * 2 - 1


def input_map(
    color: Tensor,  # [V, H, W, 3] premultiplied
    alpha: Tensor,  # [V, H, W]
    depth: Tensor,  # [V, H, W] camera-space z
    radius: float,
    size_px: int,
) -> Tensor:  # [V, 5, size, size]
    """Turn renders of P into the network's input map: colours, and what a shape map holds."""
    colors = resize_images(color.permute(0, 3, 1, 2), size_px)
    return torch.cat([colors, shape_map(alpha, depth, radius, size_px)], dim=1)


def shape_map(
    alpha: Tensor,  # [V, H, W]
    depth: Tensor,  # [V, H, W] camera-space z
    radius: float,
    size_px: int,
) -> Tensor:  # [V, 2, size, size]
    """Turn renders of a known shape into the network's shape map."""
    relief = alpha * (radius - depth).clamp(-1, 1)
    return resize_images(torch.stack([alpha, relief], dim=1), size_px)


def images_to_color_alpha(images: Tensor) -> tuple[Tensor, Tensor]:
    """Turn network images into valid renders.

    Args:
        images: [V, 4, h, w], about [-1, 1].

    Returns:
        Premultiplied colour [V, h, w, 3] with 0 <= colour <= alpha, and alpha [V, h, w] <= 1.
    """
    unit = (images * 0.5 + 0.5).clamp(0, 1)
    alpha = unit[:, 3]
    color = torch.minimum(unit[:, :3], alpha[:, None]).permute(0, 2, 3, 1)
    return color, alpha
