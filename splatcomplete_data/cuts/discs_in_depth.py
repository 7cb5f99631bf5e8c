"""Which splats a scanner sees: splats drawn as discs into a depth image, each in its own plane.

Conventions
-----------
* Camera axes: x right, y down, z forward. A disc reaches ``_REACH_SIGMAS`` standard deviations
  along its two longest axes, and at least a pixel; a round splat faces the scanner.
* A splat is seen if no disc is nearer than its own plane, in the pixel of its centre, by more than
  the slack. Depths of planes, unlike depths of centres, leave no slits on slanted surfaces.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from gscomplete.splats.record import Splats
from gscomplete.splats.rotations import rotation_matrices

_REACH_SIGMAS = 1.6
"""Neighbours of an evenly covered surface overlap, and scattered ones leave no holes."""
_FLAT = 0.5
"""A splat whose smallest scale is less than this share of the middle one is a disc."""
_LEAST_SLACK, _SLACK_SIZES = 0.003, 0.5
"""Slack across a surface, in object sizes and in sizes of splats."""
_ROUND_SIZES = 3.0
"""Round splats do not say how the surface slants: they have so many sizes more of it."""
_SQUARE = 0.15
"""Cosine of the angle beyond which obliqueness excuses no more."""
_FAINT = 0.2
"""Fainter splats hide nothing."""
_MOST_PX = 256
"""Discs are drawn at most so many pixels wide."""

FloatArray = NDArray[np.float32]


def seen_discs(
    splats: Splats,
    eye: NDArray[np.float64],  # [3]
    camera_from_object: NDArray[np.float64],  # [3, 3]
    grid_px: int,
    half_width: float,
) -> NDArray[np.bool_]:  # [N]
    """Mark the splats that a scanner sees.

    Args:
        splats: in the object frame.
        eye: where the scanner stands.
        camera_from_object: rotation into its axes.
        grid_px: side of the depth image.
        half_width: of the image plane at depth 1.
    """
    order = splats.scales.argsort(dim=1, descending=True)
    columns = (
        rotation_matrices(splats.quaternions)
        .transpose(1, 2)
        .gather(1, order[:, :, None].expand(-1, -1, 3))
    )
    axes = columns.double().numpy() @ camera_from_object.T  # [N, 3, 3] longest first
    scales = splats.scales.gather(1, order).double().numpy()
    local = (splats.means.double().numpy() - eye) @ camera_from_object.T
    rays = local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-12)
    is_round = scales[:, 2] >= _FLAT * scales[:, 1]
    facing = np.cross(rays, np.array([0.0, 1.0, 0.0]))
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-12)
    axes[is_round] = np.stack([facing, np.cross(rays, facing), rays], axis=1)[is_round]
    focal_px = 0.5 * grid_px / half_width
    reach = np.maximum(_REACH_SIGMAS * scales[:, :2], local[:, 2:] / focal_px)
    typical = float(np.median(scales[:, 0]))
    cosine = np.abs((axes[:, 2] * rays).sum(axis=1))
    slack = max(_LEAST_SLACK, _SLACK_SIZES * typical) / np.maximum(cosine, _SQUARE)
    slack += np.where(is_round, _ROUND_SIZES * scales[:, 0], 0.0)
    solid = (splats.opacities >= _FAINT).numpy()
    seen: NDArray[np.bool_] = _seen(local, axes, reach, slack, solid, grid_px, focal_px)
    return seen


@numba.njit(cache=True)
def _seen(
    local: Any,  # [N, 3]
    axes: Any,  # [N, 3, 3] tangents, normal
    reach: Any,  # [N, 2]
    slack: Any,  # [N]
    solid: Any,  # [N]
    grid_px: int,
    focal_px: float,
) -> Any:  # [N]
    """Draw the nearest plane of every pixel, then compare each splat's own with it."""
    depth = np.full((grid_px, grid_px), np.inf)
    middle = 0.5 * grid_px
    seen = np.zeros(len(local), np.bool_)
    for n in range(len(local)):
        z = local[n, 2]
        if z <= 1e-4 or not solid[n]:
            continue
        x, y = focal_px * local[n, 0] / z + middle, focal_px * local[n, 1] / z + middle
        if not (-1e6 < x < 1e6 and -1e6 < y < 1e6):
            continue
        wide = np.abs(axes[n, 0]) * reach[n, 0] + np.abs(axes[n, 1]) * reach[n, 1]
        near = max(z - wide[2], 0.5 * z)
        px = min(focal_px * (wide[0] + abs(local[n, 0]) * wide[2] / z) / near + 1, _MOST_PX)
        py = min(focal_px * (wide[1] + abs(local[n, 1]) * wide[2] / z) / near + 1, _MOST_PX)
        for row in range(max(int(y - py), 0), min(int(y + py) + 1, grid_px)):
            for column in range(max(int(x - px), 0), min(int(x + px) + 1, grid_px)):
                u, v = (column + 0.5 - middle) / focal_px, (row + 0.5 - middle) / focal_px
                far = _plane_depth(local[n], axes[n, 2], u, v)
                if not 0 < far < depth[row, column]:
                    continue
                dx, dy, dz = far * u - local[n, 0], far * v - local[n, 1], far - z
                along = dx * axes[n, 0, 0] + dy * axes[n, 0, 1] + dz * axes[n, 0, 2]
                across = dx * axes[n, 1, 0] + dy * axes[n, 1, 1] + dz * axes[n, 1, 2]
                if abs(along) <= reach[n, 0] and abs(across) <= reach[n, 1]:
                    depth[row, column] = far
    for n in range(len(local)):
        z = local[n, 2]
        if z <= 1e-4:
            continue
        column = int(np.floor(focal_px * local[n, 0] / z + middle))
        row = int(np.floor(focal_px * local[n, 1] / z + middle))
        if 0 <= row < grid_px and 0 <= column < grid_px:
            u, v = (column + 0.5 - middle) / focal_px, (row + 0.5 - middle) / focal_px
            own = _plane_depth(local[n], axes[n, 2], u, v)
            if not 0.5 * z < own < 2 * z:  # seen edge-on
                own = z
            seen[n] = own <= depth[row, column] + slack[n]
    return seen


@numba.njit(cache=True)
def _plane_depth(point: Any, normal: Any, u: float, v: float) -> float:
    """Return the depth at which the ray (u, v, 1) meets a plane; 0 where it hardly does."""
    slope = normal[0] * u + normal[1] * v + normal[2]
    if abs(slope) < 1e-4:
        return 0.0
    offset = normal[0] * point[0] + normal[1] * point[1] + normal[2] * point[2]
    return float(offset / slope)
