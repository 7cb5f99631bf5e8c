"""Structural similarity of pictures, pixel by pixel (Wang et al. 2004)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

_WINDOW = 11
_SIGMA = 1.5
_C1, _C2 = 0.01**2, 0.03**2


def ssim_map(ours: Tensor, theirs: Tensor) -> Tensor:  # [V, H, W, 3] in [0, 1] -> [V, H, W]
    """Return SSIM at every pixel, the mean of the channels; borders see their own reflection."""
    a, b = (x.double().permute(0, 3, 1, 2) for x in (ours, theirs))
    offset = torch.arange(_WINDOW, dtype=torch.float64, device=a.device) - _WINDOW // 2
    line = torch.exp(-0.5 * (offset / _SIGMA) ** 2)
    line = line / line.sum()

    def blur(x: Tensor) -> Tensor:
        half, channels = _WINDOW // 2, x.shape[1]
        x = F.pad(x, (half, half, half, half), mode="reflect")
        x = F.conv2d(x, line.view(1, 1, 1, -1).repeat(channels, 1, 1, 1), groups=channels)
        return F.conv2d(x, line.view(1, 1, -1, 1).repeat(channels, 1, 1, 1), groups=channels)

    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2
    both = blur(a * b) - mean_a * mean_b
    top = (2 * mean_a * mean_b + _C1) * (2 * both + _C2)
    return (top / ((mean_a**2 + mean_b**2 + _C1) * (var_a + var_b + _C2))).mean(dim=1)
