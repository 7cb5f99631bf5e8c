"""HaarPSI: how alike two pictures look, from Haar wavelets (Reisenhofer et al. 2018).

Conventions
-----------
* Pictures are [V, H, W, 3] in [0, 1]. A score of 1 means identical; pictures that people find
  similar score above about 0.6.
* Constants, colour space and subsampling are the paper's (c = 30 and alpha = 4.2 for values to
  255, YIQ, means of 2 x 2 pixels). No weights are needed, unlike for LPIPS.
* The score is a mean over pixels, weighted by their structure. As an extension of the paper, a mask
  multiplies these weights, so that pixels outside it do not count; a mask of ones gives the paper's
  score.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from gscomplete.util.same_bits import fixed_sigmoid

_C = 30.0
_ALPHA = 4.2
_YIQ = ((0.299, 0.587, 0.114), (0.5959, -0.2746, -0.3213), (0.2115, -0.5227, 0.3112))
_SCALES = 3
"""The two finest scales are compared; the coarsest gives the weights."""


def haarpsi(ours: Tensor, theirs: Tensor, mask: Tensor | None = None) -> Tensor:  # [V]
    """Return the similarity of every pair of pictures.

    Args:
        ours: pictures [V, H, W, 3] in [0, 1].
        theirs: pictures to compare with, of the same shape.
        mask: weights [V, H, W]; None = all ones.

    Returns:
        Similarities [V] in (0, 1]; 1 where the mask is empty or neither picture has structure.
    """
    a, b = _prepared(ours), _prepared(theirs)  # [V, 3, H/2, W/2]
    coarse_a, fine_a = _haar(a[:, :1])
    coarse_b, fine_b = _haar(b[:, :1])
    weights = torch.maximum(coarse_a.abs(), coarse_b.abs())  # [V, 2, h, w]
    local = _similarity(fine_a.abs(), fine_b.abs()).mean(dim=2)  # [V, 2, h, w]
    chroma = _similarity(_smoothed(a[:, 1:]), _smoothed(b[:, 1:])).mean(dim=1, keepdim=True)
    local = torch.cat([local, chroma], dim=1)
    weights = torch.cat([weights, weights.mean(dim=1, keepdim=True)], dim=1)
    if mask is not None:
        weights = weights * _halved(mask.double()[:, None])
    total = weights.sum(dim=(1, 2, 3))
    mean = (fixed_sigmoid(_ALPHA * local) * weights).sum(dim=(1, 2, 3)) / total.clamp_min(1e-12)
    score = (torch.logit(mean.clamp(0.5, 1 - 1e-12)) / _ALPHA) ** 2
    return torch.where(total > 1e-9, score, torch.ones_like(score))


def _prepared(pictures: Tensor) -> Tensor:  # [V, H, W, 3] -> [V, 3, H/2, W/2]
    """Return YIQ values to 255 at half the resolution."""
    matrix = 255.0 * torch.tensor(_YIQ, dtype=torch.float64, device=pictures.device)
    small = _halved(pictures.permute(0, 3, 1, 2).double())
    return (small.permute(0, 2, 3, 1) @ matrix.T).permute(0, 3, 1, 2)


def _halved(images: Tensor) -> Tensor:  # [V, C, H, W] -> [V, C, H/2, W/2]
    """Return the means of 2 x 2 pixels; of odd sides the last row counts as repeated zeros."""
    height, width = images.shape[2:]
    return F.avg_pool2d(F.pad(images, (0, width % 2, 0, height % 2)), 2)


def _haar(luma: Tensor) -> tuple[Tensor, Tensor]:  # [V, 1, h, w] -> [V, 2, h, w], [V, 2, 2, h, w]
    """Return Haar coefficients by direction: the coarsest, and the finer ones (axis 2).

    A coefficient is the difference between the sums of two halves of a window, divided by its side.
    Sums over windows of 4 x 4 pixels are computed from those over 2 x 2, and so on, in a fraction
    of the time of convolutions.
    """
    found = []
    largest = 2**_SCALES
    before, after = largest // 2 - 1, largest // 2
    sums = F.pad(luma, (before, after, before, after))
    height, width = luma.shape[2:]
    for scale in range(1, _SCALES + 1):
        side, half = 2**scale, 2 ** (scale - 1)
        # From here on ``sums`` is of windows whose first pixel is at the index.
        beside, below = _pairs(sums, half, -1), _pairs(sums, half, -2)
        falling = beside[..., half:, :] - beside[..., :-half, :]
        rightward = below[..., half:] - below[..., :-half]
        first = largest // 2 - half
        window = (..., slice(first, first + height), slice(first, first + width))
        found.append(torch.cat([falling[window], rightward[window]], dim=1) / side)
        sums = _pairs(beside, half, -2)
    return found[-1], torch.stack(found[:-1], dim=2)


def _pairs(sums: Tensor, apart: int, axis: int) -> Tensor:
    """Return the sums of what lies ``apart`` along an axis."""
    length = sums.shape[axis] - apart
    return sums.narrow(axis, 0, length) + sums.narrow(axis, apart, length)


def _smoothed(images: Tensor) -> Tensor:
    """Return absolute means of 2 x 2 neighbours, at every pixel."""
    return F.avg_pool2d(F.pad(images, (0, 1, 0, 1)), 2, stride=1).abs()


def _similarity(a: Tensor, b: Tensor) -> Tensor:
    """Return 2ab / (a^2 + b^2), with C against noise."""
    return (2 * a * b + _C) / (a * a + b * b + _C)
