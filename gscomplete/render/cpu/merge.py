"""Join the tile lists of a prepared frozen set with those of the splats drawn with it (one view).

Conventions
-----------
* Both lists of a tile are in depth order. The joined list has the order that one sort of all splats
  would give: by depth key, frozen splats first where keys are equal.
* Joined entries number the frozen rows first, then the other rows, as ``composite`` reads them.
* A frozen list holds the entries up to ``done``, where P alone is opaque, and STOP_EVERY - 1 more.
  Other splats in front of them only lower the transmittance, so the joined list is opaque there
  too, and compositing ends at its next check, at most STOP_EVERY - 1 entries later: the entries cut
  off behind are never reached. A list longer than ``done`` thus belongs to a tile that P alone
  makes opaque.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from gscomplete.render.cpu.composite import STOP_EVERY
from gscomplete.util.kernels import KERNEL


def cut_lists(
    tile_start: Any,  # [tiles + 1]
    entries: Any,  # [E] ranks
    done: Any,  # [tiles] entries that P alone draws
    total: int,  # M
) -> Any:
    """Cut every list behind its last reachable entry.

    Returns:
        The entries that are left, as places among the splats that are left in any list, int32;
        where each tile's begin [tiles + 1], int32; and the ranks of those splats, ascending.
    """
    lengths = np.minimum(np.diff(tile_start), done + (STOP_EVERY - 1))
    cut_start = np.concatenate([[0], np.cumsum(lengths)])
    left = np.arange(cut_start[-1]) + np.repeat(tile_start[:-1] - cut_start[:-1], lengths)
    left_ranks = entries[left]
    used = np.zeros(total, np.bool_)
    used[left_ranks] = True
    place = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return place[left_ranks], cut_start.astype(np.int32), np.flatnonzero(used)


@numba.njit(**KERNEL)
def count_in_front(frozen_keys: Any, keys: Any) -> Any:  # [F], [M], both ascending
    """Return, for every splat, how many frozen rows are drawn before it."""
    in_front = np.empty(keys.shape[0], np.int32)
    place = 0
    for rank in range(keys.shape[0]):
        while place < frozen_keys.shape[0] and frozen_keys[place] <= keys[rank]:
            place += 1
        in_front[rank] = place
    return in_front


def choose_active(
    frozen_start: Any,  # [tiles + 1]
    frozen_entries: Any,
    frozen_done: Any,  # [tiles]
    tile_start: Any,  # [tiles + 1] lists of the other splats
    entries: Any,
    in_front: Any,  # [M]
    skip_idle: bool,
) -> Any:
    """Choose the tiles to draw: those where another splat comes before P alone is opaque.

    Returns:
        The tiles [A], int32; and where their joined lists begin [tiles + 1], int64; idle tiles
        have an empty one.
    """
    kept, others = np.diff(frozen_start), np.diff(tile_start)
    active = (others > 0) | (kept > 0) & (not skip_idle)
    if skip_idle:
        covered = np.flatnonzero(active & (frozen_done < kept))
        last_drawn = frozen_entries[frozen_start[covered] + frozen_done[covered] - 1]
        active[covered[last_drawn < in_front[entries[tile_start[covered]]]]] = False
    lengths = np.where(active, kept + others, 0)
    return np.flatnonzero(active).astype(np.int32), np.concatenate([[0], np.cumsum(lengths)])


@numba.njit(**KERNEL)
def join_entries(
    first: int,
    last: int,
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
    for k in range(first, last):
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
