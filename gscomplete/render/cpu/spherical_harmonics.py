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
    """Return how many of the K bands a colour needs: those above have zeros only."""
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
def fill_basis_gradient(gradient: Any, bands: int, x: float, y: float, z: float) -> None:
    """Write d basis / d (x, y, z) into ``gradient`` [16, 3], as if x, y, z were independent."""
    for k in range(bands):
        gradient[k, 0] = 0.0
        gradient[k, 1] = 0.0
        gradient[k, 2] = 0.0
    if bands > 1:
        gradient[1, 1] = -C1
        gradient[2, 2] = C1
        gradient[3, 0] = -C1
    if bands > 4:
        gradient[4, 0], gradient[4, 1] = C20 * y, C20 * x
        gradient[5, 1], gradient[5, 2] = C21 * z, C21 * y
        gradient[6, 0], gradient[6, 1], gradient[6, 2] = (
            -2.0 * C22 * x,
            -2.0 * C22 * y,
            4.0 * C22 * z,
        )
        gradient[7, 0], gradient[7, 2] = C23 * z, C23 * x
        gradient[8, 0], gradient[8, 1] = 2.0 * C24 * x, -2.0 * C24 * y
    if bands > 9:
        gradient[9, 0] = 6.0 * C30 * x * y
        gradient[9, 1] = 3.0 * C30 * (x * x - y * y)
        gradient[10, 0], gradient[10, 1], gradient[10, 2] = C31 * y * z, C31 * x * z, C31 * x * y
        gradient[11, 0] = -2.0 * C32 * x * y
        gradient[11, 1] = C32 * (4.0 * z * z - x * x - 3.0 * y * y)
        gradient[11, 2] = 8.0 * C32 * y * z
        gradient[12, 0], gradient[12, 1] = -6.0 * C33 * x * z, -6.0 * C33 * y * z
        gradient[12, 2] = C33 * (6.0 * z * z - 3.0 * x * x - 3.0 * y * y)
        gradient[13, 0] = C34 * (4.0 * z * z - 3.0 * x * x - y * y)
        gradient[13, 1] = -2.0 * C34 * x * y
        gradient[13, 2] = 8.0 * C34 * x * z
        gradient[14, 0], gradient[14, 1] = 2.0 * C35 * x * z, -2.0 * C35 * y * z
        gradient[14, 2] = C35 * (x * x - y * y)
        gradient[15, 0] = 3.0 * C36 * (x * x - y * y)
        gradient[15, 1] = -6.0 * C36 * x * y
