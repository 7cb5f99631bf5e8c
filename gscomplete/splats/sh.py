"""Real spherical harmonics up to degree 3, in the sign convention of the original 3DGS.

Conventions
-----------
* K = (degree + 1)^2 coefficients; coefficient l^2 + l + m belongs to band l, order m.
* The basis has the Condon-Shortley sign as 3DGS writes it: band 1 is (-y, z, -x) C1.
* Directions are unit vectors from the camera to the splat, in the frame of the splats.
* Colour = 0.5 + sum of coefficient times basis, clamped below at 0.
"""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor

from gscomplete.splats.record import SH_C0

_C1 = math.sqrt(3 / (4 * math.pi))
_C2_CROSS = math.sqrt(15 / (4 * math.pi))
_C2_ZONAL = math.sqrt(5 / (16 * math.pi))
_C3_EDGE = math.sqrt(35 / (32 * math.pi))
_C3_CROSS = math.sqrt(105 / (4 * math.pi))
_C3_SIDE = math.sqrt(21 / (32 * math.pi))
_C3_ZONAL = math.sqrt(7 / (16 * math.pi))


def sh_basis(directions: Tensor, degree: int) -> Tensor:  # [..., 3] unit -> [..., K]
    """Evaluate the basis functions.

    Args:
        directions: unit vectors [..., 3].
        degree: 0 to 3.

    Returns:
        Values [..., (degree + 1)^2], differentiable with respect to the directions.

    Raises:
        ValueError: the degree is not 0 to 3.
    """
    if degree not in (0, 1, 2, 3):
        raise ValueError(f"sh_basis: expected a degree of 0 to 3, found {degree}")
    x, y, z = directions.unbind(-1)
    values = [torch.full_like(x, SH_C0)]
    if degree >= 1:
        values += [-_C1 * y, _C1 * z, -_C1 * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        values += [
            _C2_CROSS * x * y,
            -_C2_CROSS * y * z,
            _C2_ZONAL * (2 * zz - xx - yy),
            -_C2_CROSS * x * z,
            _C2_CROSS / 2 * (xx - yy),
        ]
    if degree >= 3:
        values += [
            -_C3_EDGE * y * (3 * xx - yy),
            _C3_CROSS * x * y * z,
            -_C3_SIDE * y * (4 * zz - xx - yy),
            _C3_ZONAL * z * (2 * zz - 3 * xx - 3 * yy),
            -_C3_SIDE * x * (4 * zz - xx - yy),
            _C3_CROSS / 2 * z * (xx - yy),
            -_C3_EDGE * x * (xx - 3 * yy),
        ]
    return torch.stack(values, dim=-1)


def evaluate_sh(sh: Tensor, directions: Tensor) -> Tensor:  # [..., K, 3], [..., 3] -> [..., 3]
    """Sum the harmonics of three channels in given directions, without offset or clamp."""
    degree = math.isqrt(sh.shape[-2]) - 1
    return (sh_basis(directions, degree)[..., None] * sh).sum(dim=-2)


def sh_rotation(rotation: Tensor, degree: int) -> Tensor:  # [3, 3] -> [K, K] float64
    """Return the matrix D that rotates coefficients: c' = D c.

    The rotated function at R d equals the original at d. Each band turns within itself, so with
    basis values Y at enough directions d, D solves Y(d) D = Y(R^T d) exactly; the solution is
    found by least squares in float64, band by band (no cross-talk by rounding).

    Args:
        rotation: proper rotation matrix [3, 3].
        degree: 0 to 3.
    """
    rotation = rotation.detach().to("cpu", torch.float64)
    directions = _sample_directions()
    here = sh_basis(directions, degree)
    there = sh_basis(directions @ rotation, degree)  # rows: R^T d
    matrix = torch.zeros(here.shape[1], here.shape[1], dtype=torch.float64)
    for band in range(degree + 1):
        part = slice(band**2, (band + 1) ** 2)
        matrix[part, part] = torch.linalg.lstsq(here[:, part], there[:, part]).solution
    return matrix


@functools.cache
def _sample_directions() -> Tensor:  # [64, 3] float64
    """Directions spread evenly over the sphere (Fibonacci lattice)."""
    index = torch.arange(64, dtype=torch.float64)
    z = 1 - (2 * index + 1) / 64
    angle = index * math.pi * (3 - math.sqrt(5))
    radius = torch.sqrt(1 - z * z)
    return torch.stack([radius * torch.cos(angle), radius * torch.sin(angle), z], dim=1)


def rotate_sh(sh: Tensor, rotation: Tensor) -> Tensor:  # [N, K, 3], [3, 3] -> [N, K, 3]
    """Rotate coefficients so that ``rotate(f)(R d) = f(d)``, in the dtype of ``sh``."""
    if sh.shape[1] == 1:
        return sh
    matrix = sh_rotation(rotation, math.isqrt(sh.shape[1]) - 1).to(sh)
    return torch.einsum("jk,nkc->njc", matrix, sh)
