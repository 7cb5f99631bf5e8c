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
    P_BLUE,
    P_GREEN,
    P_LA,
    P_LB,
    P_LC,
    P_RED,
    S_BLUE,
    S_DEPTH,
    S_GREEN,
    S_POWER,
    S_RED,
    S_X,
    S_XX,
    S_XY,
    S_Y,
    S_YY,
    SUMS,
)
from gscomplete.render.cpu.screen import (
    FAST_KERNEL,
    FIRST_LANE,
    LANE_HELPER,
    LANES,
    PAST_LANES,
    camera_point,
    eye_and_limits,
    factor,
    screen_rows,
)
from gscomplete.render.cpu.spherical_harmonics import C0, basis_gradient, fill_basis

_PLANES = 24
_SUM_X, _SUM_Y, _SUM_XX, _SUM_XY, _SUM_YY, _SUM_DEPTH, _LA, _LB, _LC = (
    np.uint64(k * LANES) for k in range(9)
)
_MX, _MY, _MZ, _QW, _QX, _QY, _QZ, _SX, _SY, _SZ = (np.uint64(k * LANES) for k in range(9, 19))
"""Planes of the splat's fields: read, then overwritten by their gradients."""
_GU, _GV = (np.uint64(k * LANES) for k in range(19, 21))
"""Planes of the gradients of the screen centre."""
_RED, _GREEN, _BLUE = (np.uint64(k * LANES) for k in range(21, _PLANES))
"""Planes of the gradients of the colour."""


@numba.njit(**FAST_KERNEL)
def project_backward(
    first: int,
    last: int,
    is_first: bool,  # write gradients; else add to them
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
    grad_means: Any,  # [N, 3] float32
    grad_quaternions: Any,  # [N, 4]
    grad_scales: Any,  # [N, 3]
    grad_opacities: Any,  # [N]
    grad_sh: Any,  # [N, K, 3]
    grad_offsets: Any,  # [N, 2] written, or [0, 2]
) -> None:
    """Add one view's gradients of trainable splats, summing their tiles in a fixed order."""
    if is_first:
        for i in range(first, last):
            for k in range(3):
                grad_means[i, k] = grad_scales[i, k] = 0.0
            for k in range(4):
                grad_quaternions[i, k] = 0.0
            grad_opacities[i] = 0.0
            for k in range(sh.shape[1]):
                grad_sh[i, k, 0] = grad_sh[i, k, 1] = grad_sh[i, k, 2] = 0.0
    eye, limits = eye_and_limits(camera)
    basis = np.empty(16, np.float64)
    weights = np.empty(16, np.float64)
    total = np.empty(SUMS, np.float64)
    lanes = np.zeros(_PLANES * LANES, np.float64)
    places = np.empty(LANES, np.int64)
    count: Any = FIRST_LANE
    for i in range(first, last):
        if _add_sums(slot_start[i], slot_start[i + 1], summed, sums, total):
            p = count
            count += np.uint64(1)
            places[p] = i
            lanes[_SUM_X + p], lanes[_SUM_Y + p] = total[S_X], total[S_Y]
            lanes[_SUM_XX + p], lanes[_SUM_XY + p] = total[S_XX], total[S_XY]
            lanes[_SUM_YY + p], lanes[_SUM_DEPTH + p] = total[S_YY], total[S_DEPTH]
            lanes[_LA + p], lanes[_LB + p] = packed[i, P_LA], packed[i, P_LB]
            lanes[_LC + p] = packed[i, P_LC]
            lanes[_MX + p], lanes[_MY + p], lanes[_MZ + p] = means[i, 0], means[i, 1], means[i, 2]
            lanes[_QW + p], lanes[_QX + p] = quaternions[i, 0], quaternions[i, 1]
            lanes[_QY + p], lanes[_QZ + p] = quaternions[i, 2], quaternions[i, 3]
            lanes[_SX + p], lanes[_SY + p] = scales[i, 0], scales[i, 1]
            lanes[_SZ + p] = scales[i, 2]
            grad_opacities[i] += -total[S_POWER] / np.float64(opacities[i])
            lanes[_RED + p] = total[S_RED] if packed[i, P_RED] > 0.0 else 0.0
            lanes[_GREEN + p] = total[S_GREEN] if packed[i, P_GREEN] > 0.0 else 0.0
            lanes[_BLUE + p] = total[S_BLUE] if packed[i, P_BLUE] > 0.0 else 0.0
        elif grad_offsets.shape[0] > 0 and slot_start[i] < slot_start[i + 1]:
            grad_offsets[i, 0] = grad_offsets[i, 1] = 0.0
        if count < PAST_LANES and i < last - 1:
            continue
        _differentiate_lanes(lanes, camera, limits)
        for p in range(FIRST_LANE, count):
            k = places[p]
            grad_means[k, 0] += lanes[_MX + p]
            grad_means[k, 1] += lanes[_MY + p]
            grad_means[k, 2] += lanes[_MZ + p]
            grad_quaternions[k, 0] += lanes[_QW + p]
            grad_quaternions[k, 1] += lanes[_QX + p]
            grad_quaternions[k, 2] += lanes[_QY + p]
            grad_quaternions[k, 3] += lanes[_QZ + p]
            grad_scales[k, 0] += lanes[_SX + p]
            grad_scales[k, 1] += lanes[_SY + p]
            grad_scales[k, 2] += lanes[_SZ + p]
            if grad_offsets.shape[0] > 0:
                grad_offsets[k, 0], grad_offsets[k, 1] = lanes[_GU + p], lanes[_GV + p]
            upstream = lanes[_RED + p], lanes[_GREEN + p], lanes[_BLUE + p]
            _add_color_gradient(k, means, sh, eye, upstream, basis, weights, grad_means, grad_sh)
        count = FIRST_LANE


