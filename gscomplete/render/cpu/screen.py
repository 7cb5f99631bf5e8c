"""The geometry of one splat on the screen, shared by projection and its gradient.

Arithmetic is float64 per splat: the kernels are bound by memory, and needles, pancakes and splats
near the camera plane need the range. det(cov) comes from the cross product of the rows of J W M
(Cauchy-Binet), never from a c - b^2, so that needle splats keep a positive determinant.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from gscomplete.util.kernels import HELPER, KERNEL

_FAST = {"contract", "nsz", "arcp"}
FAST_KERNEL: dict[str, Any] = KERNEL | {"fastmath": _FAST}
"""Options of the projection kernels."""
FAST_HELPER: dict[str, Any] = HELPER | {"fastmath": _FAST}


@numba.njit(**FAST_HELPER)
def _rotation(w: float, x: float, y: float, z: float) -> Any:
    """Rotation matrix, row-major, of a unit quaternion."""
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


@numba.njit(**FAST_HELPER)
def _clamped_ratio(value: float, inverse_z: float, low: float, high: float) -> Any:
    """Return value / z, given 1 / z, clamped to [low, high] and whether it was inside."""
    ratio = value * inverse_z
    return min(max(ratio, low), high), low <= ratio <= high


@numba.njit(**FAST_HELPER)
def screen_rows(
    quaternions: Any,
    scales: Any,
    i: int,
    camera: Any,
    x: float,
    y: float,
    z: float,
    low_x: float,
    high_x: float,
    low_y: float,
    high_y: float,
) -> Any:
    """Return rows of T = J W [2, 3], of R [3, 3], scales, clamp flags and ratios."""
    qw, qx = np.float64(quaternions[i, 0]), np.float64(quaternions[i, 1])
    qy, qz = np.float64(quaternions[i, 2]), np.float64(quaternions[i, 3])
    norm2 = qw * qw + qx * qx + qy * qy + qz * qz
    inverse = 1.0 / math.sqrt(norm2) if norm2 > 0.0 else 0.0
    qw, qx, qy, qz = qw * inverse, qx * inverse, qy * inverse, qz * inverse
    rotation = _rotation(qw, qx, qy, qz)
    fx, fy = camera[12], camera[13]
    inverse_z = 1.0 / z
    ratio_x, free_x = _clamped_ratio(x, inverse_z, low_x, high_x)
    ratio_y, free_y = _clamped_ratio(y, inverse_z, low_y, high_y)
    jx, jy = fx * inverse_z, fy * inverse_z
    t00 = jx * (camera[0] - ratio_x * camera[8])
    t01 = jx * (camera[1] - ratio_x * camera[9])
    t02 = jx * (camera[2] - ratio_x * camera[10])
    t10 = jy * (camera[4] - ratio_y * camera[8])
    t11 = jy * (camera[5] - ratio_y * camera[9])
    t12 = jy * (camera[6] - ratio_y * camera[10])
    return (
        (t00, t01, t02, t10, t11, t12),
        rotation,
        (np.float64(scales[i, 0]), np.float64(scales[i, 1]), np.float64(scales[i, 2])),
        (ratio_x, ratio_y, free_x, free_y),
        (qw, qx, qy, qz, inverse),
    )


@numba.njit(**FAST_HELPER)
def factor(t: Any, r: Any, s: Any) -> Any:
    """Return the rows of A = T R diag(s), so that the screen covariance is A A^T + blur I."""
    a00 = (t[0] * r[0] + t[1] * r[3] + t[2] * r[6]) * s[0]
    a01 = (t[0] * r[1] + t[1] * r[4] + t[2] * r[7]) * s[1]
    a02 = (t[0] * r[2] + t[1] * r[5] + t[2] * r[8]) * s[2]
    a10 = (t[3] * r[0] + t[4] * r[3] + t[5] * r[6]) * s[0]
    a11 = (t[3] * r[1] + t[4] * r[4] + t[5] * r[7]) * s[1]
    a12 = (t[3] * r[2] + t[4] * r[5] + t[5] * r[8]) * s[2]
    return a00, a01, a02, a10, a11, a12


@numba.njit(**FAST_HELPER)
def _blurred(f: Any, blur: float) -> Any:
    """Return (a, b, c, det) of A A^T + blur I from the rows of A."""
    a = f[0] * f[0] + f[1] * f[1] + f[2] * f[2]
    b = f[0] * f[3] + f[1] * f[4] + f[2] * f[5]
    c = f[3] * f[3] + f[4] * f[4] + f[5] * f[5]
    m0, m1, m2 = (
        f[1] * f[5] - f[2] * f[4],
        f[2] * f[3] - f[0] * f[5],
        f[0] * f[4] - f[1] * f[3],
    )
    det = m0 * m0 + m1 * m1 + m2 * m2 + blur * (a + c) + blur * blur
    return a + blur, b, c + blur, det


@numba.njit(**FAST_HELPER)
def screen_covariance(
    quaternions: Any,
    scales: Any,
    i: int,
    camera: Any,
    x: float,
    y: float,
    z: float,
    low_x: float,
    high_x: float,
    low_y: float,
    high_y: float,
    blur: float,
) -> Any:
    """Return (a, b, c, det) of the blurred screen covariance of splat i."""
    t, r, s, _, _ = screen_rows(
        quaternions, scales, i, camera, x, y, z, low_x, high_x, low_y, high_y
    )
    return _blurred(factor(t, r, s), blur)
