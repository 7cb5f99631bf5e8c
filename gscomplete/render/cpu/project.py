"""Project splats to the screen (one view): packed rows for ordering, binning and compositing."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from gscomplete.render.cpu.layout import (
    MAX_VARIANCE_PX2,
    P_BLUE,
    P_DEPTH,
    P_GREEN,
    P_HALF_H,
    P_HALF_W,
    P_LA,
    P_LB,
    P_LC,
    P_OPACITY,
    P_RED,
    P_U,
    P_V,
)
from gscomplete.render.cpu.screen import (
    FAST_KERNEL,
    FIRST_LANE,
    LANE_HELPER,
    LANES,
    PAST_LANES,
    blurred,
    camera_point,
    eye_and_limits,
    factor,
    natural_log,
    screen_rows,
)
from gscomplete.render.cpu.spherical_harmonics import C0, fill_basis
from gscomplete.render.settings import MAX_VALUE

_PLANES = 22
_MX, _MY, _MZ, _QW, _QX, _QY, _QZ, _SX, _SY, _SZ, _OPACITY = (
    np.uint64(k * LANES) for k in range(11)
)
"""Planes that are read."""
_U, _V, _LA, _LB, _LC, _HALF_H, _HALF_W, _Z, _DRAWN, _SHIFT_U, _SHIFT_V = (
    np.uint64(k * LANES) for k in range(11, _PLANES)
)
"""Planes that are computed; the last two are read, zeros where there are no offsets."""


@numba.njit(**FAST_KERNEL)
def project(
    first: int,
    last: int,
    means: Any,  # [N, 3] float32
    quaternions: Any,  # [N, 4]
    scales: Any,  # [N, 3]
    opacities: Any,  # [N]
    sh: Any,  # [N, K, 3]
    bands: int,  # the first of the K that are evaluated
    offsets: Any,  # [N, 2] pixels added to the projected centre, or [0, 2] for none
    camera: Any,  # 21 float64
    packed: Any,  # [N, PACKED] float32, written
    depths: Any,  # [N] float64, written
    visible: Any,  # [N] uint8, written
) -> None:
    """Project every splat; invisible ones get ``visible`` 0 and an untouched row."""
    (eye_x, eye_y, eye_z), limits = eye_and_limits(camera)
    basis = np.empty(16, np.float64)
    basis[0] = C0
    lanes = np.zeros(_PLANES * LANES, np.float64)
    for block in range(first, last, LANES):
        count = np.uint64(min(LANES, last - block))
        for p in range(FIRST_LANE, count):
            i = block + np.int64(p)
            lanes[_MX + p], lanes[_MY + p], lanes[_MZ + p] = means[i, 0], means[i, 1], means[i, 2]
            lanes[_QW + p], lanes[_QX + p] = quaternions[i, 0], quaternions[i, 1]
            lanes[_QY + p], lanes[_QZ + p] = quaternions[i, 2], quaternions[i, 3]
            lanes[_SX + p], lanes[_SY + p] = scales[i, 0], scales[i, 1]
            lanes[_SZ + p] = scales[i, 2]
            lanes[_OPACITY + p] = opacities[i]
            if offsets.shape[0] > 0:
                lanes[_SHIFT_U + p], lanes[_SHIFT_V + p] = offsets[i, 0], offsets[i, 1]
        _project_lanes(lanes, camera, limits)
        for p in range(FIRST_LANE, count):
            i = block + np.int64(p)
            visible[i] = 0
            if lanes[_DRAWN + p] == 0.0:
                continue
            packed[i, P_U], packed[i, P_V] = lanes[_U + p], lanes[_V + p]
            packed[i, P_LA], packed[i, P_LB] = lanes[_LA + p], lanes[_LB + p]
            packed[i, P_LC] = lanes[_LC + p]
            packed[i, P_OPACITY] = lanes[_OPACITY + p]
            packed[i, P_DEPTH] = lanes[_Z + p]
            depths[i] = lanes[_Z + p]
            packed[i, P_HALF_H], packed[i, P_HALF_W] = lanes[_HALF_H + p], lanes[_HALF_W + p]
            if bands > 1:
                dx, dy, dz = lanes[_MX + p] - eye_x, lanes[_MY + p] - eye_y, lanes[_MZ + p] - eye_z
                inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
                fill_basis(basis, bands, dx * inverse, dy * inverse, dz * inverse)
            red = green = blue = 0.5
            for k in range(bands):
                red += basis[k] * sh[i, k, 0]
                green += basis[k] * sh[i, k, 1]
                blue += basis[k] * sh[i, k, 2]
            packed[i, P_RED], packed[i, P_GREEN] = max(red, 0.0), max(green, 0.0)
            packed[i, P_BLUE] = max(blue, 0.0)
            visible[i] = abs(red) < MAX_VALUE and abs(green) < MAX_VALUE and abs(blue) < MAX_VALUE


@numba.njit(**LANE_HELPER)
def _project_lanes(lanes: Any, camera: Any, limits: Any) -> None:
    """Compute centre, whitening, depth and pixel box of every lane, and whether it is drawn."""
    fx, fy, cx, cy, width, height, near, blur, alpha_min = camera[12:21]
    log_alpha_min = math.log(alpha_min)
    for p in range(FIRST_LANE, PAST_LANES):
        x, y, z = camera_point(camera, lanes[_MX + p], lanes[_MY + p], lanes[_MZ + p])
        quaternion = lanes[_QW + p], lanes[_QX + p], lanes[_QY + p], lanes[_QZ + p]
        t, r, _, _ = screen_rows(quaternion, camera, (x, y, z), limits)
        scales = lanes[_SX + p], lanes[_SY + p], lanes[_SZ + p]
        a, b, c, det = blurred(factor(t, r, scales), blur)
        inverse_z = 1.0 / z
        u = fx * x * inverse_z + cx + lanes[_SHIFT_U + p]
        v = fy * y * inverse_z + cy + lanes[_SHIFT_V + p]
        opacity = lanes[_OPACITY + p]
        tau = max(2.0 * (natural_log(opacity) - log_alpha_min), 0.0)
        half_w, half_h = math.sqrt(tau * a), math.sqrt(tau * c)
        root_c, root_det = 1.0 / math.sqrt(c), 1.0 / math.sqrt(det)
        lanes[_U + p], lanes[_V + p], lanes[_Z + p] = u, v, z
        lanes[_LA + p] = c * root_c * root_det
        lanes[_LB + p] = -b * root_c * root_det
        lanes[_LC + p] = root_c
        lanes[_HALF_H + p], lanes[_HALF_W + p] = half_h, half_w
        seen = (z > near) & (z < MAX_VALUE) & (opacity >= alpha_min) & (opacity <= 1.0)
        seen &= (u + half_w > 0.0) & (u - half_w < width)
        seen &= (v + half_h > 0.0) & (v - half_h < height)
        seen &= (max(a, c) < MAX_VARIANCE_PX2) & (det > 0.0)
        lanes[_DRAWN + p] = 1.0 if seen else 0.0
