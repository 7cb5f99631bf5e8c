"""Splats and cameras that the rows of the stress table are made of."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from gscomplete.splats import Splats, colors_to_sh
from gscomplete.views import Cameras, focal_from_fov, four_view_orbit


def random_splats(count: int, seed: int = 0, *, scale: float = 0.05, degree: int = 0) -> Splats:
    """Return splats of one typical scale about the origin, colours within [0, 1]."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    higher = 0.1 * normal(count, (degree + 1) ** 2 - 1, 3)
    colors = 0.2 + 0.6 * torch.rand(count, 3, generator=generator)
    return Splats(
        0.4 * normal(count, 3),
        torch.nn.functional.normalize(normal(count, 4), dim=1),
        scale * torch.exp(0.5 * normal(count, 3)),
        0.05 + 0.9 * torch.rand(count, generator=generator),
        torch.cat([colors_to_sh(colors), higher], dim=1),
    )


def ring(size_px: int = 48, fov_deg: float = 45.0, radius: float = 2.5) -> Cameras:
    """Return four views of the origin."""
    return four_view_orbit(20.0, 15.0, radius=radius, fov_deg=fov_deg, size_px=size_px)


def front_camera(width: int, height: int | None = None) -> Cameras:
    """Return one camera at the origin that looks along +z: depths are z to the last bit."""
    height = width if height is None else height
    focal = focal_from_fov(60.0, max(width, height))
    return Cameras(
        torch.eye(4)[None],
        torch.full((1, 2), focal),
        torch.tensor([[width / 2, height / 2]]),
        width,
        height,
    )


def with_fields(splats: Splats, **fields: Tensor | float | list) -> Splats:
    """Replace fields; numbers and short rows are spread over all splats."""
    values = {}
    for name, value in fields.items():
        old = getattr(splats, name)
        values[name] = torch.as_tensor(value, dtype=old.dtype).expand(old.shape).clone()
    return dataclasses.replace(splats, **values)


def ball(count: int = 1200, seed: int = 0) -> Splats:
    """Return a ball of discs of diameter 0.8, red above and blue below."""
    generator = torch.Generator().manual_seed(seed)
    normal = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
    from gscomplete.splats.rotations import quaternions_facing

    top = (normal[:, 2:] > 0).float()
    red, blue = torch.tensor([0.9, 0.2, 0.1]), torch.tensor([0.1, 0.3, 0.9])
    return Splats(
        0.4 * normal,
        quaternions_facing(normal),
        torch.tensor([[0.03, 0.03, 0.003]]).repeat(count, 1),
        torch.full((count,), 0.95),
        colors_to_sh(top * red + (1 - top) * blue),
    )
