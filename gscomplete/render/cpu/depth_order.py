"""Order the splats of one view by depth: a stable radix sort.

Conventions
-----------
* Depths are positive float64 seen as integers, of which the upper 44 bits are sorted: float32
  depths would swap neighbours that overlap, which shows in the picture.
* The order is that of (key, index), whichever way it is found: threads and bounds of parts decide
  nothing about it.
* Every thread sorts a range of depths of its own: scattered writes of two threads into one range
  share cache lines, which costs what they gain.
* Two sweeps sort by the upper 22 of the bits in which a part's keys differ. Few neighbours are in
  disorder then, and are put right one by one; where they are many, all bits are sorted by.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from gscomplete.util.kernels import HELPER, KERNEL, run_kernel

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


def depth_order(visible: Any, depth_bits: Any) -> tuple[Any, Any]:  # [N] uint8, [N] uint64
    """Return visible splats sorted by depth, ties by index [M] int32, and their keys [M] uint64."""
    count = int(np.count_nonzero(visible))
    parts = max(1, min(numba.get_num_threads(), count // _FEWEST_PER_PART))
    bounds = _bounds(visible, depth_bits, parts)
    index, keys = np.empty(count, np.int32), np.empty(count, np.uint64)
    spare, spare_keys = (np.empty((parts, count + 1), array.dtype) for array in (index, keys))
    run_kernel(_sort_parts, parts, 1, visible, depth_bits, bounds, spare, spare_keys, index, keys)
    return index, keys


def _bounds(visible: Any, depth_bits: Any, parts: int) -> Any:  # [parts + 1] uint64
    """Cut the keys into ranges of about the same number of splats."""
    bounds = np.zeros(parts + 1, np.uint64)
    bounds[parts] = _NO_BOUND
    if parts > 1:
        step = max(1, len(visible) // (parts * _SAMPLES))
        seen = np.sort(depth_bits[::step][visible[::step] != 0] >> np.uint64(64 - _KEY_BITS))
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
    spare: Any,  # [parts, M + 1] int32, written
    spare_keys: Any,  # [parts, M + 1] uint64, written
    index: Any,  # [M] int32, written
    keys: Any,  # [M] uint64, written
) -> None:
    """Sort the keys within the bounds of each part to their places among all keys."""
    cursor = np.empty((2, _DIGITS), np.int64)
    for part in range(first, last):
        one, one_key = spare[part], spare_keys[part]
        low, high = bounds[part], bounds[part + 1]
        count: Any = 0
        before: Any = 0
        for i in range(visible.shape[0]):
            k = depth_bits[i] >> np.uint64(64 - _KEY_BITS)
            shown = visible[i] != 0
            one[count], one_key[count] = i, k  # kept if it counts, for a branch is guessed wrong
            count += np.int64(shown & (k >= low) & (k < high))
            before += np.int64(shown & (k < low))
        place = slice(before, before + count)
        _sort(one[:count], one_key[:count], index[place], keys[place], cursor)


@numba.njit(**HELPER)
def _sort(one: Any, one_key: Any, two: Any, two_key: Any, cursor: Any) -> None:
    """Sort ``one`` by its keys into ``two``; both are overwritten."""
    count = one.shape[0]
    low, high = np.uint64(0xFFFFFFFFFFFFFFFF), np.uint64(0)
    for j in range(count):
        low, high = min(low, one_key[j]), max(high, one_key[j])
    bits = 0
    while count > 0 and bits < _KEY_BITS and (high - low) >> np.uint64(bits):
        bits += 1
    shift = max(bits - 2 * _DIGIT_BITS, 0)
    if bits:
        _sweep_pair(one, one_key, two, two_key, cursor, low, shift)
    if not _put_right(one, one_key, two, two_key):
        for lowest in range(0, bits, 2 * _DIGIT_BITS):
            _sweep_pair(one, one_key, two, two_key, cursor, low, lowest)
        two[:], two_key[:] = one, one_key


@numba.njit(**HELPER)
def _sweep_pair(
    one: Any, one_key: Any, two: Any, two_key: Any, cursor: Any, low: Any, shift: int
) -> None:
    """Sort ``one`` stably by two digits of its keys less ``low``, from bit ``shift`` on."""
    mask = np.uint64(_DIGITS - 1)
    lower, upper = np.uint64(shift), np.uint64(shift + _DIGIT_BITS)
    cursor[:] = 0
    for j in range(one.shape[0]):
        k = one_key[j] - low
        cursor[0, (k >> lower) & mask] += 1
        cursor[1, (k >> upper) & mask] += 1
    for sweep in range(2):
        running = 0
        for digit in range(_DIGITS):
            here = cursor[sweep, digit]
            cursor[sweep, digit] = running
            running += here
    for j in range(one.shape[0]):
        digit = ((one_key[j] - low) >> lower) & mask
        place = cursor[0, digit]
        cursor[0, digit] = place + 1
        two[place], two_key[place] = one[j], one_key[j]
    for j in range(one.shape[0]):
        digit = ((two_key[j] - low) >> upper) & mask
        place = cursor[1, digit]
        cursor[1, digit] = place + 1
        one[place], one_key[place] = two[j], two_key[j]


@numba.njit(**HELPER)
def _put_right(one: Any, one_key: Any, two: Any, two_key: Any) -> bool:
    """Insert ``one`` into ``two`` by keys; return False where that takes too many moves."""
    moves = _MOST_MOVES * one.shape[0]
    for j in range(one.shape[0]):
        k, place = one_key[j], j
        while place > 0 and two_key[place - 1] > k and moves > 0:
            two[place], two_key[place] = two[place - 1], two_key[place - 1]
            place -= 1
            moves -= 1
        two[place], two_key[place] = one[j], k
    return moves > 0
