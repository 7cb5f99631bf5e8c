"""What the input views say about space: seen to be empty, hidden behind P, or beside P.

Conventions
-----------
* P is rendered from a few views of V. A point in front of P's surface is known to be empty:
  otherwise it would hide P. About a point behind P's surface nothing is known. On a ray beside P
  there may be something that was cut away.
* Depth is camera-space z; pixels as in ``views.cameras``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import torch

from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.util.arrays import Float32Array, IntArray
from gscomplete.util.kernels import HELPER
from gscomplete.views import ViewDistribution

SIZE_PX = 48
FRONT_TOLERANCE = 0.03
"""A point this much nearer than P's surface is in front of it (object sizes)."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """P's depth from a few views of V."""

    depth: Float32Array  # [V, S, S] of P's surface; inf where P is not
    camera_from_world: Float32Array  # [V, 4, 4]
    focal_px: float

    def toward_c(self) -> Float32Array:  # [3]
        """Return the direction from the object to c, at most as steep as the views to its sides."""
        return -self.camera_from_world[0, 2, :3]

    def classify(self, points: Float32Array) -> Float32Array:  # [N, 3] -> [N, 3]
        """Return for every point the shares of views that find it in front, behind, beside P."""
        flat = points.reshape(-1, 3).astype(np.float32)
        shares = np.zeros((len(flat), 3), np.float32)
        for depth, matrix in zip(self.depth, self.camera_from_world, strict=True):
            kinds = _kinds_of(flat, depth, matrix, self.focal_px)
            shares += np.eye(3)[kinds] / len(self.depth)
        return shares


def gather_evidence(partial: Splats, distribution: ViewDistribution) -> Evidence:
    """Render P's depth from the input view c and from views to both sides of it."""
    cameras = distribution.sides(SIZE_PX)
    with torch.no_grad():
        seen = render(partial.with_sh_degree(0), cameras)
    depth = torch.where(seen.alpha > 0.5, seen.depth, torch.inf).float().numpy()
    return Evidence(
        np.ascontiguousarray(depth),
        np.ascontiguousarray(cameras.camera_from_world.float().numpy()),
        float(cameras.focal_px[0, 0]),
    )


@numba.njit(**HELPER)
def kind_of(
    x: float,
    y: float,
    z: float,
    depth: Float32Array,  # [S, S]
    m: Float32Array,  # [4, 4] camera from world
    focal_px: float,
) -> int:
    """Return whether one view finds a point in front of P (0), behind it (1) or beside it (2)."""
    size = depth.shape[0]
    far = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
    if far <= 1e-3:
        return 2
    px = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / far * focal_px + 0.5 * size
    py = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / far * focal_px + 0.5 * size
    if not (0 <= px < size and 0 <= py < size):
        return 2
    surface = depth[int(py), int(px)]
    if surface == np.inf:
        return 2
    return 0 if far < surface - FRONT_TOLERANCE else 1


def _kinds_of(
    points: Float32Array,  # [N, 3]
    depth: Float32Array,  # [S, S]
    m: Float32Array,  # [4, 4] camera from world
    focal_px: float,
) -> IntArray:  # [N]
    """Return ``kind_of`` of every point; in NumPy, because so few points do not repay compiling."""
    size = depth.shape[0]
    x, y, z = points.T
    right, down, far = (row[0] * x + row[1] * y + row[2] * z + row[3] for row in m[:3])
    with np.errstate(divide="ignore", invalid="ignore"):
        px, py = ((a / far).astype(np.float64) * focal_px + 0.5 * size for a in (right, down))
    far = far.astype(np.float64)
    seen = (far > 1e-3) & (px >= 0) & (px < size) & (py >= 0) & (py < size)
    surface = np.full(len(points), np.inf)
    surface[seen] = depth[py[seen].astype(np.int64), px[seen].astype(np.int64)]
    return np.where(surface == np.inf, 2, np.where(far < surface - FRONT_TOLERANCE, 0, 1))
