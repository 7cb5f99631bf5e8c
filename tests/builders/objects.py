"""The objects that tests are about: splats with known places, sizes and colours.

Conventions
-----------
* Object frame: z up, lengths in units of the frame. ``half`` cuts, ``moved`` moves.
* All but ``round_splats`` are drawn with a fixed seed: the same splats in every test.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import torch

from gscomplete.splats import Splats, colors_to_sh, concatenate
from gscomplete.splats.rotations import quaternions_facing
from gscomplete.views import up_rotation
from gscomplete.views.distribution import RADIUS
from gscomplete.views.frame import UpAxis
from splatcomplete_data.mesh.discs import discs_at

GREY, RED, GREEN = (0.5, 0.5, 0.5), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
PITCH = 0.008
"""Between neighbouring samples of ``leaning_board`` where it faces the camera, object sizes."""


def round_splats(
    means: torch.Tensor | Sequence[Sequence[float]],  # [N, 3]
    *,
    scale: float = 0.03,
    opacity: float = 0.9,
    color: torch.Tensor | Sequence[float] = GREY,  # [3] or [N, 3]
) -> Splats:
    """Return splats without direction at the given places."""
    places = torch.as_tensor(means, dtype=torch.float32)
    count = len(places)
    return Splats(
        places,
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
        torch.full((count, 3), scale),
        torch.full((count,), opacity),
        colors_to_sh(torch.as_tensor(color).expand(count, 3)),
    )


def random_splats(count: int, degree: int = 0, seed: int = 0, scale: float = 0.05) -> Splats:
    """Return splats of any place, turn, size, opacity and colour."""
    g = torch.Generator().manual_seed(seed)
    return Splats(
        0.6 * torch.randn(count, 3, generator=g),
        torch.nn.functional.normalize(torch.randn(count, 4, generator=g), dim=1),
        scale * torch.exp(0.7 * torch.randn(count, 3, generator=g)),
        0.02 + 0.97 * torch.rand(count, generator=g),
        0.6 * torch.randn(count, (degree + 1) ** 2, 3, generator=g),
    )


def ball(
    count: int = 6000, radius: float = 0.4, center: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Splats:
    """Return discs on a sphere whose colour is their outward normal."""
    points = np.random.default_rng(1).normal(size=(count, 3))
    normals = torch.from_numpy(points / np.linalg.norm(points, axis=1, keepdims=True)).float()
    spacing = radius * (4 * np.pi / max(count, 1)) ** 0.5
    scales = torch.full((count, 3), 0.7 * spacing)
    scales[:, 2] *= 0.1
    return Splats(
        radius * normals + torch.tensor(center),
        quaternions_facing(normals),
        scales,
        torch.full((count,), 0.95),
        colors_to_sh(0.5 + 0.4 * normals),
    )


def even_ball(count: int = 4000, radius: float = 0.5) -> Splats:
    """Return the discs of a ball as evenly as they can lie (Fibonacci points): without holes."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle, ring = np.pi * (1 + 5**0.5) * k, np.sqrt(1 - z * z)
    normals = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1).astype(np.float32)
    spacing = (4 * np.pi * radius**2 / count) ** 0.5
    return discs_at(normals * np.float32(radius), normals, np.abs(normals), spacing)


BALL = ball(4000, 0.5)
"""Fills the object frame."""


def half(splats: Splats, axis: int = 0) -> Splats:
    """Return what lies beyond the middle along an axis."""
    return splats.select(splats.means[:, axis] > 0)


def halves(splats: Splats) -> tuple[Splats, Splats]:
    """Return what lies beyond the middle along x, and the rest."""
    front = splats.means[:, 0] > 0
    return splats.select(front), splats.select(~front)


def moved(splats: Splats, shift: tuple[float, float, float]) -> Splats:
    """Return the splats elsewhere."""
    return dataclasses.replace(splats, means=splats.means + torch.tensor(shift))


def box(up: UpAxis, count: int = 4000) -> Splats:
    """Return splats in a box of 4 x 2 x 1 (z up) far from the origin, in the axes of ``up``."""
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(count, 3, generator=generator) * torch.tensor([4.0, 2.0, 1.0])
    return round_splats(points @ up_rotation(up).float() + 50.0, scale=0.05, opacity=1.0)


def cylinder(count: int = 3000, is_flat: bool = True) -> Splats:
    """An upright open cylinder of radius 0.5 and height 1, its discs facing outwards."""
    generator = torch.Generator().manual_seed(0)
    angle = 2 * torch.pi * torch.rand(count, generator=generator)
    height = torch.rand(count, generator=generator) - 0.5
    means = torch.stack([0.5 * torch.cos(angle), 0.5 * torch.sin(angle), height], dim=1)
    half_angle = (angle + torch.pi / 2) / 2  # turns the disc's y axis outwards, about z
    zero = torch.zeros(count)
    turns = torch.stack([torch.cos(half_angle), zero, zero, torch.sin(half_angle)], dim=1)
    thin = 0.002 if is_flat else 0.02
    scales = torch.tensor([0.02, thin, 0.02]).expand(count, 3).clone()
    return Splats(means, turns, scales, torch.full((count,), 0.95), colors_to_sh(0.5 * means.abs()))


def pipe(count: int = 8000, wall: float = 0.03) -> Splats:
    """An upright cylinder of radius 0.5 and height 1 whose wall has an inner side, too."""
    outer = cylinder(count)
    inside = 1 - 2 * wall
    inner = dataclasses.replace(outer, means=outer.means * torch.tensor([inside, inside, 1.0]))
    generator = torch.Generator().manual_seed(1)
    kept = torch.rand(2 * count, generator=generator) < 0.5
    return concatenate([outer, inner]).select(kept)


def half_cylinder(keep_azimuth_deg: float, is_flat: bool = True) -> Splats:
    """The half of the cylinder towards an azimuth."""
    complete = cylinder(is_flat=is_flat)
    azimuth = np.deg2rad(keep_azimuth_deg)
    side = complete.means @ torch.tensor([np.cos(azimuth), np.sin(azimuth), 0.0]).float()
    return complete.select(side > 0)


def angle_between(a_deg: float, b_deg: float) -> float:
    """Return how far two directions are apart, in degrees from 0 to 180."""
    return abs((a_deg - b_deg + 180) % 360 - 180)


def leaning_board(lean_deg: float, depth_step: float = 1e-4, half_width: float = 0.16) -> Splats:
    """Return a board as a depth camera out along x samples it: red below, green above.

    Args:
        lean_deg: how far the board is turned about z away from the camera; at 0 it faces it.
        depth_step: of the camera's depths.
        half_width: of the board as the camera sees it.
    """
    along = np.arange(-half_width, half_width, PITCH)
    y, z = (grid.ravel() for grid in np.meshgrid(along, along))
    # pixels' rays meet in the camera
    depth = RADIUS / (1 + y / RADIUS * math.tan(math.radians(lean_deg)))
    depth = np.round(depth / depth_step) * depth_step
    points = np.stack([RADIUS - depth, y * depth / RADIUS, z * depth / RADIUS], axis=1)
    color = torch.where(torch.from_numpy(z > 0)[:, None], torch.tensor(GREEN), torch.tensor(RED))
    return round_splats(torch.from_numpy(points), scale=PITCH / 2, opacity=0.95, color=color)
