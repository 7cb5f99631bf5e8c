"""The voxel grid about the object frame, and splats in it.

Conventions
-----------
* A grid is a cube about the object frame's origin, of half side ``HALF_SIDE`` (object sizes), with
  ``CELLS`` cells along each axis; volumes are indexed [x, y, z]. The guessed frame of a part may be
  smaller than the whole: the cube reaches beyond it.
* ``COARSE_CELLS`` cells of twice the side are what the network's body works on.
* Colours are display-referred in [0, 1]; occupancy is the sum of opacities in a cell, at most 1.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from gscomplete.splats import Splats
from gscomplete.splats.rotations import rotation_matrices

HALF_SIDE = 0.72
CELLS = 48
COARSE_CELLS = CELLS // 2
CELL_SIDE = 2 * HALF_SIDE / CELLS

FloatArray = NDArray[np.float32]


def splat_arrays(
    splats: Splats,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return positions, tangents, opacities and colours as contiguous float32 arrays.

    Tangents [N, 2, 3] are the two longest axes of each splat, one standard deviation long.
    """
    axes = rotation_matrices(splats.quaternions.detach().float().cpu()).transpose(1, 2)
    scales = splats.scales.detach().float().cpu()
    longest = scales.argsort(dim=1, descending=True)[:, :2]
    picked = axes.gather(1, longest[:, :, None].expand(-1, -1, 3))
    tangents = picked * scales.gather(1, longest)[:, :, None]
    arrays = (
        splats.means.detach(),
        tangents,
        splats.opacities.detach(),
        splats.base_colors.detach().clamp(0, 1),
    )
    positions, along, opacities, colors = (
        np.ascontiguousarray(a.float().cpu().numpy()) for a in arrays
    )
    return positions, along, opacities, colors


@numba.njit(cache=True)
def fill_colored(
    positions: FloatArray,  # [N, 3]
    tangents: FloatArray,  # [N, 2, 3]
    opacities: FloatArray,  # [N]
    colors: FloatArray,  # [N, 3]
    cells: int,
) -> FloatArray:  # [4, cells, cells, cells]
    """Return occupancy and occupancy-weighted mean colour (0 where empty).

    Every splat counts at its centre and one standard deviation along its tangents, so that large
    splats leave no gaps.
    """
    volume = np.zeros((4, cells, cells, cells), np.float32)
    inverse = cells / (2 * HALF_SIDE)
    for n in range(len(positions)):
        if not opacities[n] > 0.02:
            continue
        for k in range(5):
            sign = 1.0 if k % 2 else -1.0
            axis = 0 if k <= 2 else 1
            reach = sign if k else 0.0
            x = positions[n, 0] + reach * tangents[n, axis, 0]
            y = positions[n, 1] + reach * tangents[n, axis, 1]
            z = positions[n, 2] + reach * tangents[n, axis, 2]
            fx = (x + HALF_SIDE) * inverse
            fy = (y + HALF_SIDE) * inverse
            fz = (z + HALF_SIDE) * inverse
            if not (0 <= fx < cells and 0 <= fy < cells and 0 <= fz < cells):
                continue
            i, j, l = int(fx), int(fy), int(fz)  # noqa: E741
            weight = opacities[n]
            volume[0, i, j, l] += weight
            for c in range(3):
                volume[1 + c, i, j, l] += weight * colors[n, c]
    for i in range(cells):
        for j in range(cells):
            for l in range(cells):  # noqa: E741
                total = volume[0, i, j, l]
                if total > 0:
                    for c in range(3):
                        volume[1 + c, i, j, l] /= total
                    volume[0, i, j, l] = min(total, np.float32(1.0))
    return volume


@numba.njit(cache=True)
def fill_shell(
    positions: FloatArray,  # [N, 3]
    tangents: FloatArray,  # [N, 2, 3]
    cells: int,
    reach: float,
) -> NDArray[np.uint8]:  # [cells, cells, cells]
    """Mark the cells that discs of radius ``reach`` standard deviations pass through."""
    marked = np.zeros((cells, cells, cells), np.uint8)
    inverse = cells / (2 * HALF_SIDE)
    for n in range(len(positions)):
        for a in range(-2, 3):
            for b in range(-2, 3):
                if a * a + b * b > 5:
                    continue
                u = 0.5 * reach * a
                v = 0.5 * reach * b
                fx = positions[n, 0] + u * tangents[n, 0, 0] + v * tangents[n, 1, 0] + HALF_SIDE
                fy = positions[n, 1] + u * tangents[n, 0, 1] + v * tangents[n, 1, 1] + HALF_SIDE
                fz = positions[n, 2] + u * tangents[n, 0, 2] + v * tangents[n, 1, 2] + HALF_SIDE
                fx, fy, fz = fx * inverse, fy * inverse, fz * inverse
                if 0 <= fx < cells and 0 <= fy < cells and 0 <= fz < cells:
                    marked[int(fx), int(fy), int(fz)] = 1
    return marked


@numba.njit(cache=True)
def fill_inside(shell: NDArray[np.uint8]) -> NDArray[np.uint8]:  # [n, n, n] -> [n, n, n]
    """Return the shell and everything that cannot be reached from the border without crossing it.

    Steps go through faces only. A cup's inside is outside; a ball's inside is inside.
    """
    n = shell.shape[0]
    state = shell.copy()  # 0 unknown, 1 shell, 2 outside
    stack = np.empty(n * n * n, np.int32)
    top = 0
    for a in range(n):
        for b in range(n):
            for face in range(6):
                if face == 0:
                    i, j, k = 0, a, b
                elif face == 1:
                    i, j, k = n - 1, a, b
                elif face == 2:
                    i, j, k = a, 0, b
                elif face == 3:
                    i, j, k = a, n - 1, b
                elif face == 4:
                    i, j, k = a, b, 0
                else:
                    i, j, k = a, b, n - 1
                if state[i, j, k] == 0:
                    state[i, j, k] = 2
                    stack[top] = (i * n + j) * n + k
                    top += 1
    while top > 0:
        top -= 1
        code = stack[top]
        i, j, k = code // (n * n), (code // n) % n, code % n
        for face in range(6):
            x = i + (1 if face == 0 else -1 if face == 1 else 0)
            y = j + (1 if face == 2 else -1 if face == 3 else 0)
            z = k + (1 if face == 4 else -1 if face == 5 else 0)
            if 0 <= x < n and 0 <= y < n and 0 <= z < n and state[x, y, z] == 0:
                state[x, y, z] = 2
                stack[top] = (x * n + y) * n + z
                top += 1
    for i in range(n):
        for j in range(n):
            for k in range(n):
                state[i, j, k] = 0 if state[i, j, k] == 2 else 1
    return state


def cell_centers(cells: int) -> FloatArray:  # [cells, cells, cells, 3]
    """Return the centres of all cells of a grid."""
    along = (np.arange(cells, dtype=np.float32) + 0.5) * (2 * HALF_SIDE / cells) - HALF_SIDE
    return np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1)
