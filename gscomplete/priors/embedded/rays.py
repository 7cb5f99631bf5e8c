"""What the embedded prior is told about the cameras: ring numbers and Plucker rays.

Conventions
-----------
* A ring is described by three numbers, ``(elevation_deg, radius, fov_deg)``. Absolute azimuth is
  never given: training objects have random yaw, so it carries nothing.
* The ring frame is the object frame moved to the ring's target and turned about z so that view 0
  stands at azimuth 0, view 1 at 90, and so on. Plucker rays are (direction, origin x direction)
  in it, in units of the object frame.
* Ring axes follow ``gscomplete.views.cameras``: z up, images x right, y down.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from gscomplete.views.cameras import Cameras

RAY_CHANNELS = 6


def ring_numbers(cameras: Cameras) -> Tensor:  # [3]
    """Read (elevation_deg, radius, fov_deg) off four cameras that look at one target.

    The target is the point nearest to the four optical axes, so rings about any centre work.

    Returns:
        The numbers in float32 on the CPU.
    """
    matrix = cameras.camera_from_world.detach().to("cpu", torch.float64)
    forward = matrix[:, 2, :3]
    positions = -(matrix[:, :3, :3].transpose(1, 2) @ matrix[:, :3, 3:])[:, :, 0]
    across = torch.eye(3, dtype=torch.float64) - forward[:, :, None] * forward[:, None, :]
    normal = across.sum(0)
    moment = (across @ positions[:, :, None])[:, :, 0].sum(0)
    target = torch.linalg.lstsq(normal, moment[:, None], driver="gelsd").solution[:, 0]
    radius = (positions - target).norm(dim=1).mean()
    elevation = torch.rad2deg(torch.asin((-forward[:, 2]).clamp(-1, 1))).mean()
    half = 0.5 * cameras.height / cameras.focal_px[:, 1].detach().to("cpu", torch.float64).mean()
    fov = torch.rad2deg(2 * torch.atan(half))
    return torch.stack([elevation, radius, fov]).float()


def camera_vector(ring: Tensor) -> Tensor:  # [B, 3] -> [B, 3]
    """Scale ring numbers to about [-1, 1] for the network."""
    elevation, radius, fov = ring.unbind(-1)
    return torch.stack(
        [torch.deg2rad(elevation), radius / 2 - 1, torch.tan(torch.deg2rad(fov) / 2)], dim=-1
    )


def ring_rays(ring: Tensor, size_px: int) -> Tensor:  # [B, 3] -> [B, 4, 6, size, size]
    """Plucker rays of the four views in the ring frame, one per cell of a square grid.

    Args:
        ring: elevation_deg, radius, fov_deg of each ring.
        size_px: cells per side; rays pass through cell centres.
    """
    elevation, radius, fov = ring.unbind(-1)
    elevation = torch.deg2rad(elevation)[:, None]
    azimuth = torch.arange(4, device=ring.device, dtype=ring.dtype)[None] * (math.pi / 2)
    cos_a, sin_a = torch.cos(azimuth), torch.sin(azimuth)
    cos_e, sin_e = torch.cos(elevation), torch.sin(elevation)
    flat = torch.zeros_like(cos_e * cos_a)
    outward = torch.stack([cos_e * cos_a, cos_e * sin_a, sin_e + flat], dim=-1)  # [B, 4, 3]
    right = torch.stack([-sin_a + flat, cos_a + flat, flat], dim=-1)
    up = torch.stack([-sin_e * cos_a, -sin_e * sin_a, cos_e + flat], dim=-1)
    grid = (torch.arange(size_px, device=ring.device, dtype=ring.dtype) + 0.5) / size_px * 2 - 1
    tangent = torch.tan(torch.deg2rad(fov) / 2)[:, None, None, None]
    x = (grid[None, :] * tangent)[..., None]  # [B, 1, 1, size, 1]
    y = (grid[:, None] * tangent)[..., None]  # [B, 1, size, 1, 1]
    cell = (..., None, None, slice(None))
    direction = right[cell] * x - up[cell] * y - outward[cell]  # [B, 4, size, size, 3]
    direction = direction / direction.norm(dim=-1, keepdim=True)
    origin = (outward * radius[:, None, None])[cell].expand_as(direction)
    rays = torch.cat([direction, torch.linalg.cross(origin, direction)], dim=-1)
    return rays.permute(0, 1, 4, 2, 3)
