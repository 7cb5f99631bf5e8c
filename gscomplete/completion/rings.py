"""Rings of four views: where they stand, and the targets that denoising gave them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.priors.base import PriorViews
from gscomplete.util.randomness import generator_for, uniform
from gscomplete.views import Cameras, ViewDistribution, four_view_orbit, radius_to_fit

_ELEVATION_SLACK_DEG = 20.0
"""A ring up to this far beyond V's elevations still sees P much as V does; from farther above or
below, it would see parts of P that are hidden in V."""


@dataclass(frozen=True, slots=True)
class Ring:
    """Four cameras and the denoised pictures that the splats are fitted to."""

    cameras: Cameras  # at the targets' size
    color: Tensor  # [4, h, w, 3] premultiplied
    alpha: Tensor  # [4, h, w]
    step: int  # at which they were made

    def resized(self, size_px: int) -> tuple[Tensor, Tensor]:
        """Return colour and alpha at another size (bilinear)."""
        if self.alpha.shape[-1] == size_px:
            return self.color, self.alpha
        stacked = torch.cat([self.color, self.alpha[..., None]], dim=-1).permute(0, 3, 1, 2)
        scaled = torch.nn.functional.interpolate(
            stacked, size=(size_px, size_px), mode="bilinear", antialias=True
        ).permute(0, 2, 3, 1)
        return scaled[..., :3], scaled[..., 3]


class RingMemory:
    """The newest few rings, oldest first."""

    def __init__(self, capacity: int) -> None:
        """Start empty."""
        self._capacity = capacity
        self._rings: list[Ring] = []

    def __len__(self) -> int:
        """Return how many rings are kept."""
        return len(self._rings)

    def __getitem__(self, index: int) -> Ring:
        """Return a ring, oldest first."""
        return self._rings[index]

    @property
    def newest_step(self) -> int | None:
        """The step that the newest ring was made at; None when there is none."""
        return self._rings[-1].step if self._rings else None

    def add(self, ring: Ring) -> None:
        """Keep a ring, forgetting the oldest when full."""
        self._rings = [*self._rings, ring][-self._capacity :]

    @property
    def tensors(self) -> dict[str, Tensor]:
        """The rings as named tensors."""
        out = {}
        for index, ring in enumerate(self._rings):
            out[f"ring.{index}.color"] = ring.color
            out[f"ring.{index}.alpha"] = ring.alpha
            out[f"ring.{index}.camera_from_world"] = ring.cameras.camera_from_world
            out[f"ring.{index}.focal_px"] = ring.cameras.focal_px
            out[f"ring.{index}.center_px"] = ring.cameras.center_px
            out[f"ring.{index}.step"] = torch.tensor(ring.step)
        return out

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take the rings from :attr:`tensors`.

        Raises:
            ValueError: a tensor of a ring is missing, or of another shape.
        """
        self._rings = []
        while f"ring.{len(self._rings)}.color" in state:
            prefix = f"ring.{len(self._rings)}."
            color = state[prefix + "color"]
            views, height, width = color.shape[:3] if color.ndim == 4 else (0, 0, 0)
            shapes = {
                "color": (views, height, width, 3),
                "alpha": (views, height, width),
                "camera_from_world": (views, 4, 4),
                "focal_px": (views, 2),
                "center_px": (views, 2),
            }
            for name, shape in shapes.items():
                found = state.get(prefix + name)
                if found is None or tuple(found.shape) != shape or not found.is_floating_point():
                    raise ValueError(f"{prefix}{name}: expected numbers {shape}")
            cameras = Cameras(
                state[prefix + "camera_from_world"],
                state[prefix + "focal_px"],
                state[prefix + "center_px"],
                color.shape[2],
                color.shape[1],
            )
            if prefix + "step" not in state:
                raise ValueError(f"{prefix}step: expected the step it was made at, found none")
            step, alpha = int(state[prefix + "step"]), state[prefix + "alpha"]
            self._rings.append(Ring(cameras, color, alpha, step))
        read = tuple(f"ring.{index}." for index in range(min(len(self), self._capacity)))
        other = [name for name in state if name.startswith("ring.") and not name.startswith(read)]
        if other:
            raise ValueError(f"{other[0]}: expected no ring beyond the first {len(read)}")


def random_ring(views: PriorViews, size_px: int, seed: int, step: int) -> Cameras:
    """Draw a ring with the framing the prior knows (paper, section 3.1: r_mv)."""
    generator = generator_for(seed, step, "ring cameras")
    azimuth_deg = uniform(generator, 0.0, 360.0)
    elevation_deg = uniform(generator, *views.elevation_range_deg)
    extent = uniform(generator, *views.extent_range)
    return four_view_orbit(
        azimuth_deg,
        elevation_deg,
        radius=radius_to_fit(extent, views.fov_deg),
        fov_deg=views.fov_deg,
        size_px=size_px,
    )


def inside_distribution(cameras: Cameras, distribution: ViewDistribution) -> Tensor:  # [V] bool
    """Mark the cameras within V's azimuths and at most the slack beyond V's elevations."""
    x, y, z = cameras.positions.unbind(dim=1)
    azimuth_deg = torch.rad2deg(torch.atan2(y, x))
    offset = (azimuth_deg - distribution.azimuth_deg + 180.0) % 360.0 - 180.0
    rise_deg = torch.rad2deg(torch.atan2(z, torch.hypot(x, y))) - distribution.elevation_deg
    is_level = rise_deg.abs() <= distribution.elevation_range_deg + _ELEVATION_SLACK_DEG
    return (offset.abs() <= distribution.azimuth_range_deg) & is_level
