"""Real spherical harmonics to degree 3 inside Numba kernels, with their derivatives.

The basis and its signs are those of the original 3DGS files. ``direction`` is the unit vector from
the camera to the splat. Arrays are filled in place so that a kernel allocates once per thread.
"""

from __future__ import annotations

from typing import Any

import numba

from gscomplete.util.kernels import HELPER, KERNEL

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C20, C21, C22, C23, C24 = (
    1.0925484305920792,
    -1.0925484305920792,
    0.31539156525252005,
    -1.0925484305920792,
    0.5462742152960396,
)
C30, C31, C32, C33, C34, C35, C36 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


@numba.njit(**KERNEL)
def used_bands(sh: Any) -> int:  # [N, K, 3]
    """Return how many of the K bands have to be evaluated: all coefficients above are zero."""
    bands = sh.shape[1]
    used = 1
    for i in range(sh.shape[0]):
        if used == bands:
            break
        for k in range(bands - 1, used - 1, -1):
            if sh[i, k, 0] != 0.0 or sh[i, k, 1] != 0.0 or sh[i, k, 2] != 0.0:
                used = 4 if k < 4 else 9 if k < 9 else 16
                break
    return used


@numba.njit(**HELPER)
def fill_basis(basis: Any, bands: int, x: float, y: float, z: float) -> None:
    """Write the first ``bands`` basis values at the unit direction (x, y, z)."""
    basis[0] = C0
    if bands > 1:
        basis[1] = -C1 * y
        basis[2] = C1 * z
        basis[3] = -C1 * x
    if bands > 4:
        basis[4] = C20 * x * y
        basis[5] = C21 * y * z
        basis[6] = C22 * (2.0 * z * z - x * x - y * y)
        basis[7] = C23 * x * z
        basis[8] = C24 * (x * x - y * y)
    if bands > 9:
        basis[9] = C30 * y * (3.0 * x * x - y * y)
        basis[10] = C31 * x * y * z
        basis[11] = C32 * y * (4.0 * z * z - x * x - y * y)
        basis[12] = C33 * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y)
        basis[13] = C34 * x * (4.0 * z * z - x * x - y * y)
        basis[14] = C35 * z * (x * x - y * y)
        basis[15] = C36 * x * (x * x - 3.0 * y * y)


@numba.njit(**HELPER)
def basis_gradient(weights: Any, bands: int, x: float, y: float, z: float) -> Any:
    """Return d (weights . basis) / d (x, y, z), as if x, y, z were independent."""
    w = weights
    gx = gy = gz = 0.0
    if bands > 1:
        gx, gy, gz = -C1 * w[3], -C1 * w[1], C1 * w[2]
    if bands > 4:
        gx += C20 * y * w[4] - 2.0 * C22 * x * w[6] + C23 * z * w[7] + 2.0 * C24 * x * w[8]
        gy += C20 * x * w[4] + C21 * z * w[5] - 2.0 * C22 * y * w[6] - 2.0 * C24 * y * w[8]
        gz += C21 * y * w[5] + 4.0 * C22 * z * w[6] + C23 * x * w[7]
    if bands > 9:
        xx, yy, zz = x * x, y * y, z * z
        xy, xz, yz = x * y, x * z, y * z
        gx += 6.0 * C30 * xy * w[9] + C31 * yz * w[10] - 2.0 * C32 * xy * w[11]
        gx += C34 * (4.0 * zz - 3.0 * xx - yy) * w[13] - 6.0 * C33 * xz * w[12]
        gx += 2.0 * C35 * xz * w[14] + 3.0 * C36 * (xx - yy) * w[15]
        gy += 3.0 * C30 * (xx - yy) * w[9] + C31 * xz * w[10]
        gy += C32 * (4.0 * zz - xx - 3.0 * yy) * w[11] - 6.0 * C33 * yz * w[12]
        gy -= 2.0 * (C34 * xy * w[13] + C35 * yz * w[14] + 3.0 * C36 * xy * w[15])
        gz += C31 * xy * w[10] + 8.0 * C32 * yz * w[11] + 8.0 * C34 * xz * w[13]
        gz += C33 * (6.0 * zz - 3.0 * xx - 3.0 * yy) * w[12] + C35 * (xx - yy) * w[14]
    return gx, gy, gz
