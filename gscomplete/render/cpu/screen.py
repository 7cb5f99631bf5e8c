"""The geometry of a splat on the screen, shared by projection and its gradient.

Both take LANES splats at a time, in three loops. The first reads their fields into the planes of a
flat float64 buffer (lane p of plane k is at k * LANES + p). The second computes all lanes without
branches or calls, so that LLVM turns it into vector code (a quarter of the time of one splat after
another); the functions that it uses are inlined, and conditions become numbers. The third writes
the results.

Arithmetic is float64: needles, pancakes and splats near the camera plane need the range. det(cov)
comes from the cross product of the rows of J W M (Cauchy-Binet), never from a c - b^2, so that
needle splats keep a positive determinant.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from gscomplete.render.cpu.layout import EDGE_SLACK
from gscomplete.util.kernels import HELPER, KERNEL

LANES = 64
"""Splats that are computed side by side."""
FIRST_LANE, PAST_LANES = np.uint64(0), np.uint64(LANES)
"""Lanes are counted without a sign: see ``composite``."""
_LOG_2 = math.log(2.0)
_ROOT_2 = math.sqrt(2.0)
_MANTISSA = np.int64((1 << 52) - 1)
_ONE_BITS = np.int64(1023 << 52)

_FAST = {"contract", "nsz", "arcp"}
FAST_KERNEL: dict[str, Any] = KERNEL | {"fastmath": _FAST}
"""Options of the projection kernels."""
LANE_HELPER: dict[str, Any] = HELPER | {"fastmath": _FAST, "forceinline": True}
"""Of what is called for every lane."""


@numba.njit(**LANE_HELPER)
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


@numba.njit(**LANE_HELPER)
def natural_log(x: float) -> Any:
    """Return log(x) of a positive normal number, within 2e-14; libm's log would not vectorise."""
    bits = np.float64(x).view(np.int64)
    mantissa = np.int64((bits & _MANTISSA) | _ONE_BITS).view(np.float64)
    large = mantissa > _ROOT_2
    mantissa = 0.5 * mantissa if large else mantissa
    exponent = np.float64((bits >> np.int64(52)) - np.int64(1023)) + (1.0 if large else 0.0)
    t = (mantissa - 1.0) / (mantissa + 1.0)  # log(m) = 2 artanh(t), |t| < 0.172
    t2 = t * t
    rest = 1 / 7 + t2 * (1 / 9 + t2 * (1 / 11 + t2 * (1 / 13 + t2 * (1 / 15))))
    return exponent * _LOG_2 + 2.0 * t * (1.0 + t2 * (1 / 3 + t2 * (1 / 5 + t2 * rest)))


@numba.njit(**LANE_HELPER)
def eye_and_limits(camera: Any) -> Any:
    """Return the camera's centre in the world, and limits of x / z and y / z in Jacobians."""
    fx, fy, cx, cy, width, height = camera[12:18]
    low_x, high_x = -cx / fx - EDGE_SLACK * width / fx, (width - cx + EDGE_SLACK * width) / fx
    low_y, high_y = -cy / fy - EDGE_SLACK * height / fy, (height - cy + EDGE_SLACK * height) / fy
    eye_x = -(camera[0] * camera[3] + camera[4] * camera[7] + camera[8] * camera[11])
    eye_y = -(camera[1] * camera[3] + camera[5] * camera[7] + camera[9] * camera[11])
    eye_z = -(camera[2] * camera[3] + camera[6] * camera[7] + camera[10] * camera[11])
    return (eye_x, eye_y, eye_z), (low_x, high_x, low_y, high_y)


@numba.njit(**LANE_HELPER)
def camera_point(camera: Any, mx: float, my: float, mz: float) -> Any:
    """Return a point of the world in camera axes."""
    return (
        camera[0] * mx + camera[1] * my + camera[2] * mz + camera[3],
        camera[4] * mx + camera[5] * my + camera[6] * mz + camera[7],
        camera[8] * mx + camera[9] * my + camera[10] * mz + camera[11],
    )


@numba.njit(**LANE_HELPER)
def _clamped_ratio(value: float, inverse_z: float, low: float, high: float) -> Any:
    """Return value / z, given 1 / z, clamped to [low, high] and whether it was inside."""
    ratio = value * inverse_z
    return min(max(ratio, low), high), low <= ratio <= high


@numba.njit(**LANE_HELPER)
def screen_rows(quaternion: Any, camera: Any, point: Any, limits: Any) -> Any:
    """Return rows of T = J W [2, 3] and R [3, 3], ratios, clamp flags and the unit quaternion.

    The unit quaternion is followed by the factor that normalised it.
    """
    qw, qx, qy, qz = quaternion
    x, y, z = point
    low_x, high_x, low_y, high_y = limits
    norm2 = qw * qw + qx * qx + qy * qy + qz * qz
    inverse = 1.0 / math.sqrt(norm2) if norm2 > 0.0 else 0.0
    qw, qx, qy, qz = qw * inverse, qx * inverse, qy * inverse, qz * inverse
    inverse_z = 1.0 / z
    ratio_x, free_x = _clamped_ratio(x, inverse_z, low_x, high_x)
    ratio_y, free_y = _clamped_ratio(y, inverse_z, low_y, high_y)
    jx, jy = camera[12] * inverse_z, camera[13] * inverse_z
    t = (
        jx * (camera[0] - ratio_x * camera[8]),
        jx * (camera[1] - ratio_x * camera[9]),
        jx * (camera[2] - ratio_x * camera[10]),
        jy * (camera[4] - ratio_y * camera[8]),
        jy * (camera[5] - ratio_y * camera[9]),
        jy * (camera[6] - ratio_y * camera[10]),
    )
    flags = (ratio_x, ratio_y, free_x, free_y)
    return t, _rotation(qw, qx, qy, qz), flags, (qw, qx, qy, qz, inverse)


@numba.njit(**LANE_HELPER)
def factor(t: Any, r: Any, s: Any) -> Any:
    """Return the rows of A = T R diag(s), so that the screen covariance is A A^T + blur I."""
    a00 = (t[0] * r[0] + t[1] * r[3] + t[2] * r[6]) * s[0]
    a01 = (t[0] * r[1] + t[1] * r[4] + t[2] * r[7]) * s[1]
    a02 = (t[0] * r[2] + t[1] * r[5] + t[2] * r[8]) * s[2]
    a10 = (t[3] * r[0] + t[4] * r[3] + t[5] * r[6]) * s[0]
    a11 = (t[3] * r[1] + t[4] * r[4] + t[5] * r[7]) * s[1]
    a12 = (t[3] * r[2] + t[4] * r[5] + t[5] * r[8]) * s[2]
    return a00, a01, a02, a10, a11, a12


@numba.njit(**LANE_HELPER)
def blurred(f: Any, blur: float) -> Any:
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
