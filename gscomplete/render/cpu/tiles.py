"""Exact tile lists of one view.

Conventions
-----------
* Tiles are TILE x TILE pixels, numbered row by row.
* ``order`` lists the visible splats front to back; a splat's place in it is its rank.
* Tile lists hold ranks in ascending order. A splat is in a tile's list when its ellipse at
  ``alpha_min`` reaches the rectangle of that tile's pixel centres (grown by MARGIN pixels, so
  that rounding can only add an entry that draws nothing, never lose one), or, when lists need not
  be exact, when its pixel box does.
* ``slots`` number the entries of trainable splats splat by splat, so that gradients written per
  entry are summed in an order that does not depend on threads.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from gscomplete.render.cpu.layout import (
    P_HALF_H,
    P_HALF_W,
    P_LA,
    P_LB,
    P_LC,
    P_OPACITY,
    P_U,
    P_V,
    PACKED,
)
from gscomplete.util.kernels import HELPER, KERNEL

TILE = 8
MARGIN = 1e-3
CHUNKS = 16
"""The ordered splats are binned in this many runs; fixed, so lists never depend on threads."""

KEPT_ROWS = 3
"""Tile rows of a splat whose tiles are kept from counting to filling; taller ones are rare."""
SPAN = 2 + 2 * KEPT_ROWS


@numba.njit(**HELPER)
def _row_span(row: Any, u: float, v: float, reach: float, y0: float, y1: float) -> Any:
    """Return the x range of the ellipse within y0 <= y <= y1 (empty when low > high)."""
    half_w = np.float64(row[P_HALF_W])
    half_h = np.float64(row[P_HALF_H])
    la, lb, lc = np.float64(row[P_LA]), np.float64(row[P_LB]), np.float64(row[P_LC])
    low_y, high_y = y0 - v, y1 - v
    if low_y > half_h + MARGIN or high_y < -half_h - MARGIN:
        return 1.0, 0.0
    turn = -la * lb / (lb * lb + lc * lc) * half_w  # y offset of the right-most point
    dy = min(max(turn, low_y), high_y)
    right = u + (-lb * dy + math.sqrt(max(reach - lc * lc * dy * dy, 0.0))) / la
    dy = min(max(-turn, low_y), high_y)
    left = u + (-lb * dy - math.sqrt(max(reach - lc * lc * dy * dy, 0.0))) / la
    return max(left, u - half_w) - MARGIN, min(right, u + half_w) + MARGIN


@numba.njit(**HELPER)
def _tile_span(low: float, high: float, tiles: int) -> Any:
    """Return the first and one-past-last tile whose pixel centres lie within [low, high]."""
    # Far-off ranges are cut first: their tile numbers need not fit an integer.
    low, high = max(low, -1.0), min(high, tiles * TILE + 1.0)
    # The last centre of tile k is at TILE * k + TILE - 0.5, its first at TILE * k + 0.5.
    first = math.ceil((low - TILE + 0.5) / TILE)
    last = math.floor((high - 0.5) / TILE)
    return max(first, 0), min(last + 1, tiles)


@numba.njit(**HELPER)
def _tile_box(row: Any, tiles_x: int, tiles_y: int) -> Any:
    """Return the tile range of a splat's pixel box, and whether the ellipse must reach all of it.

    An ellipse touches all four sides of its box, so it reaches every tile of a box that is one
    tile wide or high.
    """
    u, v = np.float64(row[P_U]), np.float64(row[P_V])
    half_w, half_h = row[P_HALF_W] + MARGIN, row[P_HALF_H] + MARGIN
    first_x, last_x = _tile_span(u - half_w, u + half_w, tiles_x)
    first_y, last_y = _tile_span(v - half_h, v + half_h, tiles_y)
    return first_x, last_x, first_y, last_y, last_x - first_x <= 1 or last_y - first_y <= 1


@numba.njit(**HELPER)
def _reach(row: Any, log_alpha_min: float) -> float:
    """Return the squared whitened distance at which a splat's alpha is alpha_min."""
    return 2.0 * (math.log(np.float64(row[P_OPACITY])) - log_alpha_min)


@numba.njit(**HELPER)
def _row_tiles(row: Any, reach: float, ty: int, tiles_x: int) -> Any:
    """Return the tiles of tile row ``ty`` that the ellipse reaches."""
    u, v = np.float64(row[P_U]), np.float64(row[P_V])
    left, right = _row_span(row, u, v, reach, ty * TILE + 0.5, ty * TILE + TILE - 0.5)
    if left > right:
        return 0, 0
    return _tile_span(left, right, tiles_x)


