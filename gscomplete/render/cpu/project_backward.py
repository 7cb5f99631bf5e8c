"""Carry screen gradients back to the splats (one view).

The sums that ``composite_backward`` wrote are added tile by tile in a fixed order, so gradients do
not depend on the number of threads.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from gscomplete.render.cpu.layout import (
    EDGE_SLACK,
    P_LA,
    P_LB,
    P_LC,
    P_RED,
    S_DEPTH,
    S_POWER,
    S_RED,
    S_X,
    S_XX,
    S_XY,
    S_Y,
    S_YY,
    SUMS,
)
from gscomplete.render.cpu.screen import FAST_HELPER, FAST_KERNEL, factor, screen_rows
from gscomplete.render.cpu.spherical_harmonics import basis_gradient, fill_basis


@numba.njit(**FAST_KERNEL)
def project_backward(
    first: int,
    last: int,
    means: Any,  # [N, 3]
    quaternions: Any,  # [N, 4]
    scales: Any,  # [N, 3]
    opacities: Any,  # [N]
    sh: Any,  # [N, K, 3]
    camera: Any,  # 21 float64
    packed: Any,  # [N, PACKED] rows of the forward pass
    slot_start: Any,  # [N + 1] int64: rows of ``sums`` that belong to each splat
    summed: Any,  # [slots] uint8 from composite_backward: 0 = the row of sums is not written
    sums: Any,  # [slots, SUMS] float32 from composite_backward
    grad_means: Any,  # [N, 3] float32, added to
    grad_quaternions: Any,  # [N, 4], added to
    grad_scales: Any,  # [N, 3], added to
    grad_opacities: Any,  # [N], added to
    grad_sh: Any,  # [N, K, 3], added to
    grad_offsets: Any,  # [N, 2] written, or [0, 2]
) -> None:
    """Add one view's gradients of trainable splats, summing their tiles in a fixed order."""
    bands = sh.shape[1]
    fx, fy, cx, cy, width, height = (
        camera[12],
        camera[13],
        camera[14],
        camera[15],
        camera[16],
        camera[17],
    )
    low_x, high_x = -cx / fx - EDGE_SLACK * width / fx, (width - cx + EDGE_SLACK * width) / fx
    low_y, high_y = -cy / fy - EDGE_SLACK * height / fy, (height - cy + EDGE_SLACK * height) / fy
    eye_x = -(camera[0] * camera[3] + camera[4] * camera[7] + camera[8] * camera[11])
    eye_y = -(camera[1] * camera[3] + camera[5] * camera[7] + camera[9] * camera[11])
    eye_z = -(camera[2] * camera[3] + camera[6] * camera[7] + camera[10] * camera[11])
    basis = np.empty(16, np.float64)
    weights = np.empty(16, np.float64)
    upstream = np.empty(3, np.float64)
    total = np.empty(SUMS, np.float64)
    for i in range(first, last):
        start, stop = slot_start[i], slot_start[i + 1]
        if start == stop:
            continue
        total[:] = 0.0
        for slot in range(start, stop):
            if summed[slot]:
                for k in range(SUMS):
                    total[k] += sums[slot, k]
        felt = 0.0
        for k in range(SUMS):
            felt += abs(total[k])
        if felt == 0.0:  # hidden, or seen only where nothing flows back
            if grad_offsets.shape[0] > 0:
                grad_offsets[i, 0] = grad_offsets[i, 1] = 0.0
            continue
        la, lb, lc = (
            np.float64(packed[i, P_LA]),
            np.float64(packed[i, P_LB]),
            np.float64(packed[i, P_LC]),
        )
        gu = -la * total[S_X]
        gv = -(lb * total[S_X] + lc * total[S_Y])
        if grad_offsets.shape[0] > 0:
            grad_offsets[i, 0] = gu
            grad_offsets[i, 1] = gv
        grad_opacities[i] += -total[S_POWER] / np.float64(opacities[i])
        mx, my, mz = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
        x = camera[0] * mx + camera[1] * my + camera[2] * mz + camera[3]
        y = camera[4] * mx + camera[5] * my + camera[6] * mz + camera[7]
        z = camera[8] * mx + camera[9] * my + camera[10] * mz + camera[11]
        t, r, s, clamp, q = screen_rows(
            quaternions, scales, i, camera, x, y, z, low_x, high_x, low_y, high_y
        )
        f = factor(t, r, s)
        gt, gm = _covariance_gradient(la, lb, lc, total[S_XX], total[S_XY], total[S_YY], f, t, r, s)
        for axis in range(3):
            grad_scales[i, axis] += (
                gm[axis] * r[axis] + gm[3 + axis] * r[3 + axis] + gm[6 + axis] * r[6 + axis]
            )
        gq = _quaternion_gradient(gm, s, q)
        for axis in range(4):
            grad_quaternions[i, axis] += gq[axis]
        gx, gy, gz = _center_gradient(gu, gv, total[S_DEPTH], gt, t, clamp, camera, x, y, z)
        grad_means[i, 0] += camera[0] * gx + camera[4] * gy + camera[8] * gz
        grad_means[i, 1] += camera[1] * gx + camera[5] * gy + camera[9] * gz
        grad_means[i, 2] += camera[2] * gx + camera[6] * gy + camera[10] * gz
        if bands == 1:
            for channel in range(3):
                if packed[i, P_RED + channel] > 0.0:
                    grad_sh[i, 0, channel] += 0.28209479177387814 * total[S_RED + channel]
            continue
        dx, dy, dz = mx - eye_x, my - eye_y, mz - eye_z
        inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
        fill_basis(basis, bands, dx, dy, dz)
        for channel in range(3):
            shown = packed[i, P_RED + channel] > 0.0
            upstream[channel] = total[S_RED + channel] if shown else 0.0
        red, green, blue = upstream[0], upstream[1], upstream[2]
        for k in range(bands):
            grad_sh[i, k, 0] += basis[k] * red
            grad_sh[i, k, 1] += basis[k] * green
            grad_sh[i, k, 2] += basis[k] * blue
            weights[k] = red * sh[i, k, 0] + green * sh[i, k, 1] + blue * sh[i, k, 2]
        gdx, gdy, gdz = basis_gradient(weights, bands, dx, dy, dz)
        along = gdx * dx + gdy * dy + gdz * dz
        grad_means[i, 0] += (gdx - along * dx) * inverse
        grad_means[i, 1] += (gdy - along * dy) * inverse
        grad_means[i, 2] += (gdz - along * dz) * inverse


