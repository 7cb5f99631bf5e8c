"""Exact tile lists of one view.

Conventions
-----------
* Tiles are TILE x TILE pixels, numbered row by row.
* ``order`` lists the visible splats front to back; a splat's place in it is its rank.
* Tile lists hold ranks in ascending order. A splat is in a tile's list when its ellipse at
  ``alpha_min`` reaches the rectangle of that tile's pixel centres (grown by MARGIN pixels, so
  that rounding can only add an entry that draws nothing, never lose one), or, when lists need not
  be exact, when its pixel box does.
* Tiles are counted for LANES splats at a time, as ``screen`` says; tile numbers are float64 there.
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
    P_U,
    P_V,
    PACKED,
)
from gscomplete.render.cpu.screen import FIRST_LANE, LANE_HELPER, LANES, PAST_LANES
from gscomplete.util.kernels import KERNEL

TILE = 8
MARGIN = 1e-3
CHUNKS = 16
"""The ordered splats are binned in this many runs; fixed, so lists never depend on threads."""

KEPT_ROWS = 3
"""Tile rows of a splat whose tiles are kept from counting to filling; taller ones are rare."""
SPAN = 2 + 2 * KEPT_ROWS
_AHEAD = 128
"""Rows that are touched before they are copied."""

_PLANES = 7 + SPAN
_U, _V, _HALF_W, _HALF_H, _LA, _LB, _LC = (np.uint64(k * LANES) for k in range(7))
_SPAN = np.uint64(7 * LANES)
"""The first of the planes that are computed, as ``spans`` lists them."""


@numba.njit(**LANE_HELPER)
def _tile_span(low: float, high: float, tiles: float) -> Any:
    """Return the first and one-past-last tile whose pixel centres lie within [low, high]."""
    # Far-off ranges are cut first: their tile numbers need not fit an integer.
    low, high = max(low, -1.0), min(high, tiles * TILE + 1.0)
    # The last centre of tile k is at TILE * k + TILE - 0.5, its first at TILE * k + 0.5.
    first = np.ceil((low - TILE + 0.5) / TILE)
    last = np.floor((high - 0.5) / TILE)
    return max(first, 0.0), min(last + 1.0, tiles)


@numba.njit(**LANE_HELPER)
def _tile_box(ellipse: Any, tiles_x: float, tiles_y: float) -> Any:
    """Return the tile range of a splat's pixel box, and whether the ellipse must reach all of it.

    An ellipse touches all four sides of its box, so it reaches every tile of a box that is one
    tile wide or high.
    """
    u, v, half_w, half_h, _, _, _ = ellipse
    half_w, half_h = half_w + MARGIN, half_h + MARGIN
    first_x, last_x = _tile_span(u - half_w, u + half_w, tiles_x)
    first_y, last_y = _tile_span(v - half_h, v + half_h, tiles_y)
    return first_x, last_x, first_y, last_y, min(last_x - first_x, last_y - first_y) <= 1.0


@numba.njit(**LANE_HELPER)
def _row_tiles(ellipse: Any, ty: float, tiles_x: float) -> Any:
    """Return the tiles of tile row ``ty`` that the ellipse reaches."""
    u, v, half_w, half_h, la, lb, lc = ellipse
    low_y, high_y = ty * TILE + 0.5 - v, ty * TILE + TILE - 0.5 - v
    # The squared whitened distance of the box's upper side, no less for rounding of what is stored.
    reach = half_h * lc * (half_h * lc) * (1.0 + 1e-6)
    turn = -la * lb / (lb * lb + lc * lc) * half_w  # y offset of the right-most point
    dy = min(max(turn, low_y), high_y)
    right = u + (-lb * dy + math.sqrt(max(reach - lc * lc * dy * dy, 0.0))) / la
    dy = min(max(-turn, low_y), high_y)
    left = u + (-lb * dy - math.sqrt(max(reach - lc * lc * dy * dy, 0.0))) / la
    left, right = max(left, u - half_w) - MARGIN, min(right, u + half_w) + MARGIN
    misses = (low_y > half_h + MARGIN) | (high_y < -half_h - MARGIN) | (left > right)
    first_x, last_x = _tile_span(left, right, tiles_x)
    return 0.0 if misses else first_x, 0.0 if misses else last_x


@numba.njit(**LANE_HELPER)
def _ellipse(row: Any) -> Any:
    """Return those values of a packed row that the functions above read."""
    return (
        np.float64(row[P_U]),
        np.float64(row[P_V]),
        np.float64(row[P_HALF_W]),
        np.float64(row[P_HALF_H]),
        np.float64(row[P_LA]),
        np.float64(row[P_LB]),
        np.float64(row[P_LC]),
    )


@numba.njit(**LANE_HELPER)
def _span_lanes(lanes: Any, tiles_x: float, tiles_y: float, exact: bool) -> None:
    """Compute the tile rows of every lane, and the tiles of the first KEPT_ROWS of them."""
    for p in range(FIRST_LANE, PAST_LANES):
        ellipse = (
            lanes[_U + p],
            lanes[_V + p],
            lanes[_HALF_W + p],
            lanes[_HALF_H + p],
            lanes[_LA + p],
            lanes[_LB + p],
            lanes[_LC + p],
        )
        first_x, last_x, first_y, last_y, full = _tile_box(ellipse, tiles_x, tiles_y)
        full |= not exact
        lanes[_SPAN + p], lanes[_SPAN + PAST_LANES + p] = first_y, last_y
        for k in range(KEPT_ROWS):
            first, last = _row_tiles(ellipse, first_y + k, tiles_x)
            plane = _SPAN + np.uint64(2 + 2 * k) * PAST_LANES
            lanes[plane + p] = first_x if full else first
            lanes[plane + PAST_LANES + p] = last_x if full else last


@numba.njit(**KERNEL)
def count_entries(
    first_chunk: int,
    last_chunk: int,
    ranked: Any,  # [M, PACKED] in depth order
    order: Any,  # [M] int32
    first: int,  # the first trainable splat
    tiles_x: int,
    tiles_y: int,
    exact: bool,  # lists by ellipse; else by pixel box
    spans: Any,  # [M, SPAN] int32, written: which tiles; see ``fill_entries``
    per_chunk: Any,  # [CHUNKS, tiles] int32, zeros, written
    slot_start: Any,  # [trainable + 1] int64, zeros; after each splat's place, its entries
) -> None:
    """Count the entries of every (chunk, tile) and of every splat."""
    lanes = np.zeros(_PLANES * LANES, np.float64)
    total = order.shape[0]
    size = (total + CHUNKS - 1) // CHUNKS
    for chunk in range(first_chunk, last_chunk):
        stop = min(total, chunk * size + size)
        for block in range(chunk * size, stop, LANES):
            count = np.uint64(min(LANES, stop - block))
            for p in range(FIRST_LANE, count):
                row = ranked[block + np.int64(p)]
                lanes[_U + p], lanes[_V + p] = row[P_U], row[P_V]
                lanes[_HALF_W + p], lanes[_HALF_H + p] = row[P_HALF_W], row[P_HALF_H]
                lanes[_LA + p], lanes[_LB + p], lanes[_LC + p] = row[P_LA], row[P_LB], row[P_LC]
            _span_lanes(lanes, tiles_x, tiles_y, exact)
            for p in range(FIRST_LANE, count):
                rank = block + np.int64(p)
                for k in range(SPAN):
                    spans[rank, k] = np.int32(lanes[_SPAN + np.uint64(k) * PAST_LANES + p])
                is_small, tiles, reached = _four_tiles(spans, rank, tiles_x)
                entries = 0
                if is_small:
                    for k in range(4):
                        per_chunk[chunk, tiles[k]] += reached[k]
                        entries += reached[k]
                else:
                    for ty in range(spans[rank, 0], spans[rank, 1]):
                        first_x, last_x = _kept_tiles(
                            spans, ranked, rank, ty, tiles_x, tiles_y, exact
                        )
                        for tx in range(first_x, last_x):
                            per_chunk[chunk, ty * tiles_x + tx] += 1
                        entries += max(last_x - first_x, 0)
                if order[rank] >= first:
                    slot_start[order[rank] - first + 1] = entries


@numba.njit(**LANE_HELPER)
def _four_tiles(spans: Any, rank: int, tiles_x: int) -> Any:
    """Return whether a splat spans at most 2 x 2 tiles, their numbers, and 1 for each reached.

    Small splats are counted without branches, since the processor would mispredict about half of
    them. A tile that is not reached gets the number 0.
    """
    rows = spans[rank, 1] - spans[rank, 0]
    upper, lower = spans[rank, 3] - spans[rank, 2], spans[rank, 5] - spans[rank, 4]
    upper, lower = upper if rows >= 1 else 0, lower if rows >= 2 else 0
    first = np.int64(spans[rank, 0]) * tiles_x + spans[rank, 2]
    second = np.int64(spans[rank, 0] + 1) * tiles_x + spans[rank, 4]
    r0, r1 = np.int32(upper >= 1), np.int32(upper >= 2)
    r2, r3 = np.int32(lower >= 1), np.int32(lower >= 2)
    tiles = first * r0, (first + 1) * r1, second * r2, (second + 1) * r3
    return (rows <= 2) & (max(upper, lower) <= 2), tiles, (r0, r1, r2, r3)


@numba.njit(**LANE_HELPER)
def _kept_tiles(
    spans: Any, ranked: Any, rank: int, ty: int, tiles_x: int, tiles_y: int, exact: bool
) -> Any:
    """Return the tiles of tile row ``ty``, as stored in ``spans`` or else computed again."""
    row = ty - spans[rank, 0]
    if row < KEPT_ROWS:
        return np.int64(spans[rank, 2 + 2 * row]), np.int64(spans[rank, 3 + 2 * row])
    ellipse = _ellipse(ranked[rank])
    first_x, last_x, _, _, full = _tile_box(ellipse, tiles_x, tiles_y)
    if exact and not full:
        first_x, last_x = _row_tiles(ellipse, ty, tiles_x)
    return np.int64(first_x), np.int64(last_x)


@numba.njit(**KERNEL)
def place_entries(
    per_chunk: Any,  # [CHUNKS, tiles] int32 counts, overwritten by write positions
    tile_start: Any,  # [tiles + 1] int64, written
    slot_start: Any,  # [trainable + 1] int64 counts, overwritten by their sums up to each place
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
    for j in range(slot_start.shape[0] - 1):
        slot_start[j + 1] += slot_start[j]


@numba.njit(**KERNEL)
def fill_entries(
    first_chunk: int,
    last_chunk: int,
    ranked: Any,  # [M, PACKED]
    order: Any,  # [M] int32
    tiles_x: int,
    tiles_y: int,
    exact: bool,
    spans: Any,  # [M, SPAN] first and last tile row, then first and last tile of the first rows
    cursor: Any,  # [CHUNKS, tiles] write positions from place_entries, advanced
    first: int,
    slot_start: Any,
    entries: Any,  # [E] int32 ranks, written
    slots: Any,  # [E] int32 slot or -1 for frozen, written; or [0], where nobody needs them
) -> None:
    """Write every tile's list of ranks, and the gradient slot of every entry."""
    total = order.shape[0]
    size = (total + CHUNKS - 1) // CHUNKS
    with_slots = slots.shape[0] > 0
    for chunk in range(first_chunk, last_chunk):
        for rank in range(chunk * size, min(total, chunk * size + size)):
            splat = order[rank]
            slot = slot_start[splat - first] if splat >= first else -1
            for ty in range(spans[rank, 0], spans[rank, 1]):
                first_x, last_x = _kept_tiles(spans, ranked, rank, ty, tiles_x, tiles_y, exact)
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
    """Copy packed rows into depth order, so that compositing reads memory forwards.

    A first loop only reads the rows, for the reason given at ``composite.read_rows``.
    """
    for block in range(first, last, _AHEAD):
        stop = min(block + _AHEAD, last)
        touched = np.float32(0.0)
        for rank in range(block, stop):
            touched += packed[order[rank], 0] + packed[order[rank], PACKED - 1]
        ranked[block, 0] = touched  # overwritten below; keeps the loop from being removed
        for rank in range(block, stop):
            source = order[rank]
            for k in range(PACKED):
                ranked[rank, k] = packed[source, k]