@numba.njit(**KERNEL)
def count_entries(
    first_chunk: int,
    last_chunk: int,
    ranked: Any,  # [M, PACKED] in depth order
    tiles_x: int,
    tiles_y: int,
    alpha_min: float,
    exact: bool,  # lists by ellipse; else by pixel box
    spans: Any,  # [M, SPAN] int32, written: which tiles; see ``fill_entries``
    per_chunk: Any,  # [CHUNKS, tiles] int32, zeros, written
    per_rank: Any,  # [M] int32, written
) -> None:
    """Count the entries of every (chunk, tile) and of every rank."""
    log_alpha_min = math.log(alpha_min)
    total = ranked.shape[0]
    size = (total + CHUNKS - 1) // CHUNKS
    for chunk in range(first_chunk, last_chunk):
        for rank in range(chunk * size, min(total, chunk * size + size)):
            row = ranked[rank]
            first_x, last_x, first_y, last_y, full = _tile_box(row, tiles_x, tiles_y)
            narrow = exact and not full
            reach = _reach(row, log_alpha_min) if narrow else 0.0
            spans[rank, 0], spans[rank, 1] = first_y, last_y
            entries = 0
            for ty in range(first_y, last_y):
                if narrow:
                    first_x, last_x = _row_tiles(row, reach, ty, tiles_x)
                if ty - first_y < KEPT_ROWS:
                    spans[rank, 2 + 2 * (ty - first_y)] = first_x
                    spans[rank, 3 + 2 * (ty - first_y)] = last_x
                for tx in range(first_x, last_x):
                    per_chunk[chunk, ty * tiles_x + tx] += 1
                entries += max(last_x - first_x, 0)
            per_rank[rank] = entries


@numba.njit(**KERNEL)
def place_entries(
    per_chunk: Any,  # [CHUNKS, tiles] int32 counts, overwritten by write positions
    per_rank: Any,  # [M]
    order: Any,  # [M]
    first: int,
    trainable: int,
    tile_start: Any,  # [tiles + 1] int64, written
    slot_start: Any,  # [trainable + 1] int64, written
) -> None:
    """Turn counts into positions: lists tile by tile, slots trainable splat by splat."""
    tiles = per_chunk.shape[1]
    running = 0
    for tile in range(tiles):
        tile_start[tile] = running
        for chunk in range(per_chunk.shape[0]):
            here = per_chunk[chunk, tile]
            per_chunk[chunk, tile] = running
            running += here
    tile_start[tiles] = running
    slot_start[:] = 0
    if trainable > 0:
        for rank in range(order.shape[0]):
            if order[rank] >= first:
                slot_start[order[rank] - first + 1] = per_rank[rank]
        for j in range(trainable):
            slot_start[j + 1] += slot_start[j]


@numba.njit(**KERNEL)
def fill_entries(
    first_chunk: int,
    last_chunk: int,
    ranked: Any,  # [M, PACKED]
    order: Any,  # [M] int32
    tiles_x: int,
    tiles_y: int,
    alpha_min: float,
    exact: bool,
    spans: Any,  # [M, SPAN] first and last tile row, then first and last tile of the first rows
    cursor: Any,  # [CHUNKS, tiles] write positions from place_entries, advanced
    first: int,
    slot_start: Any,
    entries: Any,  # [E] int32 ranks, written
    slots: Any,  # [E] int32 slot or -1 for frozen, written; or [0], where nobody needs them
) -> None:
    """Write every tile's list of ranks, and the gradient slot of every entry."""
    log_alpha_min = math.log(alpha_min)
    total = order.shape[0]
    size = (total + CHUNKS - 1) // CHUNKS
    with_slots = slots.shape[0] > 0
    for chunk in range(first_chunk, last_chunk):
        for rank in range(chunk * size, min(total, chunk * size + size)):
            splat = order[rank]
            first_y, last_y = np.int64(spans[rank, 0]), np.int64(spans[rank, 1])
            narrow, reach = False, 0.0
            first_x, last_x = 0, 0
            if last_y - first_y > KEPT_ROWS:
                first_x, last_x, _, _, full = _tile_box(ranked[rank], tiles_x, tiles_y)
                narrow = exact and not full
                reach = _reach(ranked[rank], log_alpha_min) if narrow else 0.0
            slot = slot_start[splat - first] if splat >= first else -1
            for ty in range(first_y, last_y):
                if ty - first_y < KEPT_ROWS:
                    first_x = spans[rank, 2 + 2 * (ty - first_y)]
                    last_x = spans[rank, 3 + 2 * (ty - first_y)]
                elif narrow:
                    first_x, last_x = _row_tiles(ranked[rank], reach, ty, tiles_x)
                for tx in range(first_x, last_x):
                    place = cursor[chunk, ty * tiles_x + tx]
                    cursor[chunk, ty * tiles_x + tx] = place + 1
                    entries[place] = rank
                    if with_slots:
                        slots[place] = slot
                        if slot >= 0:
                            slot += 1


@numba.njit(**KERNEL)
def gather_ranked(first: int, last: int, packed: Any, order: Any, ranked: Any) -> None:
    """Copy packed rows into depth order, so that compositing reads memory forwards."""
    for rank in range(first, last):
        source = order[rank]
        for k in range(PACKED):
            ranked[rank, k] = packed[source, k]
