"""Composite tile lists front to back (one view); ``composite_backward`` has the gradients.

Conventions
-----------
* A picture is three float32 arrays: premultiplied colour [H, W, 3], expected depth [H, W] (0 where
  nothing is drawn) and alpha [H, W]. Pixel k of a tile is at row k // TILE, column k % TILE; pixels
  of a tile beyond the picture are drawn but not stored.
* A tile's per-pixel state lives in one flat float32 buffer, plane after plane (``B_*``): inner
  loops run over contiguous floats, and LLVM can tell that the planes do not overlap.
* With F frozen rows, an entry e < F refers to frozen row e, any other to row e - F of ``rows``.
* Rows are read a batch ahead: a tile's rows are scattered over megabytes. Many reads issued at once
  take the time of one, whereas each read in the middle of compositing would stall it.
* Only the tiles listed in ``active`` are drawn; tiles do not depend on each other.
* Inner loops have no branches and no calls: alphas below the threshold are multiplied by zero, and
  ``exp`` is a polynomial, so that LLVM turns them into vector code.
* A tile stops once all its pixels' transmittances are below ``transmittance_min``; ``done`` keeps
  how many entries were drawn.
* Hidden entries, whose weights w sum to less than HIDDEN times ``transmittance_min`` times their
  opacity, are drawn; ``contributes`` marks the others. Many discs smaller than pixels are hidden.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from gscomplete.render.cpu.layout import (
    P_BLUE,
    P_DEPTH,
    P_GREEN,
    P_HALF_H,
    P_LA,
    P_LB,
    P_LC,
    P_OPACITY,
    P_RED,
    P_U,
    P_V,
    PACKED,
)
from gscomplete.render.cpu.tiles import TILE
from gscomplete.util.kernels import HELPER, KERNEL

PIXELS = TILE * TILE
B_X, B_Y, B_THROUGH, B_0, B_1, B_2, B_3, B_4, B_5 = (np.uint64(k * PIXELS) for k in range(9))
"""Offsets in a tile's buffer: pixel centre, transmittance, then accumulators (forward: the colour
and depth sums) or upstream gradients and the sum of w_j A_j not yet passed (backward). Unsigned,
as all pixel indices are: a signed index may be negative in Python, and the test for it stops LLVM
from vectorising the loop."""
FIRST, LAST = np.uint64(0), np.uint64(PIXELS)
BATCH = 128
"""Rows that are copied side by side before they are drawn."""
STOP_EVERY = 8
"""Entries between two looks at a tile's largest transmittance."""
HIDDEN = np.float32(0.1)
"""At 1 the error of opacities' gradients is four times as large, at 0.1 no larger than without."""
MAX_POWER = 12.0
"""Exponents are clamped here; exp(-12) = 6e-6 is below the smallest alpha_min allowed (1e-5)."""

# Minimax-like (Chebyshev) polynomial of exp(-x) on [0, 0.75], then four squarings:
# exp(-p) = exp(-p / 16)^16 for p in [0, 12]. Relative error below 2e-6 (tests compare with exp).
_E0, _E1, _E2, _E3, _E4, _E5, _E6 = (
    float(c)
    for c in np.polynomial.chebyshev.Chebyshev.interpolate(
        lambda x: np.exp(-x), 6, domain=[0.0, 0.75]
    )
    .convert(kind=np.polynomial.Polynomial)
    .coef
)
E0, E1, E2, E3 = np.float32(_E0), np.float32(_E1), np.float32(_E2), np.float32(_E3)
E4, E5, E6 = np.float32(_E4), np.float32(_E5), np.float32(_E6)

_FAST = {"contract", "nsz", "arcp", "reassoc", "afn"}
TILE_KERNEL: dict[str, Any] = KERNEL | {"fastmath": _FAST, "boundscheck": False}
"""Options of the compositing kernels."""
TILE_HELPER: dict[str, Any] = HELPER | {"fastmath": _FAST, "boundscheck": False}


@numba.njit(**TILE_HELPER)
def exp_neg(power: Any) -> Any:
    """Return exp(-power) for power in [0, 12] in float32 arithmetic."""
    x = power * np.float32(1.0 / 16.0)
    y = E0 + x * (E1 + x * (E2 + x * (E3 + x * (E4 + x * (E5 + x * E6)))))
    y = y * y
    y = y * y
    y = y * y
    return y * y


@numba.njit(**TILE_HELPER)
def pixel_rows(v: Any, half_h: Any, tile_y: int) -> Any:
    """Return the pixels a splat reaches: whole pairs of rows, so a multiple of 16."""
    top = v - half_h - np.float32(tile_y * TILE) - np.float32(0.51)
    bottom = v + half_h - np.float32(tile_y * TILE) - np.float32(0.49)
    first = int(max(min(top, np.float32(TILE)), np.float32(0.0))) & ~1
    last = (int(max(min(bottom, np.float32(TILE - 1)), np.float32(0.0))) | 1) + 1
    return np.uint64(first * TILE), np.uint64(last * TILE)


