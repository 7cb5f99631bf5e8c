"""Project splats to the screen (one view): packed rows for ordering, binning and compositing."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from gscomplete.render.cpu.layout import (
    EDGE_SLACK,
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
from gscomplete.render.cpu.screen import FAST_KERNEL, screen_covariance
from gscomplete.render.cpu.spherical_harmonics import fill_basis
from gscomplete.render.settings import MAX_VALUE


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
    fx, fy, cx, cy, width, height, near, blur, alpha_min = (
        camera[12],
        camera[13],
        camera[14],
        camera[15],
        camera[16],
        camera[17],
        camera[18],
        camera[19],
        camera[20],
    )
    low_x, high_x = -cx / fx - EDGE_SLACK * width / fx, (width - cx + EDGE_SLACK * width) / fx
    low_y, high_y = -cy / fy - EDGE_SLACK * height / fy, (height - cy + EDGE_SLACK * height) / fy
    eye_x = -(camera[0] * camera[3] + camera[4] * camera[7] + camera[8] * camera[11])
    eye_y = -(camera[1] * camera[3] + camera[5] * camera[7] + camera[9] * camera[11])
    eye_z = -(camera[2] * camera[3] + camera[6] * camera[7] + camera[10] * camera[11])
    log_alpha_min = math.log(alpha_min)
    basis = np.empty(16, np.float64)
    for i in range(first, last):
        visible[i] = 0
        mx, my, mz = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
        z = camera[8] * mx + camera[9] * my + camera[10] * mz + camera[11]
        opacity = np.float64(opacities[i])
        if not (z > near and alpha_min <= opacity <= 1.0):
            continue
        x = camera[0] * mx + camera[1] * my + camera[2] * mz + camera[3]
        y = camera[4] * mx + camera[5] * my + camera[6] * mz + camera[7]
        a, b, c, det = screen_covariance(
            quaternions, scales, i, camera, x, y, z, low_x, high_x, low_y, high_y, blur
        )
        inverse_z = 1.0 / z
        u, v = fx * x * inverse_z + cx, fy * y * inverse_z + cy
        if offsets.shape[0] > 0:
            u += offsets[i, 0]
            v += offsets[i, 1]
        tau = 2.0 * (math.log(opacity) - log_alpha_min)
        half_w, half_h = math.sqrt(tau * a), math.sqrt(tau * c)
        on_screen = (
            u + half_w > 0.0 and u - half_w < width and v + half_h > 0.0 and v - half_h < height
        )
        drawable = max(a, c) < MAX_VARIANCE_PX2 and det > 0.0 and z < MAX_VALUE
        if not (on_screen and drawable):
            continue
        packed[i, P_U], packed[i, P_V] = u, v
        root_c, root_det = 1.0 / math.sqrt(c), 1.0 / math.sqrt(det)
        packed[i, P_LA] = c * root_c * root_det
        packed[i, P_LB] = -b * root_c * root_det
        packed[i, P_LC] = root_c
        packed[i, P_OPACITY] = opacity
        packed[i, P_DEPTH] = z
        depths[i] = z
        packed[i, P_HALF_H], packed[i, P_HALF_W] = half_h, half_w
        if bands > 1:
            dx, dy, dz = mx - eye_x, my - eye_y, mz - eye_z
            inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
            fill_basis(basis, bands, dx * inverse, dy * inverse, dz * inverse)
        else:
            basis[0] = 0.28209479177387814
        red = green = blue = 0.5
        for k in range(bands):
            red += basis[k] * sh[i, k, 0]
            green += basis[k] * sh[i, k, 1]
            blue += basis[k] * sh[i, k, 2]
        packed[i, P_RED], packed[i, P_GREEN] = max(red, 0.0), max(green, 0.0)
        packed[i, P_BLUE] = max(blue, 0.0)
        visible[i] = abs(red) < MAX_VALUE and abs(green) < MAX_VALUE and abs(blue) < MAX_VALUE
