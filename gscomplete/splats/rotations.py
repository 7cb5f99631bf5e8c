"""Rotations: quaternions (w, x, y, z) and matrices, from each other, directions and angles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gscomplete.util.arrays import Float32Array, Float64Array


def rotation_matrices(quaternions: Tensor) -> Tensor:  # [N, 4] wxyz -> [N, 3, 3]
    """Rotation matrices of quaternions, normalised first; a zero quaternion is the identity."""
    largest = quaternions.abs().amax(dim=1, keepdim=True)
    safe = torch.where(largest > 0, largest, 1.0)
    near_one = quaternions / safe  # squares of the raw values may leave the range of float32
    norm = near_one.norm(dim=1, keepdim=True)
    w, x, y, z = (near_one / torch.where(norm > 0, norm, 1.0)).unbind(1)
    rows = matrix_rows(w, x, y, z)
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


def matrix_rows(w: Any, x: Any, y: Any, z: Any) -> list[list[Any]]:
    """Return the rows of the rotation matrix of a unit quaternion: numbers, or arrays of them."""
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def thinnest_axes(quaternions: Tensor, scales: Tensor) -> Tensor:  # [N, 4], [N, 3] -> [N, 3]
    """Return the unit direction in which each splat is thinnest: a flat one's normal, unsigned."""
    columns = scales.argmin(dim=1)[:, None, None].expand(-1, 3, 1)
    return rotation_matrices(quaternions).gather(2, columns)[:, :, 0]


def quaternions_facing(normals: Tensor) -> Tensor:  # [N, 3] unit -> [N, 4] wxyz
    """Return quaternions that turn +z onto each normal or onto its opposite.

    Discs look the same from both sides, so normals are flipped to z >= 0 first: the shortest turn
    is then never near its singularity at -z.
    """
    upper = torch.where(normals[:, 2:] < 0, -normals, normals)
    zero = torch.zeros_like(upper[:, 0])
    parts = [1.0 + upper[:, 2], -upper[:, 1], upper[:, 0], zero]
    return torch.nn.functional.normalize(torch.stack(parts, dim=1), dim=1)


def turn_about_z(angle_rad: float) -> Float64Array:  # [3, 3]
    """Return the rotation about +z by an angle."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def turn_onto_z(direction: Float64Array) -> Float64Array:  # [3] unit -> [3, 3]
    """Return the shortest rotation that takes a direction to +z; half a turn about x from -z."""
    x, y, z = direction
    if z < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    skew = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.eye(3) + skew + skew @ skew / (1.0 + z)


def unit_quaternions(quaternions: Float32Array) -> Float32Array:  # [B, 4]
    """Normalise without overflow or underflow; zero quaternions become the identity."""
    columns = np.ascontiguousarray(quaternions.T)
    largest = np.abs(columns).max(axis=0)
    zero = largest == 0
    columns /= np.where(zero, 1, largest)
    columns[0, zero] = 1
    columns /= np.sqrt((columns * columns).sum(axis=0))
    return columns.T
