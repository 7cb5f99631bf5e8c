"""Order the splats of one view by depth: a stable radix sort.

Conventions
-----------
* Keys are the bit patterns of positive float64 depths as integers, of which the upper 44 bits are
  sorted: float32 depths would swap overlapping neighbours, which changes the picture visibly.
* The result is the order by (key, index); it does not depend on threads or on how the keys are
  divided into parts.
* Every thread sorts its own range of depths: if two threads wrote into one range, they would share
  cache lines, which costs as much time as the second thread saves.
* Two passes sort by the upper 22 of the bits in which a part's keys differ. If few neighbours are
  then still out of order, these are swapped one by one; if many are, all bits are sorted.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from gscomplete.util.kernels import KERNEL, run_kernel

_DIGIT_BITS = 11
_DIGITS = 1 << _DIGIT_BITS
_KEY_BITS = 44
_FEWEST_PER_PART = 8192
"""Splats; fewer are sorted in less time than handing them to a thread takes."""
_SAMPLES = 64
"""Keys per part that its bounds are taken from."""
_MOST_MOVES = 4
"""Per key, to put neighbours right."""
_NO_BOUND = np.uint64(1 << _KEY_BITS)
_DROPPED = np.uint64(64 - _KEY_BITS)
"""Lowest bits of depths, which are not sorted by."""


def depth_order(visible: Any, depth_bits: Any) -> tuple[Any, Any]:  # [N] uint8, [N] uint64
    """Return visible splats sorted by depth, ties by index [M] int32, and their keys [M] uint64."""
    count = int(np.count_nonzero(visible))
    parts = max(1, min(numba.get_num_threads(), count // _FEWEST_PER_PART))
    bounds = _bounds(visible, depth_bits, parts)
    index, keys = np.empty(count, np.int32), np.empty(count, np.uint64)
    spare, spare_keys = np.empty(count + parts, np.int32), np.empty(count + parts, np.uint64)
    run_kernel(_sort_parts, parts, 1, visible, depth_bits, bounds, spare, spare_keys, index, keys)
    return index, keys


def _bounds(visible: Any, depth_bits: Any, parts: int) -> Any:  # [parts + 1] uint64
    """Choose keys that divide all keys into ranges of about the same number of splats."""
    bounds = np.zeros(parts + 1, np.uint64)
    bounds[parts] = _NO_BOUND
    if parts > 1:
        step = max(1, len(visible) // (parts * _SAMPLES))
        seen = np.sort(depth_bits[::step][visible[::step] != 0] >> _DROPPED)
        if len(seen):
            bounds[1:parts] = seen[len(seen) * np.arange(1, parts) // parts]
    return bounds


@numba.njit(**KERNEL)
def _sort_parts(
    first: int,
    last: int,
    visible: Any,  # [N] uint8
    depth_bits: Any,  # [N] uint64
    bounds: Any,  # [parts + 1] ascending keys, from the smallest that there may be
    spare: Any,  # [M + parts] int32, written
    spare_keys: Any,  # [M + parts] uint64, written
    index: Any,  # [M] int32, written
    keys: Any,  # [M] uint64, written
) -> None:
    """Sort the keys within the bounds of each part to their places among all keys."""
    cursor = np.empty((2, _DIGITS), np.uint64)
    mask, one = np.uint64(_DIGITS - 1), np.uint64(1)
    for part in range(first, last):
        before: Any = np.uint64(0)
        for i in range(visible.shape[0]):
            key = depth_bits[i] >> _DROPPED
            before += np.uint64((visible[i] != 0) & (key < bounds[part]))
        start = before + np.uint64(part)  # of the spare places: each part before has one more
        stop = start
        least, most = _NO_BOUND, np.uint64(0)
        for i in range(visible.shape[0]):
            key = depth_bits[i] >> _DROPPED
            spare[stop], spare_keys[stop] = i, key  # overwritten unless it counts: saves a branch
            stop += np.uint64((visible[i] != 0) & (key >= bounds[part]) & (key < bounds[part + 1]))
        for j in range(start, stop):
            least, most = min(least, spare_keys[j]), max(most, spare_keys[j])
        bits = 0
        while stop > start and (most - least) >> np.uint64(bits):
            bits += 1
        shift = max(bits - 2 * _DIGIT_BITS, 0)  # then, where disorder is left, 0 and two digits up
        moves: Any = -1
        while moves < 0:
            lower, upper = np.uint64(shift), np.uint64(shift + _DIGIT_BITS)
            for digit in range(_DIGITS):
                cursor[0, digit] = cursor[1, digit] = np.uint64(0)
            for j in range(start, stop):
                key = spare_keys[j] - least
                cursor[0, (key >> lower) & mask] += one
                cursor[1, (key >> upper) & mask] += one
            running, again = before, start
            for digit in range(_DIGITS):
                here, there = cursor[0, digit], cursor[1, digit]
                cursor[0, digit], cursor[1, digit] = running, again
                running, again = running + here, again + there
            for j in range(start, stop):
                slot = ((spare_keys[j] - least) >> lower) & mask
                place = cursor[0, slot]
                cursor[0, slot] = place + one
                index[place], keys[place] = spare[j], spare_keys[j]
            for j in range(before, running):
                slot = ((keys[j] - least) >> upper) & mask
                place = cursor[1, slot]
                cursor[1, slot] = place + one
                spare[place], spare_keys[place] = index[j], keys[j]
            shift = 0 if shift + 2 * _DIGIT_BITS >= bits else shift + 2 * _DIGIT_BITS
            if shift:
                continue
            moves = _MOST_MOVES * np.int64(stop - start)
            for j in range(start, stop):
                key, place = spare_keys[j], before + (j - start)
                while place > before and keys[place - one] > key and moves >= 0:
                    index[place], keys[place] = index[place - one], keys[place - one]
                    place -= one
                    moves -= 1
                index[place], keys[place] = spare[j], key
