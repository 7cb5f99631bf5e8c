"""Batches of pinhole cameras and the orbits that place them.

Conventions
-----------
* Camera axes are OpenCV's: x right, y down, z forward (into the scene).
* ``camera_from_world`` maps world points [x, y, z, 1] into camera axes.
* Pixels: the centre of the top-left pixel is (0.5, 0.5).
* Orbits live in the object frame: right-handed, z up. A camera at azimuth A and elevation e
  stands at target + radius * (cos e cos A, cos e sin A, sin e): azimuth 0 looks from +x, azimuth
  90 from +y (anticlockwise seen from above), positive elevation looks down from above.
* Angles in names ending ``_deg`` are degrees; fields of view are vertical.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.util.device import plain_torch


@dataclass(frozen=True, slots=True)
class Cameras:
    """V pinhole cameras that share one image size."""

    camera_from_world: Tensor  # [V, 4, 4]
    focal_px: Tensor  # [V, 2] (fx, fy)
    center_px: Tensor  # [V, 2] (cx, cy)
    width: int
    height: int

    def __post_init__(self) -> None:
        """Check shapes.

        Raises:
            ValueError: a shape or the image size is wrong.
        """
        count = self.camera_from_world.shape[0]
        for name, shape in (
            ("camera_from_world", (count, 4, 4)),
            ("focal_px", (count, 2)),
            ("center_px", (count, 2)),
        ):
            found = tuple(getattr(self, name).shape)
            if found != shape:
                raise ValueError(f"Cameras.{name}: expected shape {shape}, found {found}")
        if self.width < 1 or self.height < 1:
            raise ValueError(f"Cameras: image size {self.width} x {self.height} is not positive")

    def __len__(self) -> int:
        """Return the number of cameras."""
        return int(self.camera_from_world.shape[0])

    def __getitem__(self, index: int | slice | Tensor | Sequence[int]) -> Cameras:
        """Return a batch with the chosen cameras (an int gives a batch of one).

        Raises:
            IndexError: there is no such camera.
        """
        if isinstance(index, int):
            place = range(len(self))[index]
            index = slice(place, place + 1)
        return dataclasses.replace(
            self,
            camera_from_world=self.camera_from_world[index],
            focal_px=self.focal_px[index],
            center_px=self.center_px[index],
        )

    def __iter__(self) -> Iterator[Cameras]:
        """Yield every camera as a batch of one."""
        return (self[index] for index in range(len(self)))

    @property
    def positions(self) -> Tensor:  # [V, 3]
        """Camera centres in world coordinates."""
        rotation = self.camera_from_world[:, :3, :3]
        translation = self.camera_from_world[:, :3, 3]
        return -(rotation.transpose(1, 2) @ translation[:, :, None])[:, :, 0]

    def to(
        self, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> Cameras:
        """Return the cameras on another device or in another floating dtype."""
        return dataclasses.replace(
            self,
            camera_from_world=self.camera_from_world.to(device=device, dtype=dtype),
            focal_px=self.focal_px.to(device=device, dtype=dtype),
            center_px=self.center_px.to(device=device, dtype=dtype),
        )

    def resized(self, width: int, height: int) -> Cameras:
        """Return the same views at another image size (intrinsics scaled with it)."""
        factor = self.focal_px.new_tensor([width / self.width, height / self.height])
        return dataclasses.replace(
            self,
            focal_px=self.focal_px * factor,
            center_px=self.center_px * factor,
            width=width,
            height=height,
        )


def join_cameras(parts: Sequence[Cameras]) -> Cameras:
    """Join camera batches of one image size.

    Args:
        parts: batches, at least one.

    Returns:
        Their cameras, in order.

    Raises:
        ValueError: ``parts`` is empty or image sizes differ.
    """
    sizes = {(part.width, part.height) for part in parts}
    if len(sizes) != 1:
        raise ValueError(f"join_cameras: expected one image size, found {sorted(sizes)}")
    return Cameras(
        torch.cat([part.camera_from_world for part in parts]),
        torch.cat([part.focal_px for part in parts]),
        torch.cat([part.center_px for part in parts]),
        parts[0].width,
        parts[0].height,
    )


def focal_from_fov(fov_deg: float, size_px: int) -> float:
    """Focal length in pixels of a field of view that spans ``size_px`` pixels.

    Args:
        fov_deg: full angle in degrees.
        size_px: width or height of the picture.

    Returns:
        The focal length in pixels.
    """
    return 0.5 * size_px / math.tan(math.radians(fov_deg) / 2)


def radius_to_fit(extent: float, fov_deg: float) -> float:
    """Distance at which a length ``extent`` through the target just spans the field of view.

    Args:
        extent: length across the view, world units.
        fov_deg: full angle in degrees.

    Returns:
        The distance from camera to target, world units.
    """
    return 0.5 * extent / math.tan(math.radians(fov_deg) / 2)


@plain_torch()
def orbit_cameras(
    azimuths_deg: Tensor,  # [V]
    elevations_deg: Tensor,  # [V]
    *,
    radius: float,
    fov_deg: float,
    size_px: int,
    target: Tensor | None = None,  # [3], None = origin
) -> Cameras:
    """Place square-image cameras on a sphere about ``target``, looking at it, z up.

    At elevations of +/-90 degrees the image's up direction is the limit of approaching the pole
    along the given azimuth, so no view is undefined. Computed in float64, returned in float32.

    Args:
        azimuths_deg: 0 looks from +x, 90 from +y.
        elevations_deg: positive looks down.
        radius: distance from the target, world units.
        fov_deg: vertical field of view.
        size_px: width and height.
        target: where all look; None = the origin.

    Returns:
        V cameras with OpenCV axes.
    """
    azimuth = torch.deg2rad(azimuths_deg.to(torch.float64))
    elevation = torch.deg2rad(elevations_deg.to(torch.float64))
    cos_a, sin_a = torch.cos(azimuth), torch.sin(azimuth)
    cos_e, sin_e = torch.cos(elevation), torch.sin(elevation)
    zero = torch.zeros_like(cos_a)
    outward = torch.stack([cos_e * cos_a, cos_e * sin_a, sin_e], dim=-1)
    right = torch.stack([-sin_a, cos_a, zero], dim=-1)
    up = torch.stack([-sin_e * cos_a, -sin_e * sin_a, cos_e], dim=-1)
    rotation = torch.stack([right, -up, -outward], dim=1)  # rows: camera x, y, z in world
    center = torch.zeros(3, dtype=torch.float64) if target is None else target.to(torch.float64)
    position = center + radius * outward
    matrix = torch.zeros(len(azimuth), 4, 4, dtype=torch.float64)
    matrix[:, :3, :3] = rotation
    matrix[:, :3, 3] = -(rotation @ position[:, :, None])[:, :, 0]
    matrix[:, 3, 3] = 1.0
    focal = torch.full((len(azimuth), 2), focal_from_fov(fov_deg, size_px))
    middle = torch.full((len(azimuth), 2), size_px / 2)
    return Cameras(matrix.float(), focal.float(), middle.float(), size_px, size_px)


def four_view_orbit(
    azimuth_deg: float, elevation_deg: float, *, radius: float, fov_deg: float, size_px: int
) -> Cameras:
    """Four cameras at one elevation, 90 degrees apart (paper, Equation 2: r_mv).

    Args:
        azimuth_deg: of the first camera; 0 looks from +x, 90 from +y.
        elevation_deg: of all four; positive looks down.
        radius: distance from the origin, world units.
        fov_deg: vertical field of view.
        size_px: width and height.

    Returns:
        4 cameras, azimuth increasing by 90 degrees.
    """
    azimuths = azimuth_deg + 90.0 * torch.arange(4, dtype=torch.float64)
    elevations = torch.full((4,), float(elevation_deg), dtype=torch.float64)
    return orbit_cameras(azimuths, elevations, radius=radius, fov_deg=fov_deg, size_px=size_px)
