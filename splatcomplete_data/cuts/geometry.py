"""Cut complete objects into partial ones.

Conventions
-----------
* A cut never changes splats: it returns a mask of what is kept, its kind, and its parameters.
* Cameras that "see" are points in the frame of the splats; nothing is rendered.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numba
import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from gscomplete.splats.record import Splats
from gscomplete.util.arrays import BoolArray, Float32Array, Float64Array

CutKind = Literal["plane", "box", "visibility", "crop", "plane+box", "plane+visibility", "nothing"]
_GRID_PX = 160
"""Side of the depth image by which splats are told to be seen."""


@dataclass(frozen=True, slots=True)
class PartialCut:
    """What a cut keeps and why."""

    mask: Tensor  # [N] bool, True = kept
    kind: CutKind
    details: Mapping[str, object] = field(default_factory=dict)

    @property
    def kept(self) -> int:
        """Number of splats kept."""
        return int(self.mask.sum())

    @property
    def reason(self) -> str:
        """One line for logs: kind, counts and parameters."""
        numbers = ", ".join(f"{name} {value}" for name, value in self.details.items())
        return f"{self.kind}: kept {self.kept} of {len(self.mask)} splats ({numbers})"


def splat_points(splats: Splats) -> Float32Array:
    """Return the means as numpy [N, 3]."""
    return splats.means.detach().cpu().float().numpy()


def _cut(splats: Splats, mask: BoolArray, kind: CutKind, **details: object) -> PartialCut:
    """Put a numpy mask on the splats' device and record how it came about."""
    tensor = torch.from_numpy(np.ascontiguousarray(mask)).to(splats.means.device)
    return PartialCut(tensor, kind, details)


def by_plane(splats: Splats, normal: ArrayLike, offset: float) -> PartialCut:
    """Keep the splats with ``normal . x >= offset`` (normal [3], scaled to unit length here).

    Raises:
        ValueError: the normal is zero or not finite.
    """
    direction = np.asarray(normal, np.float64)
    length = float(np.linalg.norm(direction))
    if not (math.isfinite(length) and length > 0):
        raise ValueError(f"by_plane: expected a finite, non-zero normal, found {direction}")
    direction = direction / length
    mask = splat_points(splats) @ direction.astype(np.float32) >= offset
    return _cut(splats, mask, "plane", normal=direction.round(4).tolist(), offset=round(offset, 4))


def by_box(
    splats: Splats,
    center: ArrayLike,  # [3]
    size: ArrayLike,  # [3] edge lengths
    *,
    turn: ArrayLike | None = None,  # [3, 3] columns are the box's axes, None = axis-aligned
    keep: Literal["inside", "outside"] = "inside",
) -> PartialCut:
    """Keep the splats inside or outside an oriented box."""
    offset = splat_points(splats) - np.asarray(center, np.float32)
    if turn is not None:
        offset = offset @ np.asarray(turn, np.float32)
    inside: BoolArray = np.all(np.abs(offset) <= 0.5 * np.asarray(size, np.float32), axis=1)
    mask = inside if keep == "inside" else ~inside
    found = np.asarray(center, np.float64).round(4).tolist()
    edges = np.asarray(size, np.float64).round(4).tolist()
    return _cut(splats, mask, "box", keep=keep, center=found, size=edges)


def crop(splats: Splats, low: ArrayLike, high: ArrayLike) -> PartialCut:
    """Keep the splats inside an axis-aligned box given by its corners [3] and [3]."""
    points = splat_points(splats)
    mask: BoolArray = np.all((points >= np.asarray(low)) & (points <= np.asarray(high)), axis=1)
    low_list = np.asarray(low, np.float64).round(4).tolist()
    high_list = np.asarray(high, np.float64).round(4).tolist()
    return _cut(splats, mask, "crop", low=low_list, high=high_list)