@numba.njit(**LANE_HELPER)
def _add_sums(start: int, stop: int, summed: Any, sums: Any, total: Any) -> Any:
    """Add the sums of a splat's tiles; return whether any is left: not so where it is hidden."""
    while start < stop and not summed[start]:
        start += 1
    if start == stop:
        return False
    for k in range(SUMS):
        total[k] = sums[start, k]
    for slot in range(start + 1, stop):
        if summed[slot]:
            for k in range(SUMS):
                total[k] += sums[slot, k]
    felt = 0.0
    for k in range(SUMS):
        felt += abs(total[k])
    return felt != 0.0


@numba.njit(**LANE_HELPER)
def _add_color_gradient(
    i: int,
    means: Any,
    sh: Any,
    eye: Any,
    upstream: Any,  # of red, green and blue
    basis: Any,
    weights: Any,
    grad_means: Any,
    grad_sh: Any,
) -> None:
    """Add the gradients of the harmonics, and those of the place that they are seen from."""
    bands = sh.shape[1]
    red, green, blue = upstream
    if bands == 1:
        grad_sh[i, 0, 0] += C0 * red
        grad_sh[i, 0, 1] += C0 * green
        grad_sh[i, 0, 2] += C0 * blue
        return
    dx = np.float64(means[i, 0]) - eye[0]
    dy = np.float64(means[i, 1]) - eye[1]
    dz = np.float64(means[i, 2]) - eye[2]
    inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
    fill_basis(basis, bands, dx, dy, dz)
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


@numba.njit(**LANE_HELPER)
def _differentiate_lanes(lanes: Any, camera: Any, limits: Any) -> None:
    """Turn the planes of centres, quaternions and scales into their gradients."""
    for p in range(FIRST_LANE, PAST_LANES):
        la, lb, lc = lanes[_LA + p], lanes[_LB + p], lanes[_LC + p]
        gu = -la * lanes[_SUM_X + p]
        gv = -(lb * lanes[_SUM_X + p] + lc * lanes[_SUM_Y + p])
        lanes[_GU + p], lanes[_GV + p] = gu, gv
        point = camera_point(camera, lanes[_MX + p], lanes[_MY + p], lanes[_MZ + p])
        quaternion = lanes[_QW + p], lanes[_QX + p], lanes[_QY + p], lanes[_QZ + p]
        s = lanes[_SX + p], lanes[_SY + p], lanes[_SZ + p]
        t, r, clamp, q = screen_rows(quaternion, camera, point, limits)
        f = factor(t, r, s)
        xx, xy, yy = lanes[_SUM_XX + p], lanes[_SUM_XY + p], lanes[_SUM_YY + p]
        gt, gm = _covariance_gradient(la, lb, lc, xx, xy, yy, f, t, r, s)
        lanes[_SX + p] = gm[0] * r[0] + gm[3] * r[3] + gm[6] * r[6]
        lanes[_SY + p] = gm[1] * r[1] + gm[4] * r[4] + gm[7] * r[7]
        lanes[_SZ + p] = gm[2] * r[2] + gm[5] * r[5] + gm[8] * r[8]
        gw, gx, gy, gz = _quaternion_gradient(gm, s, q)
        lanes[_QW + p], lanes[_QX + p], lanes[_QY + p], lanes[_QZ + p] = gw, gx, gy, gz
        gx, gy, gz = _center_gradient(gu, gv, lanes[_SUM_DEPTH + p], gt, t, clamp, camera, point)
        lanes[_MX + p] = camera[0] * gx + camera[4] * gy + camera[8] * gz
        lanes[_MY + p] = camera[1] * gx + camera[5] * gy + camera[9] * gz
        lanes[_MZ + p] = camera[2] * gx + camera[6] * gy + camera[10] * gz


@numba.njit(**LANE_HELPER)
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


@numba.njit(**LANE_HELPER)
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


@numba.njit(**LANE_HELPER)
def _center_gradient(
    gu: float,
    gv: float,
    g_depth: float,
    gt: Any,
    t: Any,
    clamp: Any,
    camera: Any,
    point: Any,
) -> Any:
    """Return dL/d(camera-space centre) through the screen centre, depth and Jacobian."""
    x, y, z = point
    ratio_x, ratio_y, free_x, free_y = clamp
    inverse_z = 1.0 / z
    jx, jy = camera[12] * inverse_z, camera[13] * inverse_z
    gx, gy = gu * jx, gv * jy
    gz = g_depth - gx * (x * inverse_z) - gy * (y * inverse_z)
    # T row 0 = (fx / z) (W0 - ratio W2): its gradient with respect to z and to the ratio.
    gz -= (gt[0] * t[0] + gt[1] * t[1] + gt[2] * t[2]) * inverse_z
    gz -= (gt[3] * t[3] + gt[4] * t[4] + gt[5] * t[5]) * inverse_z
    ratio_gx = -jx * (gt[0] * camera[8] + gt[1] * camera[9] + gt[2] * camera[10])
    ratio_gy = -jy * (gt[3] * camera[8] + gt[4] * camera[9] + gt[5] * camera[10])
    ratio_gx = ratio_gx * inverse_z if free_x else 0.0
    ratio_gy = ratio_gy * inverse_z if free_y else 0.0
    gz -= ratio_gx * ratio_x + ratio_gy * ratio_y
    return gx + ratio_gx, gy + ratio_gy, gz
