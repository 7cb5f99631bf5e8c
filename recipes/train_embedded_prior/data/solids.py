"""The cells that a complete object fills: what the shape network learns to predict.

Conventions
-----------
* A cell is filled if the surface passes through it or if it is inside. Inside are cells that cannot
  be reached from the grid's border. Objects may have gaps of up to ``2 * _CLOSING`` cells (a
  bottle's neck, a missing base): then the space that cannot be reached once the gaps are closed is
  inside, and so are the cells between that space and the surface. A gap between two legs, however
  narrow, stays empty.
* The grid is that of ``gscomplete.shape.voxels``.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gscomplete.shape.voxels import CELLS, HALF_SIDE
from gscomplete.util.arrays import Float32Array

_CLOSING = 2
"""Steps of one cell that the surface is grown by, at most, to close its gaps."""


def solid_cells(positions: Float32Array, tangents: Float32Array) -> NDArray[np.uint8]:  # [C, C, C]
    """Return 1 where a complete object fills its cell, from its splats."""
    shell = fill_shell(positions, tangents, CELLS, 1.2)
    solid = fill_inside(shell) > 0
    for steps in range(1, _CLOSING + 1):
        near = _grow(shell, steps)
        reached = (1 - fill_inside(near)).astype(np.uint8)
        room = (reached == 0) & (near == 0)
        if room.any():
            within = (_grow(reached, steps) == 0) & (shell == 0)
            # A corner is as many steps away along each axis, and steps go along axes.
            solid |= ndimage.binary_dilation(room, iterations=3 * steps, mask=within)
    return solid.astype(np.uint8)


def _grow(mask: NDArray[np.uint8], cells: int) -> NDArray[np.uint8]:
    grown: NDArray[np.uint8] = ndimage.maximum_filter(mask, size=2 * cells + 1, mode="nearest")
    return grown


@numba.njit(cache=True)
def fill_shell(
    positions: Float32Array,  # [N, 3]
    tangents: Float32Array,  # [N, 2, 3]
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
