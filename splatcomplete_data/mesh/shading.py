"""Colours of cells of a mesh: what their splats are to show.

Conventions
-----------
* Colours are sRGB in [0, 1], the mean of four texture look-ups spread over the cell: a splat shows
  the average of what it covers, not one texel of it.
* Textures repeat; their rows run from the top, v from the bottom.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from gscomplete.util.arrays import Float32Array, IntArray
from splatcomplete_data.mesh.cells import Cells
from splatcomplete_data.mesh.files.parts import MeshPart


def shade_cells(parts: tuple[MeshPart, ...], cells: Cells) -> Float32Array:  # [N, 4]
    """Return the mean sRGB colour and alpha of every cell."""
    rgba = np.ones((len(cells.triangle), 4), np.float32)
    nothing = np.zeros((0, 3, 2), np.float32)
    blank = np.ones((1, 1, 4), np.float32)
    first = 0
    for part in parts:
        last = first + len(part.vertices)
        chosen = np.flatnonzero((cells.triangle >= first) & (cells.triangle < last))
        uv, texture = part.uv, part.texture
        if uv is None or texture is None:
            uv, texture = nothing, blank
        _shade(
            chosen,
            cells.triangle,
            first,
            cells.weights,
            cells.steps,
            part.colors,
            uv,
            texture,
            rgba,
        )
        if part.alpha != 1.0:
            rgba[chosen, 3] *= part.alpha
        first = last
    return np.clip(rgba, 0.0, 1.0)


@numba.njit(cache=True, parallel=True)
def _shade(
    chosen: IntArray,  # [M] cells of this part
    triangle: IntArray,  # [N]
    first: int,
    weights: Float32Array,  # [N, 3]
    steps: Float32Array,  # [N, 2, 3]
    colors: Float32Array,  # [T, 3, 3]
    uv: Float32Array,  # [T, 3, 2], or [0, 3, 2] without texture
    texture: Float32Array,  # [H, W, 4]
    rgba: Float32Array,  # [N, 4] out
) -> None:
    """Corner colours at the middle, times the mean of four texture look-ups."""
    height, width = texture.shape[:2]
    for k in numba.prange(len(chosen)):
        n = chosen[k]
        t = triangle[n] - first
        for channel in range(3):
            total = np.float32(0.0)
            for corner in range(3):
                total += weights[n, corner] * colors[t, corner, channel]
            rgba[n, channel] = total
        rgba[n, 3] = 1.0
        if len(uv) == 0:
            continue
        mean = np.zeros(4, np.float32)
        for tap in range(4):
            sx = np.float32(1.0 if tap & 1 else -1.0)
            sy = np.float32(1.0 if tap & 2 else -1.0)
            u, v = 0.0, 0.0
            for corner in range(3):
                w = weights[n, corner] + sx * steps[n, 0, corner] + sy * steps[n, 1, corner]
                u += w * uv[t, corner, 0]
                v += w * uv[t, corner, 1]
            if not (abs(u) < 1e6 and abs(v) < 1e6):
                u, v = 0.0, 0.0
            x, y = u * width - 0.5, (1.0 - v) * height - 0.5
            column, row = math.floor(x), math.floor(y)
            fx, fy = np.float32(x - column), np.float32(y - row)
            left, top = int(column) % width, int(row) % height
            right, bottom = (left + 1) % width, (top + 1) % height
            for channel in range(4):
                upper = texture[top, left, channel] * (1 - fx) + texture[top, right, channel] * fx
                lower = (
                    texture[bottom, left, channel] * (1 - fx) + texture[bottom, right, channel] * fx
                )
                mean[channel] += np.float32(0.25) * (upper * (1 - fy) + lower * fy)
        for channel in range(4):
            rgba[n, channel] *= mean[channel]
