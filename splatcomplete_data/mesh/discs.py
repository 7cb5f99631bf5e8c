"""Oriented discs: surfaces turned into flat Gaussian splats.

Conventions
-----------
* A disc lies in its local xy plane: scales are (tangent, tangent, normal), the third axis is the
  surface normal up to sign. Discs look the same from both sides.
* Triangles are given corner by corner (a "soup"), so a corner may have a colour of its own on
  each triangle; anticlockwise corners seen from outside give an outward normal.
* ``spacing`` is the side of the square of surface that one splat stands for, sqrt(area / count).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from gscomplete.splats.record import Splats, colors_to_sh
from gscomplete.util.arrays import Float32Array, IntArray

DISC_OPACITY = 0.97
_TANGENT_PER_SPACING = 0.6
"""Tangent standard deviation over spacing; below about 0.5 the surface shows holes."""
_NORMAL_PER_TANGENT = 0.05
"""Thickness over tangent standard deviation."""


@dataclass(frozen=True, slots=True)
class ColoredTriangles:
    """T triangles with a colour at every corner."""

    vertices: Float32Array  # [T, 3, 3] corners
    colors: Float32Array  # [T, 3, 3] sRGB in [0, 1] at the corners

    def __post_init__(self) -> None:
        """Check that both arrays are [T, 3, 3].

        Raises:
            ValueError: a shape is wrong or the two differ.
        """
        for name in ("vertices", "colors"):
            shape = getattr(self, name).shape
            if len(shape) != 3 or shape[1:] != (3, 3):
                raise ValueError(f"ColoredTriangles.{name}: expected (T, 3, 3), found {shape}")
        if len(self.vertices) != len(self.colors):
            raise ValueError(
                f"ColoredTriangles.colors: expected {len(self.vertices)} triangles, "
                f"found {len(self.colors)}"
            )


def quaternions_from_normals(normals: Float32Array) -> Float32Array:  # [N, 3] -> [N, 4]
    """Return wxyz quaternions that turn +z onto each normal or onto its opposite.

    Discs are symmetric, so the normal is flipped to z >= 0 first: the shortest rotation is then
    never near its singularity at -z. Normals need not be unit; a zero normal gives identity.
    """
    length = np.sqrt(np.einsum("ij,ij->i", normals, normals))
    safe = np.where(length > 1e-20, length, 1.0).astype(np.float32)
    sign = np.where(normals[:, 2] < 0, -1.0, 1.0).astype(np.float32) / safe
    quaternions = np.zeros((len(normals), 4), np.float32)
    quaternions[:, 0] = 1.0 + normals[:, 2] * sign
    quaternions[:, 1] = -normals[:, 1] * sign
    quaternions[:, 2] = normals[:, 0] * sign
    quaternions /= np.sqrt(np.einsum("ij,ij->i", quaternions, quaternions))[:, None]
    return quaternions


def discs_at(
    points: Float32Array,  # [N, 3]
    normals: Float32Array,  # [N, 3]
    colors: Float32Array,  # [N, 3] sRGB in [0, 1]
    spacing: Float32Array | float,  # [N] or one number
    opacity: float = DISC_OPACITY,
) -> Splats:
    """Put one oriented disc at every surface point."""
    count = len(points)
    tangent = np.broadcast_to(
        np.asarray(spacing, np.float32) * np.float32(_TANGENT_PER_SPACING), (count,)
    )
    scales = np.empty((count, 3), np.float32)
    scales[:, 0] = scales[:, 1] = tangent
    scales[:, 2] = tangent * _NORMAL_PER_TANGENT
    return Splats(
        means=torch.from_numpy(np.ascontiguousarray(points, np.float32)),
        quaternions=torch.from_numpy(quaternions_from_normals(normals)),
        scales=torch.from_numpy(scales),
        opacities=torch.full((count,), opacity),
        sh=colors_to_sh(torch.from_numpy(np.ascontiguousarray(colors, np.float32))),
    )


def triangle_areas_and_normals(vertices: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return areas [T] and unnormalised normals [T, 3] of triangles [T, 3, 3]."""
    normals = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
    return 0.5 * np.linalg.norm(normals, axis=1), normals


def sample_triangles(
    vertices: Float32Array,  # [T, 3, 3]
    count: int,
    seed: int,
) -> tuple[IntArray, Float32Array]:
    """Draw surface samples spread evenly by area.

    One sample falls in each of ``count`` equal slices of the cumulative area, so a triangle gets
    its share of samples rounded up or down. Within a triangle samples follow a low-discrepancy
    (Kronecker) sequence folded into the triangle.

    Returns:
        Triangle of every sample [N] (ascending) and its barycentric coordinates [N, 3].

    Raises:
        ValueError: no triangle has an area, or ``count`` is not positive.
    """
    if count < 1:
        raise ValueError(f"sample_triangles: count must be positive, found {count}")
    areas = triangle_areas_and_normals(vertices.astype(np.float64))[0]
    edges = np.cumsum(areas)
    if len(edges) == 0 or not edges[-1] > 0:
        raise ValueError("sample_triangles: no triangle has a positive, finite area")
    rng = np.random.default_rng(seed)
    position = (np.arange(count) + rng.random(count)) * (edges[-1] / count)
    triangle = np.minimum(np.searchsorted(edges, position, side="right"), len(edges) - 1)
    a = (np.arange(count) * 0.7548776662466927 + rng.random()) % 1.0
    b = (np.arange(count) * 0.5698402909980532 + rng.random()) % 1.0
    folded = a + b > 1.0
    a, b = np.where(folded, 1.0 - a, a), np.where(folded, 1.0 - b, b)
    return triangle, np.stack([1.0 - a - b, a, b], axis=1).astype(np.float32)


def triangles_to_discs(triangles: ColoredTriangles, count: int, seed: int = 0) -> Splats:
    """Cover a triangle mesh with ``count`` oriented discs.

    Args:
        triangles: the surface.
        count: number of splats.
        seed: seed of the sampling.

    Raises:
        ValueError: no triangle has an area, or ``count`` is not positive.
    """
    triangle, weights = sample_triangles(triangles.vertices, count, seed)
    points = np.einsum("nk,nkc->nc", weights, triangles.vertices[triangle])
    areas, normals = triangle_areas_and_normals(triangles.vertices)
    colors = np.einsum("nk,nkc->nc", weights, triangles.colors[triangle])
    spacing = float(np.sqrt(areas.sum(dtype=np.float64) / count))
    return discs_at(points, normals[triangle], colors, spacing)
