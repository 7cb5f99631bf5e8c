"""Which way surfaces face: P seen from all round, and normals that point outward.

Conventions
-----------
* The object frame. A splat faces the side from which it is seen more, weighted by how squarely. The
  length of its normal, 0 to 1, says how sure that is: a sheet, seen from both sides alike, has a
  length near 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.render import render
from gscomplete.splats import Splats, colors_to_sh
from gscomplete.splats.geometry.neighbourhood import are_flat
from gscomplete.splats.rotations import thinnest_axes
from gscomplete.util.arrays import Float32Array
from gscomplete.views import Cameras, orbit_cameras, radius_to_fit

_VIEWS = 48
_SIZE_PX = 192
_FOV_DEG = 30.0
_REACH = 1.6
"""Extent that a view shows, object sizes."""
TOLERANCE = 0.015
"""What lies at most this far behind the surface seen belongs to it, object sizes."""
_WALL = 0.004
"""A splat that faces the camera is seen if it lies at most this far behind the surface seen, object
sizes; so walls thicker than this have two sides. Oblique splats get more: a splat is drawn at the
depth of its centre, so the tolerance grows by what the surface falls within a pixel and a splat."""
_PIXEL = _REACH / _SIZE_PX
_SQUARE = 0.3
"""Least cosine used for that growth: beyond this obliqueness it stays the same."""
_NEIGHBOURS = 12
_ROUNDS = 6


@dataclass(frozen=True, slots=True)
class Around:
    """P's pictures from all round."""

    cameras: Cameras
    alpha: Tensor  # [V, S, S]
    depth: Tensor  # [V, S, S]

    def pixels(self, points: Tensor, view: int) -> tuple[Tensor, Tensor, Tensor]:
        """Return rows and columns of points [N, 3] in a view, clamped to it, and their depths."""
        pose = self.cameras.camera_from_world[view].float()
        local = points @ pose[:3, :3].T + pose[:3, 3]
        far = local[:, 2].clamp_min(1e-3)
        place = local[:, :2] / far[:, None] * self.cameras.focal_px[view].float()
        place = (place + self.cameras.center_px[view].float()).floor().long()
        place = place.clamp(0, _SIZE_PX - 1)
        return place[:, 1], place[:, 0], far

    def ways(self, points: Tensor, view: int) -> Tensor:  # [N, 3] -> [N, 3]
        """Return unit directions from points to a view's camera."""
        return F.normalize(self.cameras.positions[view].float() - points, dim=1)


def cameras_around() -> Cameras:
    """Return cameras evenly spread over the sphere."""
    number = torch.arange(_VIEWS, dtype=torch.float64) + 0.5
    elevation = torch.rad2deg(torch.asin(1 - 2 * number / _VIEWS))
    azimuth = torch.rad2deg(number * math.pi * (3 - math.sqrt(5))) % 360  # the golden angle
    return orbit_cameras(
        azimuth.float(),
        elevation.float(),
        radius=radius_to_fit(_REACH, _FOV_DEG),
        fov_deg=_FOV_DEG,
        size_px=_SIZE_PX,
    )


def look_around(splats: Splats) -> Around:
    """Draw P from all round.

    Args:
        splats: P in the object frame.
    """
    cameras = cameras_around()
    with torch.no_grad():
        seen = render(splats.with_sh_degree(0), cameras)
    return Around(cameras, seen.alpha, seen.depth)


def pictures_of_normals(splats: Splats, normals: Tensor, around: Around) -> Tensor:
    """Draw normals instead of colours.

    Args:
        splats: P in the object frame.
        normals: [N, 3], outward, as long as they are sure.
        around: whose cameras to take.

    Returns:
        [V, S, S, 3] the mean normal that is seen in every pixel.
    """
    painted = Splats(
        splats.means,
        splats.quaternions,
        splats.scales,
        splats.opacities,
        colors_to_sh(0.5 + 0.5 * normals),
    )
    with torch.no_grad():
        seen = render(painted, around.cameras)
    return 2 * seen.color - seen.alpha[..., None]


def outward_normals(splats: Splats, around: Around) -> Tensor:  # [N, 3]
    """Return the outward normal of every splat, whose length is how sure it is (0 to 1).

    Args:
        splats: P in the object frame.
        around: P from all round.
    """
    axes = _axes(splats)
    front, back = torch.zeros(len(splats)), torch.zeros(len(splats))
    extent = 1.5 * splats.scales.amax(dim=1)
    for view in range(len(around.cameras)):
        row, column, far = around.pixels(splats.means, view)
        toward = (axes * around.ways(splats.means, view)).sum(dim=1)
        slope = (1 - toward.square()).clamp_min(0).sqrt() / toward.abs().clamp_min(_SQUARE)
        behind = far - around.depth[view, row, column]
        toward = toward * (behind < _WALL + (_PIXEL + extent) * slope)
        front += toward.clamp_min(0)
        back += (-toward).clamp_min(0)
    total = front + back
    sure = (front - back) / total.clamp_min(1e-6)
    normals = axes * sure[:, None]
    return _passed_on(splats.means.numpy(), axes, normals, known=total > 1e-6)


def _axes(splats: Splats) -> Tensor:  # [N, 3]
    """Return unit normals of unknown sign: a flat splat's thin axis, else its neighbourhood's."""
    axes = thinnest_axes(splats.quaternions, splats.scales)
    round_ones = torch.nonzero(~are_flat(splats))[:, 0]
    if not len(round_ones):
        return axes
    points = splats.means.numpy()
    _, index = cKDTree(points).query(points[round_ones.numpy()], k=min(_NEIGHBOURS, len(points)))
    near = splats.means[torch.from_numpy(np.atleast_2d(index))]
    offsets = near - near.mean(dim=1, keepdim=True)
    _, vectors = torch.linalg.eigh((offsets.transpose(1, 2) @ offsets).double())
    axes = axes.clone()
    axes[round_ones] = vectors[:, :, 0].float()
    return axes


def _passed_on(
    points: Float32Array,  # [N, 3]
    axes: Tensor,  # [N, 3]
    normals: Tensor,  # [N, 3]
    *,
    known: Tensor,  # [N] bool
) -> Tensor:  # [N, 3]
    """Give splats that no camera sees the side that their neighbours face."""
    if bool(known.all()) or not bool(known.any()):
        return normals
    _, index = cKDTree(points).query(points, k=min(_NEIGHBOURS, len(points)))
    near = torch.from_numpy(np.asarray(index).reshape(len(points), -1))
    normals = normals.clone()
    for _ in range(_ROUNDS):
        mean = normals[near].mean(dim=1)
        side = torch.sign((mean * axes).sum(dim=1))
        normals = torch.where(known[:, None], normals, axes * (side * mean.norm(dim=1))[:, None])
    return normals
