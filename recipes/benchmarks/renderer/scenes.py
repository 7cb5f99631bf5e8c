"""Splats that renderer benchmarks draw, and the view they are drawn from.

Conventions
-----------
* Scenes have a largest side of 1 and are centred on the origin.
* ``surface_discs`` is what a converted mesh looks like: opaque flat discs that overlap a little.
  ``cloud`` is what optimisation meets on the way: half-transparent ellipsoids of mixed sizes.
* Bands of spherical harmonics above the first are random but small: they cost what real ones cost
  and leave the picture recognisable.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Splats, colors_to_sh
from gscomplete.views import Cameras, four_view_orbit


def bench_camera(size_px: int) -> Cameras:
    """Return the one view of all renderer benchmarks, at this image size."""
    return four_view_orbit(30, 15, radius=2.0, fov_deg=40, size_px=size_px)[0]


def surface_discs(mesh_path: Path | None, count: int, sh_degree: int = 0) -> Splats:
    """Cover a surface of largest side 1 with ``count`` oriented discs coloured by normal.

    Args:
        mesh_path: a mesh in any format trimesh reads; None = a torus knot.
        count: number of splats.
        sh_degree: degree of the spherical harmonics, 0 to 3.

    Raises:
        UserError: there is no such file.
    """
    if mesh_path is None:
        points, normals, area = _torus_knot(count)
    else:
        import trimesh

        if not mesh_path.is_file():
            raise UserError(f"{mesh_path}: --mesh: expected a mesh file, found none")
        mesh = trimesh.load(mesh_path, force="mesh", process=False)
        side = float(np.max(mesh.extents))
        points, faces = trimesh.sample.sample_surface(mesh, count, seed=0)
        points = (points - mesh.bounds.mean(axis=0)) / side
        normals, area = mesh.face_normals[faces], mesh.area / side**2
    axis = np.cross([0.0, 0.0, 1.0], normals)
    quaternions = np.concatenate([1.0 + normals[:, 2:], axis], axis=1)
    quaternions[np.linalg.norm(quaternions, axis=1) < 1e-6] = (0.0, 1.0, 0.0, 0.0)
    width = 0.72 * np.sqrt(area / count)
    splats = Splats(
        torch.from_numpy(points).float(),
        torch.nn.functional.normalize(torch.from_numpy(quaternions).float(), dim=1),
        torch.tensor([[width, width, 0.05 * width]], dtype=torch.float32).repeat(count, 1),
        torch.full((count,), 0.95),
        colors_to_sh(torch.from_numpy(normals * 0.5 + 0.5).float()),
    )
    return with_random_bands(splats, sh_degree)


def cloud(count: int, sh_degree: int = 0) -> Splats:
    """Fill a ball with ``count`` ellipsoids of mixed size, shape, opacity and colour."""
    random = torch.Generator().manual_seed(1)
    direction = torch.nn.functional.normalize(torch.randn(count, 3, generator=random), dim=1)
    radius = 0.5 * torch.rand(count, 1, generator=random) ** (1 / 3)
    spread = torch.exp(0.7 * torch.randn(count, 3, generator=random))
    splats = Splats(
        direction * radius,
        torch.nn.functional.normalize(torch.randn(count, 4, generator=random), dim=1),
        0.25 * count ** (-1 / 3) * spread,
        0.02 + 0.97 * torch.rand(count, generator=random),
        colors_to_sh(torch.rand(count, 3, generator=random)),
    )
    return with_random_bands(splats, sh_degree)


def with_random_bands(splats: Splats, sh_degree: int) -> Splats:
    """Return the splats with small random coefficients in the bands up to ``sh_degree``."""
    raised = splats.with_sh_degree(sh_degree)
    if sh_degree == 0:
        return raised
    random = torch.Generator().manual_seed(2)
    sh = raised.sh.clone()
    sh[:, 1:] = 0.05 * torch.randn(sh[:, 1:].shape, generator=random)
    return Splats(splats.means, splats.quaternions, splats.scales, splats.opacities, sh)


def trainable_copy(splats: Splats) -> Splats:
    """Copy splats into leaf tensors that take gradients."""
    return Splats(**{name: value.clone().requires_grad_() for name, value in splats.fields()})


def _torus_knot(count: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Points and normals on a (2, 3) torus knot tube, and its area."""
    rng = np.random.default_rng(0)
    t, phi = 2 * np.pi * rng.random(count), 2 * np.pi * rng.random(count)
    radius = 0.28 + 0.12 * np.cos(3 * t)
    center = np.stack([radius * np.cos(2 * t), radius * np.sin(2 * t), 0.12 * np.sin(3 * t)], 1)
    ahead = t + 1e-4
    radius2 = 0.28 + 0.12 * np.cos(3 * ahead)
    tangent = (
        np.stack(
            [radius2 * np.cos(2 * ahead), radius2 * np.sin(2 * ahead), 0.12 * np.sin(3 * ahead)], 1
        )
        - center
    )
    length = float(np.linalg.norm(tangent, axis=1).mean() / 1e-4 * 2 * np.pi)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)
    normals = np.cos(phi)[:, None] * side + np.sin(phi)[:, None] * up
    return center + 0.06 * normals, normals, length * 2 * np.pi * 0.06
