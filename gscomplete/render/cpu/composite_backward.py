"""Gradients of what ``composite`` draws, tile by tile (one view).

Conventions
-----------
* Upstream gradients are those of the picture; an array [0, ...] stands for zeros. Depth is the sum
  of w * depth over alpha, so dL/dsum = dL/ddepth / alpha, and alpha's own gradient loses
  dL/dsum times depth.
* The entries that were drawn are visited again in the same order, except hidden ones
  (``contributes``).
* With w_i = alpha_i T_i and A_i the upstream gradient dotted with splat i's values,
  dL/dalpha_i = T_i A_i - (sum over j > i of w_j A_j) / (1 - alpha_i); the sum behind is the
  total minus the running prefix, so nothing is ever divided by a vanished transmittance.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from gscomplete.render.cpu.composite import (
    B_0,
    B_1,
    B_2,
    B_3,
    B_4,
    B_5,
    B_THROUGH,
    B_X,
    B_Y,
    BATCH,
    MAX_POWER,
    PIXELS,
    TILE_HELPER,
    TILE_KERNEL,
    exp_neg,
    pixel_rows,
    read_rows,
    start_tile,
)
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


@numba.njit(**TILE_HELPER)
def _load_upstream(
    buffer: Any,
    tile: int,
    tiles_x: int,
    color: Any,
    depth: Any,
    alpha: Any,
    grad_color: Any,
    grad_depth: Any,
    grad_alpha: Any,
) -> Any:
    """Write the gradients of the sums and their dot product with them; return 0 if all are 0."""
    top, left = tile // tiles_x * TILE, tile % tiles_x * TILE
    loudest = np.float32(0.0)
    for k in range(B_0, np.uint64(9 * PIXELS)):
        buffer[k] = np.float32(0.0)
    for row in range(min(TILE, alpha.shape[0] - top)):
        for column in range(min(TILE, alpha.shape[1] - left)):
            p = np.uint64(row * TILE + column)
            y, x = top + row, left + column
            drawn = alpha[y, x]
            total = gd = ga = np.float32(0.0)
            # Absolute values: a maximum would pass over NaN.
            if grad_color.shape[0] > 0:
                gr, gg, gb = grad_color[y, x, 0], grad_color[y, x, 1], grad_color[y, x, 2]
                buffer[B_0 + p], buffer[B_1 + p], buffer[B_2 + p] = gr, gg, gb
                total = gr * color[y, x, 0] + gg * color[y, x, 1] + gb * color[y, x, 2]
                loudest += abs(gr) + abs(gg) + abs(gb)
            if grad_alpha.shape[0] > 0:
                ga = grad_alpha[y, x]
                total += ga * drawn
            if grad_depth.shape[0] > 0 and drawn > np.float32(0.0):
                gd = grad_depth[y, x] / drawn
                ga -= gd * depth[y, x]
            buffer[B_3 + p], buffer[B_4 + p], buffer[B_5 + p] = gd, ga, total
            loudest += abs(gd) + abs(ga)
    return loudest


@numba.njit(**TILE_KERNEL)
def composite_backward(
    first: int,
    last: int,
    frozen_rows: Any,  # [F, PACKED]
    rows: Any,  # [M, PACKED]
    tile_start: Any,  # [tiles + 1]
    entries: Any,  # [E]
    slots: Any,  # [E] gradient row, or -1 for frozen splats
    active: Any,  # [A] tiles that the forward pass drew
    shares: Any,  # [S + 1]
    skip_idle: bool,  # leave out tiles whose sums are all zero
    tiles_x: int,
    alpha_min: Any,
    alpha_max: Any,
    color: Any,  # [H, W, 3] of the forward pass
    depth: Any,  # [H, W]
    alpha: Any,  # [H, W]
    done: Any,  # [tiles]
    contributes: Any,  # [E]
    grad_color: Any,  # [H, W, 3] dL/dcolor, or [0, 0, 0]
    grad_depth: Any,  # [H, W] or [0, 0]
    grad_alpha: Any,  # [H, W] or [0, 0]
    summed: Any,  # [slots] uint8 zeros, 1 is written where sums are
    sums: Any,  # [slots, SUMS] written
) -> None:
    """Write, for each (trainable splat, tile) entry, the sums from which gradients are computed."""
    buffer = np.empty(9 * PIXELS, np.float32)
    batch = np.empty((BATCH, PACKED), np.float32)
    places, kept = np.empty(BATCH, np.int64), np.empty(BATCH, np.int32)
    for share in range(first, last):
        for k in range(shares[share], shares[share + 1]):
            tile = active[k]
            start = tile_start[tile]
            last = start + done[tile] - 1
            while skip_idle and last >= start and (slots[last] < 0 or contributes[last] == 0):
                last -= 1
            if last < start:
                continue
            start_tile(buffer, tile, tiles_x)
            loudest = _load_upstream(
                buffer,
                tile,
                tiles_x,
                color,
                depth,
                alpha,
                grad_color,
                grad_depth,
                grad_alpha,
            )
            if skip_idle and loudest == np.float32(0.0):
                continue
            _tile_backward(
                frozen_rows,
                rows,
                entries,
                slots,
                start,
                last,
                tile // tiles_x,
                alpha_min,
                alpha_max,
                buffer,
                batch,
                places,
                kept,
                contributes,
                summed,
                sums,
            )


@numba.njit(**TILE_HELPER)
def _keep(entries: Any, contributes: Any, following: int, last: int, places: Any, kept: Any) -> Any:
    """Collect the next BATCH entries that are not hidden; return the next place and how many."""
    count = 0
    while count < BATCH and following <= last:
        places[count], kept[count] = following, entries[following]
        count += contributes[following]
        following += 1
    return following, count


@numba.njit(**TILE_HELPER)
def _tile_backward(
    frozen_rows: Any,
    rows: Any,
    entries: Any,
    slots: Any,
    start: int,
    last: int,
    tile_y: int,
    alpha_min: Any,
    alpha_max: Any,
    buffer: Any,
    batch: Any,
    places: Any,
    kept: Any,
    contributes: Any,
    summed: Any,
    sums: Any,
) -> None:
    """Walk one tile's entries front to back up to the last trainable one."""
    zero, half, one = np.float32(0.0), np.float32(0.5), np.float32(1.0)
    following = start
    while following <= last:
        following, count = _keep(entries, contributes, following, last, places, kept)
        read_rows(frozen_rows, rows, kept, 0, count, batch)
        for place in range(count):
            e, row = places[place], batch[place]
            u, v, opacity = row[P_U], row[P_V], row[P_OPACITY]
            la, lb, lc = row[P_LA], row[P_LB], row[P_LC]
            cr, cg, cb, cd = row[P_RED], row[P_GREEN], row[P_BLUE], row[P_DEPTH]
            low, high = pixel_rows(v, row[P_HALF_H], tile_y)
            slot = slots[e]
            if slot < 0:
                for p in range(low, high):
                    dy = buffer[B_Y + p] - v
                    wx = la * (buffer[B_X + p] - u) + lb * dy
                    wy = lc * dy
                    power = min(half * (wx * wx + wy * wy), np.float32(MAX_POWER))
                    alpha = min(opacity * exp_neg(power), alpha_max)
                    w = (alpha if alpha >= alpha_min else zero) * buffer[B_THROUGH + p]
                    value = cr * buffer[B_0 + p] + cg * buffer[B_1 + p] + cb * buffer[B_2 + p]
                    value += cd * buffer[B_3 + p] + buffer[B_4 + p]
                    buffer[B_5 + p] -= w * value
                    buffer[B_THROUGH + p] -= w
                continue
            s1 = sx = sy = sxx = sxy = syy = sr = sg = sb = sd = zero
            for p in range(low, high):
                dy = buffer[B_Y + p] - v
                wx = la * (buffer[B_X + p] - u) + lb * dy
                wy = lc * dy
                power = min(half * (wx * wx + wy * wy), np.float32(MAX_POWER))
                raw = opacity * exp_neg(power)
                alpha = min(raw, alpha_max)
                alpha = alpha if alpha >= alpha_min else zero
                free = alpha if raw < alpha_max else zero
                through = buffer[B_THROUGH + p]
                gr, gg, gb, gd = buffer[B_0 + p], buffer[B_1 + p], buffer[B_2 + p], buffer[B_3 + p]
                w = alpha * through
                value = cr * gr + cg * gg + cb * gb + cd * gd + buffer[B_4 + p]
                rest = buffer[B_5 + p] - w * value
                gradient = free * (rest / (one - alpha) - through * value)
                buffer[B_5 + p] = rest
                buffer[B_THROUGH + p] = through - w
                s1 += gradient
                gx = gradient * wx
                gy = gradient * wy
                sx += gx
                sy += gy
                sxx += gx * wx
                sxy += gx * wy
                syy += gy * wy
                sr += w * gr
                sg += w * gg
                sb += w * gb
                sd += w * gd
            summed[slot] = 1
            sums[slot, 0], sums[slot, 1], sums[slot, 2] = s1, sx, sy
            sums[slot, 3], sums[slot, 4], sums[slot, 5] = sxx, sxy, syy
            sums[slot, 6], sums[slot, 7], sums[slot, 8], sums[slot, 9] = sr, sg, sb, sd
