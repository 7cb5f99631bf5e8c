"""Composite tile lists front to back, and differentiate the result (one view).

Conventions
-----------
* Images are tiled: [tiles, CHANNELS, TILE * TILE] float32, channels as ``C_*``; pixel k of a tile
  is at row k // TILE, column k % TILE. Tiling keeps every inner loop over 64 contiguous floats.
* Inner loops have no branches and no calls: alphas below the threshold are multiplied by zero, and
  ``exp`` is a polynomial, so that LLVM turns them into vector code.
* A tile stops once all its pixels' transmittances are below ``transmittance_min``; ``done`` keeps
  how many entries were drawn, and the backward pass walks the same entries in the same order.
* With w_i = alpha_i T_i and A_i the upstream gradient dotted with splat i's values,
  dL/dalpha_i = T_i A_i - (sum over j > i of w_j A_j) / (1 - alpha_i); the sum behind is the
  total minus the running prefix, so nothing is ever divided by a vanished transmittance.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from gscomplete.render.cpu.project import (
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
)
from gscomplete.render.cpu.tiles import TILE

C_RED, C_GREEN, C_BLUE, C_DEPTH, C_ALPHA = range(5)
CHANNELS = 5
PIXELS = TILE * TILE
STOP_EVERY = 8
"""Entries between two looks at a tile's largest transmittance."""
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
_JIT = {"cache": True, "fastmath": _FAST, "error_model": "numpy", "boundscheck": False}


@numba.njit(**_JIT)
def exp_neg(power: Any) -> Any:
    """Return exp(-power) for power in [0, 12] in float32 arithmetic."""
    x = power * np.float32(1.0 / 16.0)
    y = E0 + x * (E1 + x * (E2 + x * (E3 + x * (E4 + x * (E5 + x * E6)))))
    y = y * y
    y = y * y
    y = y * y
    return y * y


@numba.njit(**_JIT)
def _pixel_rows(v: Any, half_h: Any, tile_y: int) -> Any:
    """Return the range of pixels (whole pairs of rows, so a multiple of 16) that a splat reaches."""
    top = v - half_h - np.float32(tile_y * TILE) - np.float32(0.51)
    bottom = v + half_h - np.float32(tile_y * TILE) - np.float32(0.49)
    first = int(max(min(top, np.float32(TILE)), np.float32(0.0))) & ~1
    last = (int(max(min(bottom, np.float32(TILE - 1)), np.float32(0.0))) | 1) + 1
    return first * TILE, last * TILE