@numba.njit(**FAST_HELPER)
def _covariance_gradient(
    la: float,
    lb: float,
    lc: float,
    sxx: float,
    sxy: float,
    syy: float,
    f: Any,
    t: Any,
    r: Any,
    s: Any,
) -> Any:
    """Return dL/dT [2, 3] (through the covariance) and dL/dM [3, 3], M = R diag(s)."""
    # dL/dcov = -L^T S L / 2 with S = [[sxx, sxy], [sxy, syy]]; dL/dA = 2 (dL/dcov) A.
    p00, p01 = sxx * la, sxx * lb + sxy * lc
    p11 = sxy * lb + syy * lc
    h00, h01, h11 = -la * p00, -la * p01, -(lb * p01 + lc * p11)
    g00, g01, g02 = h00 * f[0] + h01 * f[3], h00 * f[1] + h01 * f[4], h00 * f[2] + h01 * f[5]
    g10, g11, g12 = h01 * f[0] + h11 * f[3], h01 * f[1] + h11 * f[4], h01 * f[2] + h11 * f[5]
    w0, w1, w2 = s[0], s[1], s[2]
    gt = (
        g00 * r[0] * w0 + g01 * r[1] * w1 + g02 * r[2] * w2,
        g00 * r[3] * w0 + g01 * r[4] * w1 + g02 * r[5] * w2,
        g00 * r[6] * w0 + g01 * r[7] * w1 + g02 * r[8] * w2,
        g10 * r[0] * w0 + g11 * r[1] * w1 + g12 * r[2] * w2,
        g10 * r[3] * w0 + g11 * r[4] * w1 + g12 * r[5] * w2,
        g10 * r[6] * w0 + g11 * r[7] * w1 + g12 * r[8] * w2,
    )
    gm = (
        t[0] * g00 + t[3] * g10,
        t[0] * g01 + t[3] * g11,
        t[0] * g02 + t[3] * g12,
        t[1] * g00 + t[4] * g10,
        t[1] * g01 + t[4] * g11,
        t[1] * g02 + t[4] * g12,
        t[2] * g00 + t[5] * g10,
        t[2] * g01 + t[5] * g11,
        t[2] * g02 + t[5] * g12,
    )
    return gt, gm


@numba.njit(**FAST_HELPER)
def _quaternion_gradient(gm: Any, s: Any, q: Any) -> Any:
    """Return dL/d(raw quaternion) from dL/dM, through R and the normalisation."""
    w, x, y, z, inverse = q
    g00, g01, g02 = gm[0] * s[0], gm[1] * s[1], gm[2] * s[2]
    g10, g11, g12 = gm[3] * s[0], gm[4] * s[1], gm[5] * s[2]
    g20, g21, g22 = gm[6] * s[0], gm[7] * s[1], gm[8] * s[2]
    gw = 2.0 * (x * (g21 - g12) + y * (g02 - g20) + z * (g10 - g01))
    gx = 2.0 * (w * (g21 - g12) + y * (g01 + g10) + z * (g02 + g20) - 2.0 * x * (g11 + g22))
    gy = 2.0 * (w * (g02 - g20) + x * (g01 + g10) + z * (g12 + g21) - 2.0 * y * (g00 + g22))
    gz = 2.0 * (w * (g10 - g01) + x * (g02 + g20) + y * (g12 + g21) - 2.0 * z * (g00 + g11))
    along = gw * w + gx * x + gy * y + gz * z
    return (
        (gw - along * w) * inverse,
        (gx - along * x) * inverse,
        (gy - along * y) * inverse,
        (gz - along * z) * inverse,
    )


@numba.njit(**FAST_HELPER)
def _center_gradient(
    gu: float,
    gv: float,
    g_depth: float,
    gt: Any,
    t: Any,
    clamp: Any,
    camera: Any,
    x: float,
    y: float,
    z: float,
) -> Any:
    """Return dL/d(camera-space centre) through the screen centre, depth and Jacobian."""
    fx, fy = camera[12], camera[13]
    ratio_x, ratio_y, free_x, free_y = clamp
    jx, jy = fx / z, fy / z
    gx, gy = gu * jx, gv * jy
    gz = g_depth - gu * jx * (x / z) - gv * jy * (y / z)
    # T row 0 = (fx / z) (W0 - ratio W2): its gradient with respect to z and to the ratio.
    gz -= (gt[0] * t[0] + gt[1] * t[1] + gt[2] * t[2]) / z
    gz -= (gt[3] * t[3] + gt[4] * t[4] + gt[5] * t[5]) / z
    if free_x:
        g_ratio = -jx * (gt[0] * camera[8] + gt[1] * camera[9] + gt[2] * camera[10])
        gx += g_ratio / z
        gz -= g_ratio * ratio_x / z
    if free_y:
        g_ratio = -jy * (gt[3] * camera[8] + gt[4] * camera[9] + gt[5] * camera[10])
        gy += g_ratio / z
        gz -= g_ratio * ratio_y / z
    return gx, gy, gz
