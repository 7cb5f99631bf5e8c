"""Open cylinders of splats, whole and halved: shapes whose outside is known."""

import numpy as np
import torch

from gscomplete.splats import Splats, colors_to_sh


def cylinder(count: int = 3000, is_flat: bool = True) -> Splats:
    """An upright open cylinder of radius 0.5 and height 1, its discs facing outwards."""
    generator = torch.Generator().manual_seed(0)
    angle = 2 * torch.pi * torch.rand(count, generator=generator)
    height = torch.rand(count, generator=generator) - 0.5
    means = torch.stack([0.5 * torch.cos(angle), 0.5 * torch.sin(angle), height], dim=1)
    half = (angle + torch.pi / 2) / 2  # turns the disc's y axis outwards, about z
    zero = torch.zeros(count)
    quaternions = torch.stack([torch.cos(half), zero, zero, torch.sin(half)], dim=1)
    thin = 0.002 if is_flat else 0.02
    scales = torch.tensor([0.02, thin, 0.02]).expand(count, 3).clone()
    return Splats(
        means, quaternions, scales, torch.full((count,), 0.95), colors_to_sh(0.5 * means.abs())
    )


def half_cylinder(keep_azimuth_deg: float, is_flat: bool = True) -> Splats:
    whole = cylinder(is_flat=is_flat)
    azimuth = np.deg2rad(keep_azimuth_deg)
    side = whole.means @ torch.tensor([np.cos(azimuth), np.sin(azimuth), 0.0]).float()
    return whole.select(side > 0)


def angle_between(a_deg: float, b_deg: float) -> float:
    return abs((a_deg - b_deg + 180) % 360 - 180)
