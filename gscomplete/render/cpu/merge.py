"""Join the tile lists of a prepared frozen set with those of the splats drawn with it (one view).

Conventions
-----------
* Both lists of a tile are in depth order. Joined, they are in the order that one sort of all
  splats gives: by depth key, frozen first where keys are equal.
* Joined entries number the frozen rows first, then the other rows, as ``composite`` reads them.
* A frozen list holds the entries up to ``done``, where P alone is opaque, and STOP_EVERY - 1 more.
  Splats in front of them only lower the transmittance, so the joined list is opaque there too and
  compositing ends at its next look, at most STOP_EVERY - 1 entries on: what was cut off behind is
  never reached. A list longer than ``done`` is thus one that P alone finishes.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from gscomplete.render.cpu.composite import STOP_EVERY

_JIT: dict[str, Any] = {"cache": True, "error_model": "numpy"}


@numba.njit(**_JIT)
def cut_lists(
    tile_start: Any,  # [tiles + 1]
    entries: Any,  # [E] ranks
    done: Any,  # [tiles] entries that P alone draws
    total: int,  # M
    cut_start: Any,  # [tiles + 1] int32, written
) -> Any:
    """Cut every list behind its last reachable entry.

    Returns:
        The entries that are left, as places among the splats that are left in any list, and the
        ranks of those splats, ascending.
    """
    place = np.full(total, -1, np.int32)
    kept = 0
    for tile in range(done.shape[0]):
        cut_start[tile] = kept
        length = tile_start[tile + 1] - tile_start[tile]
        length = min(length, done[tile] + STOP_EVERY - 1)
        for e in range(tile_start[tile], tile_start[tile] + length):
            place[entries[e]] = 0
        kept += length
    cut_start[done.shape[0]] = kept
    ranks = np.empty(total, np.int32)
    used = 0
    for rank in range(total):
        if place[rank] == 0:
            place[rank] = used
            ranks[used] = rank
            used += 1
    left = np.empty(kept, np.int32)
    for tile in range(done.shape[0]):
        shift = tile_start[tile] - cut_start[tile]
        for e in range(cut_start[tile], cut_start[tile + 1]):
            left[e] = place[entries[e + shift]]
    return left, ranks[:used].copy()


@numba.njit(**_JIT)
def count_in_front(frozen_keys: Any, keys: Any) -> Any:  # [F], [M], both ascending
    """Return, for every splat, how many frozen rows are drawn before it."""
    in_front = np.empty(keys.shape[0], np.int32)
    place = 0
    for rank in range(keys.shape[0]):
        while place < frozen_keys.shape[0] and frozen_keys[place] <= keys[rank]:
            place += 1
        in_front[rank] = place
    return in_front


@numba.njit(**_JIT)
def choose_active(
    frozen_start: Any,  # [tiles + 1]
    frozen_entries: Any,
    frozen_done: Any,  # [tiles]
    tile_start: Any,  # [tiles + 1] lists of the other splats
    entries: Any,
    in_front: Any,  # [M]
    skip_idle: bool,
    joined_start: Any,  # [tiles + 1] int64, written; idle tiles get an empty list
) -> Any:  # [A] int32
    """Return the tiles to draw: those where another splat comes before P alone is opaque."""
    tiles = frozen_done.shape[0]
    active = np.empty(tiles, np.int32)
    count = 0
    running = 0
    for tile in range(tiles):
        joined_start[tile] = running
        kept = frozen_start[tile + 1] - frozen_start[tile]
        others = tile_start[tile + 1] - tile_start[tile]
        if others == 0 and (skip_idle or kept == 0):
            continue
        if skip_idle and frozen_done[tile] < kept:
            last_drawn = frozen_entries[frozen_start[tile] + frozen_done[tile] - 1]
            if last_drawn < in_front[entries[tile_start[tile]]]:
                continue
        active[count] = tile
        count += 1
        running += kept + others
    joined_start[tiles] = running
    return active[:count].copy()


@numba.njit(parallel=True, **_JIT)
def join_entries(
    frozen_start: Any,
    frozen_entries: Any,
    frozen_total: int,
    tile_start: Any,
    entries: Any,
    slots: Any,
    in_front: Any,
    active: Any,  # [A]
    joined_start: Any,
    joined_entries: Any,  # [E] int32, written
    joined_slots: Any,  # [E] int32, written; or [0], where nobody needs them
) -> None:
    """Write the joined lists of the active tiles."""
    with_slots = joined_slots.shape[0] > 0
    for k in numba.prange(active.shape[0]):
        tile = active[k]
        old, old_stop = frozen_start[tile], frozen_start[tile + 1]
        new, new_stop = tile_start[tile], tile_start[tile + 1]
        for e in range(joined_start[tile], joined_start[tile + 1]):
            if new == new_stop or (old < old_stop and frozen_entries[old] < in_front[entries[new]]):
                joined_entries[e] = frozen_entries[old]
                if with_slots:
                    joined_slots[e] = -1
                old += 1
            else:
                joined_entries[e] = entries[new] + frozen_total
                if with_slots:
                    joined_slots[e] = slots[new]
                new += 1
