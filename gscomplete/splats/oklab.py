"""Oklab (Ottosson 2020): colours whose distances are those that people see.

Conventions
-----------
* sRGB as stored in files, in [0, 1]; of Oklab's (L, a, b), L runs from 0 (black) to 1 (white).
* Arithmetic is float64.
"""

from __future__ import annotations

import torch
from torch import Tensor

from gscomplete.splats.record import Splats
from gscomplete.util.same_bits import fixed_mean, fixed_power

_LMS_FROM_LINEAR = torch.tensor(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ],
    dtype=torch.float64,
)
_LAB_FROM_ROOTS = torch.tensor(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ],
    dtype=torch.float64,
)


def oklab_from_srgb(colors: Tensor) -> Tensor:  # [N, 3] in [0, 1] -> [N, 3], float64
    """Turn sRGB colours into Oklab."""
    srgb = colors.double()
    linear = torch.where(
        srgb <= 0.04045, srgb / 12.92, fixed_power((srgb.clamp_min(0.04045) + 0.055) / 1.055, 2.4)
    )
    lms = linear @ _LMS_FROM_LINEAR.T
    return (lms.sign() * fixed_power(lms.abs(), 1.0 / 3.0)) @ _LAB_FROM_ROOTS.T


def srgb_from_oklab(lab: Tensor) -> Tensor:  # [N, 3] -> [N, 3], float64; may leave [0, 1]
    """Turn Oklab colours into sRGB."""
    roots = lab.double() @ torch.linalg.inv(_LAB_FROM_ROOTS).T
    linear = (roots**3) @ torch.linalg.inv(_LMS_FROM_LINEAR).T
    curved = 1.055 * fixed_power(linear.clamp_min(0.0031308), 1.0 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, curved)


def color_spread(splats: Splats) -> float:
    """Return the mean distance of splats' base colours from their mean; 0 = all of one colour.

    Args:
        splats: at least one.
    """
    lab = oklab_from_srgb(splats.base_colors.detach().cpu().clamp(0.0, 1.0))
    middle = torch.stack([fixed_mean(channel) for channel in lab.unbind(dim=1)])
    return float(fixed_mean((lab - middle).square().sum(dim=1).sqrt()))