@numba.njit(**TILE_HELPER)
def start_tile(buffer: Any, tile: int, tiles_x: int) -> None:
    """Write pixel centres, full transmittance and empty sums into a tile's buffer."""
    for p in range(FIRST, LAST):
        row, column = np.int64(p) // TILE, np.int64(p) % TILE
        buffer[B_X + p] = np.float32((tile % tiles_x) * TILE + column) + np.float32(0.5)
        buffer[B_Y + p] = np.float32((tile // tiles_x) * TILE + row) + np.float32(0.5)
        buffer[B_THROUGH + p] = np.float32(1.0)
    for k in range(B_0, B_4):
        buffer[k] = np.float32(0.0)


@numba.njit(**TILE_HELPER)
def _store_tile(buffer: Any, tile: int, tiles_x: int, color: Any, depth: Any, alpha: Any) -> None:
    """Write a finished tile into the picture."""
    top, left = tile // tiles_x * TILE, tile % tiles_x * TILE
    for row in range(min(TILE, alpha.shape[0] - top)):
        for column in range(min(TILE, alpha.shape[1] - left)):
            p = np.uint64(row * TILE + column)
            y, x = top + row, left + column
            color[y, x, 0] = buffer[B_0 + p]
            color[y, x, 1] = buffer[B_1 + p]
            color[y, x, 2] = buffer[B_2 + p]
            drawn = np.float32(1.0) - buffer[B_THROUGH + p]
            alpha[y, x] = drawn
            depth[y, x] = buffer[B_3 + p] / drawn if drawn > np.float32(0.0) else np.float32(0.0)


@numba.njit(**TILE_KERNEL)
def composite(
    first: int,
    last: int,
    frozen_rows: Any,  # [F, PACKED]
    rows: Any,  # [M, PACKED]
    tile_start: Any,  # [tiles + 1]
    entries: Any,  # [E] places in the frozen rows followed by the rows
    active: Any,  # [A] tiles to draw
    shares: Any,  # [S + 1] runs of ``active`` that are about the same work
    tiles_x: int,
    alpha_min: Any,  # float32
    alpha_max: Any,
    transmittance_min: Any,
    color: Any,  # [H, W, 3] written in active tiles, as depth and alpha
    depth: Any,  # [H, W]
    alpha: Any,  # [H, W]
    done: Any,  # [tiles] int32, written for active tiles: how many entries were drawn
    contributes: Any,  # [E] uint8, written for drawn entries: 0 = hidden; or [0] if unused
) -> None:
    """Draw the active tiles."""
    buffer = np.empty(7 * PIXELS, np.float32)
    batch = np.empty((BATCH, PACKED), np.float32)
    for share in range(first, last):
        for k in range(shares[share], shares[share + 1]):
            tile = active[k]
            start_tile(buffer, tile, tiles_x)
            done[tile] = _tile_forward(
                frozen_rows,
                rows,
                entries,
                tile_start[tile],
                tile_start[tile + 1],
                tile // tiles_x,
                alpha_min,
                alpha_max,
                transmittance_min,
                buffer,
                batch,
                contributes,
            )
            _store_tile(buffer, tile, tiles_x, color, depth, alpha)


@numba.njit(**TILE_HELPER)
def read_rows(frozen_rows: Any, rows: Any, entries: Any, first: int, last: int, batch: Any) -> None:
    """Copy the rows of the entries from ``first`` up to ``last`` side by side.

    A first loop only reads each row, which brings it into the cache: such a loop has more reads in
    flight at once than one that copies.
    """
    frozen = frozen_rows.shape[0]
    touched = np.float32(0.0)
    for e in range(first, last):
        k = entries[e]
        if k < frozen:
            touched += frozen_rows[k, 0] + frozen_rows[k, PACKED - 1]
        else:
            touched += rows[k - frozen, 0] + rows[k - frozen, PACKED - 1]
    batch[0, 0] = touched  # overwritten below; keeps the loop from being removed
    for e in range(first, last):
        k = entries[e]
        if k < frozen:
            for column in range(PACKED):
                batch[e - first, column] = frozen_rows[k, column]
        else:
            for column in range(PACKED):
                batch[e - first, column] = rows[k - frozen, column]


@numba.njit(**TILE_HELPER)
def _tile_forward(
    frozen_rows: Any,
    rows: Any,
    entries: Any,
    start: int,
    stop: int,
    tile_y: int,
    alpha_min: Any,
    alpha_max: Any,
    transmittance_min: Any,
    buffer: Any,
    batch: Any,
    contributes: Any,
) -> int:
    """Composite one tile's entries into its buffer; return how many were drawn."""
    zero, half = np.float32(0.0), np.float32(0.5)
    for e in range(start, stop):
        place = (e - start) % BATCH
        if place == 0:
            read_rows(frozen_rows, rows, entries, e, min(e + BATCH, stop), batch)
        row = batch[place]
        u, v, opacity = row[P_U], row[P_V], row[P_OPACITY]
        la, lb, lc = row[P_LA], row[P_LB], row[P_LC]
        cr, cg, cb, cd = row[P_RED], row[P_GREEN], row[P_BLUE], row[P_DEPTH]
        low, high = pixel_rows(v, row[P_HALF_H], tile_y)
        total = zero
        for p in range(low, high):
            dy = buffer[B_Y + p] - v
            wx = la * (buffer[B_X + p] - u) + lb * dy
            wy = lc * dy
            power = min(half * (wx * wx + wy * wy), np.float32(MAX_POWER))
            alpha = min(opacity * exp_neg(power), alpha_max)
            alpha = alpha if alpha >= alpha_min else zero
            w = alpha * buffer[B_THROUGH + p]
            total += w
            buffer[B_0 + p] += w * cr
            buffer[B_1 + p] += w * cg
            buffer[B_2 + p] += w * cb
            buffer[B_3 + p] += w * cd
            buffer[B_THROUGH + p] -= w
        if contributes.shape[0] > 0:
            contributes[e] = total >= HIDDEN * transmittance_min * opacity
        if (e - start) % STOP_EVERY == STOP_EVERY - 1:
            largest = zero
            for p in range(FIRST, LAST):
                largest = max(largest, buffer[B_THROUGH + p])
            if largest < transmittance_min:
                return e - start + 1
    return stop - start