@numba.njit(parallel=True, **_JIT)
def composite(
    ranked: Any,  # [M, PACKED] splats in depth order
    tile_start: Any,  # [tiles + 1]
    entries: Any,  # [E] ranks
    tiles_x: int,
    alpha_min: Any,  # float32
    alpha_max: Any,
    transmittance_min: Any,
    image: Any,  # [tiles, CHANNELS, PIXELS] written
    done: Any,  # [tiles] int32 written
) -> None:
    """Draw every tile: premultiplied colour, sum of w * depth, and alpha."""
    tiles = tile_start.shape[0] - 1
    for tile in numba.prange(tiles):
        column = np.empty(PIXELS, np.float32)
        line = np.empty(PIXELS, np.float32)
        through = np.empty(PIXELS, np.float32)
        tile_y = tile // tiles_x
        for p in range(PIXELS):
            column[p] = np.float32((tile % tiles_x) * TILE + p % TILE) + np.float32(0.5)
            line[p] = np.float32(tile_y * TILE + p // TILE) + np.float32(0.5)
            through[p] = np.float32(1.0)
        red, green, blue = image[tile, C_RED], image[tile, C_GREEN], image[tile, C_BLUE]
        deep, alphas = image[tile, C_DEPTH], image[tile, C_ALPHA]
        for p in range(PIXELS):
            red[p] = green[p] = blue[p] = deep[p] = np.float32(0.0)
        start, stop = tile_start[tile], tile_start[tile + 1]
        drawn = stop - start
        for e in range(start, stop):
            row = ranked[entries[e]]
            u, v, opacity = row[P_U], row[P_V], row[P_OPACITY]
            la, lb, lc = row[P_LA], row[P_LB], row[P_LC]
            cr, cg, cb, cd = row[P_RED], row[P_GREEN], row[P_BLUE], row[P_DEPTH]
            low, high = _pixel_rows(v, row[P_HALF_H], tile_y)
            for p in range(low, high):
                dy = line[p] - v
                wx = la * (column[p] - u) + lb * dy
                wy = lc * dy
                power = min(np.float32(0.5) * (wx * wx + wy * wy), np.float32(MAX_POWER))
                alpha = min(opacity * exp_neg(power), alpha_max)
                alpha = alpha if alpha >= alpha_min else np.float32(0.0)
                w = alpha * through[p]
                red[p] += w * cr
                green[p] += w * cg
                blue[p] += w * cb
                deep[p] += w * cd
                through[p] -= w
            if (e - start) % STOP_EVERY == STOP_EVERY - 1:
                largest = np.float32(0.0)
                for p in range(PIXELS):
                    largest = max(largest, through[p])
                if largest < transmittance_min:
                    drawn = e - start + 1
                    break
        for p in range(PIXELS):
            alphas[p] = np.float32(1.0) - through[p]
        done[tile] = drawn


@numba.njit(parallel=True, **_JIT)
def composite_backward(
    ranked: Any,  # [M, PACKED]
    tile_start: Any,  # [tiles + 1]
    entries: Any,  # [E] ranks
    slots: Any,  # [E] gradient row, or -1 for frozen splats
    tiles_x: int,
    alpha_min: Any,
    alpha_max: Any,
    image: Any,  # [tiles, CHANNELS, PIXELS] of the forward pass
    done: Any,  # [tiles]
    upstream: Any,  # [tiles, CHANNELS, PIXELS] dL/dimage
    sums: Any,  # [slots, SUMS] zeros, written
) -> None:
    """Write, for every (trainable splat, tile) entry, the sums that its gradient is made of."""
    tiles = tile_start.shape[0] - 1
    for tile in numba.prange(tiles):
        start = tile_start[tile]
        last = start - 1
        for e in range(start + done[tile] - 1, start - 1, -1):
            if slots[e] >= 0:
                last = e
                break
        loudest = np.float32(0.0)
        for c in range(CHANNELS):
            for p in range(PIXELS):
                loudest = max(loudest, abs(upstream[tile, c, p]))
        if last >= start and loudest > np.float32(0.0):
            _tile_backward(
                ranked, entries, slots, tiles_x, alpha_min, alpha_max, image[tile],
                upstream[tile], sums, tile, start, last,
            )


@numba.njit(**_JIT)
def _tile_backward(
    ranked: Any,
    entries: Any,
    slots: Any,
    tiles_x: int,
    alpha_min: Any,
    alpha_max: Any,
    image: Any,  # [CHANNELS, PIXELS]
    upstream: Any,  # [CHANNELS, PIXELS]
    sums: Any,
    tile: int,
    start: int,
    last: int,
) -> None:
    """Walk one tile's entries front to back up to the last trainable one."""
    column = np.empty(PIXELS, np.float32)
    line = np.empty(PIXELS, np.float32)
    through = np.empty(PIXELS, np.float32)
    behind = np.empty(PIXELS, np.float32)  # sum of w_j A_j not yet passed
    gr, gg, gb = upstream[C_RED], upstream[C_GREEN], upstream[C_BLUE]
    gd, ga = upstream[C_DEPTH], upstream[C_ALPHA]
    tile_y = tile // tiles_x
    for p in range(PIXELS):
        column[p] = np.float32((tile % tiles_x) * TILE + p % TILE) + np.float32(0.5)
        line[p] = np.float32(tile_y * TILE + p // TILE) + np.float32(0.5)
        through[p] = np.float32(1.0)
        behind[p] = (
            image[C_RED, p] * gr[p]
            + image[C_GREEN, p] * gg[p]
            + image[C_BLUE, p] * gb[p]
            + image[C_DEPTH, p] * gd[p]
            + image[C_ALPHA, p] * ga[p]
        )
    zero, one = np.float32(0.0), np.float32(1.0)
    for e in range(start, last + 1):
        row = ranked[entries[e]]
        u, v, opacity = row[P_U], row[P_V], row[P_OPACITY]
        la, lb, lc = row[P_LA], row[P_LB], row[P_LC]
        cr, cg, cb, cd = row[P_RED], row[P_GREEN], row[P_BLUE], row[P_DEPTH]
        low, high = _pixel_rows(v, row[P_HALF_H], tile_y)
        slot = slots[e]
        if slot < 0:
            for p in range(low, high):
                dy = line[p] - v
                wx = la * (column[p] - u) + lb * dy
                wy = lc * dy
                power = min(np.float32(0.5) * (wx * wx + wy * wy), np.float32(MAX_POWER))
                alpha = min(opacity * exp_neg(power), alpha_max)
                w = (alpha if alpha >= alpha_min else zero) * through[p]
                behind[p] -= w * (cr * gr[p] + cg * gg[p] + cb * gb[p] + cd * gd[p] + ga[p])
                through[p] -= w
            continue
        s1 = sx = sy = sxx = sxy = syy = sr = sg = sb = sd = zero
        for p in range(low, high):
            dy = line[p] - v
            wx = la * (column[p] - u) + lb * dy
            wy = lc * dy
            power = min(np.float32(0.5) * (wx * wx + wy * wy), np.float32(MAX_POWER))
            raw = opacity * exp_neg(power)
            alpha = min(raw, alpha_max)
            alpha = alpha if alpha >= alpha_min else zero
            free = alpha if raw < alpha_max else zero
            w = alpha * through[p]
            value = cr * gr[p] + cg * gg[p] + cb * gb[p] + cd * gd[p] + ga[p]
            rest = behind[p] - w * value
            gradient = -free * (through[p] * value - rest / (one - alpha))
            behind[p] = rest
            through[p] -= w
            s1 += gradient
            sx += gradient * wx
            sy += gradient * wy
            sxx += gradient * wx * wx
            sxy += gradient * wx * wy
            syy += gradient * wy * wy
            sr += w * gr[p]
            sg += w * gg[p]
            sb += w * gb[p]
            sd += w * gd[p]
        sums[slot, 0], sums[slot, 1], sums[slot, 2] = s1, sx, sy
        sums[slot, 3], sums[slot, 4], sums[slot, 5] = sxx, sxy, syy
        sums[slot, 6], sums[slot, 7], sums[slot, 8], sums[slot, 9] = sr, sg, sb, sd