def by_visibility(
    splats: Splats,
    positions: ArrayLike,  # [V, 3] camera centres
    *,
    fov_deg: float = 60.0,
    tolerance: float | None = None,
) -> PartialCut:
    """Keep the splats that at least one camera, looking at the object's middle, sees first.

    Every splat is drawn as a square of its footprint into a coarse depth image; a splat is seen
    where it is not deeper than the nearest one by more than the tolerance. Very faint splats
    (opacity below 0.2) hide nothing.

    Args:
        splats: the object.
        positions: camera centres, outside the object.
        fov_deg: field of view; widened where the object would not fit.
        tolerance: depth slack, None = three median tangent sizes.

    Raises:
        ValueError: positions are not [V, 3].
    """
    eyes = np.atleast_2d(np.asarray(positions, np.float64))
    if eyes.ndim != 2 or eyes.shape[1] != 3:
        raise ValueError(f"by_visibility: expected positions (V, 3), found {eyes.shape}")
    points = splat_points(splats)
    if len(points) == 0:
        return _cut(splats, np.zeros(0, np.bool_), "visibility", views=len(eyes))
    sizes = splats.scales.detach().amax(dim=1).cpu().float().numpy()
    slack = 3.0 * float(np.median(sizes)) if tolerance is None else tolerance
    solid = (splats.opacities.detach() >= 0.2).cpu().numpy()
    middle = (0.5 * (points.min(axis=0) + points.max(axis=0))).astype(np.float64)
    reach = float(np.linalg.norm(points - middle, axis=1).max())
    seen = np.zeros(len(points), np.bool_)
    for eye in eyes:
        distance = float(np.linalg.norm(eye - middle))
        half = max(math.tan(math.radians(fov_deg) / 2), 1.05 * reach / max(distance - reach, 1e-3))
        rotation = looking_rotation(eye, middle).astype(np.float32)
        local = (points - eye.astype(np.float32)) @ rotation.T
        seen |= _first_surface(local, sizes, solid, _GRID_PX, 0.5 * _GRID_PX / half, slack)
    return _cut(splats, seen, "visibility", views=len(eyes), eyes=eyes.round(3).tolist())


def eyes_at(
    azimuth_rad: ArrayLike, elevation_rad: ArrayLike, distance: float = 1.0
) -> Float64Array:  # [V, 3]
    """Return where cameras stand that look at the origin.

    Args:
        azimuth_rad: [V] or a number, from the x axis towards the y axis.
        elevation_rad: [V] or a number, above the level of the origin.
        distance: from the origin.
    """
    azimuth, elevation = np.broadcast_arrays(
        *np.atleast_1d(np.asarray(azimuth_rad, np.float64), np.asarray(elevation_rad, np.float64))
    )
    level = distance * np.cos(elevation)
    return np.stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)], axis=1
    )


def looking_rotation(eye: Float64Array, target: ArrayLike) -> Float64Array:
    """Return the rotation [3, 3] into camera axes (x right, y down, z forward), z up.

    Args:
        eye: where the camera stands, [3].
        target: what it looks at, [3].
    """
    forward = np.asarray(target, np.float64) - eye
    forward /= max(float(np.linalg.norm(forward)), 1e-12)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


@numba.njit(cache=True)
def _first_surface(
    local: Float32Array,  # [N, 3] camera axes
    sizes: Float32Array,  # [N]
    solid: BoolArray,  # [N]
    grid_px: int,
    focal_px: float,
    slack: float,
) -> BoolArray:  # [N]
    """Return which points lie on the nearest surface of a depth image they draw themselves."""
    depth = np.full((grid_px, grid_px), np.inf, np.float32)
    count = len(local)
    seen = np.zeros(count, np.bool_)
    for n in range(count):
        z = local[n, 2]
        if z <= 1e-4 or not solid[n]:
            continue
        x = focal_px * local[n, 0] / z + 0.5 * grid_px
        y = focal_px * local[n, 1] / z + 0.5 * grid_px
        reach = min(1.2 * sizes[n] * focal_px / z, 6.0)
        if not (-1e6 < x < 1e6 and -1e6 < y < 1e6):
            continue
        for row in range(max(int(y - reach), 0), min(int(y + reach) + 1, grid_px)):
            for column in range(max(int(x - reach), 0), min(int(x + reach) + 1, grid_px)):
                depth[row, column] = min(depth[row, column], z)
    for n in range(count):
        z = local[n, 2]
        if z <= 1e-4:
            continue
        column = int(focal_px * local[n, 0] / z + 0.5 * grid_px)
        row = int(focal_px * local[n, 1] / z + 0.5 * grid_px)
        if 0 <= row < grid_px and 0 <= column < grid_px:
            seen[n] = z <= depth[row, column] + slack
    return seen
