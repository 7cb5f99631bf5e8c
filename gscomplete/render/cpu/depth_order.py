"""Order the splats of one view by depth: a stable radix sort.

Conventions
-----------
* Depths are positive float64 seen as integers, of which the upper 44 bits are sorted: float32
  depths would swap neighbours that overlap, which shows in the picture.
* Digits are taken from the keys less the smallest one: the depths of a scene differ in few of their
  upper bits, and a digit that no key has is not sorted by.
* One thread sorts: scattered writes of two share cache lines, which costs what they gain.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from gscomplete.util.kernels import KERNEL

_DIGIT_BITS = 11
_SWEEPS = 4
_KEY_BITS = _SWEEPS * _DIGIT_BITS


def depth_order(visible: Any, depth_bits: Any) -> tuple[Any, Any]:  # [N] uint8, [N] uint64
    """Return visible splats sorted by depth, ties by index [M] int32, and their keys [M] uint64."""
    count = int(np.count_nonzero(visible))
    index, keys = np.empty((2, count), np.int32), np.empty((2, count), np.uint64)
    cursor = np.zeros((_SWEEPS, 1 << _DIGIT_BITS), np.int64)
    result = _radix_sort(visible, depth_bits, *index, *keys, cursor)
    return index[result], keys[result]


@numba.njit(**KERNEL)
def _radix_sort(
    visible: Any,  # [N] uint8
    depth_bits: Any,  # [N] uint64
    index: Any,  # [M] int32, written, as those below
    index2: Any,
    key: Any,  # [M] uint64
    key2: Any,
    cursor: Any,  # [_SWEEPS, 1 << _DIGIT_BITS] zeros
) -> int:
    """Sort by the upper bits; return which of the two pairs of arrays has the result."""
    count = index.shape[0]
    n = 0
    low, high = np.uint64(0xFFFFFFFFFFFFFFFF), np.uint64(0)
    for i in range(visible.shape[0]):
        if visible[i]:
            k = depth_bits[i] >> np.uint64(64 - _KEY_BITS)
            low, high = min(low, k), max(high, k)
            index[n], key[n] = i, k
            n += 1
    sweeps = 0
    while count > 0 and sweeps < _SWEEPS and (high - low) >> np.uint64(sweeps * _DIGIT_BITS):
        sweeps += 1
    mask = np.uint64(cursor.shape[1] - 1)
    for j in range(count):
        k = key[j] - low
        for sweep in range(sweeps):
            cursor[sweep, (k >> np.uint64(sweep * _DIGIT_BITS)) & mask] += 1
    for sweep in range(sweeps):
        running = 0
        for digit in range(cursor.shape[1]):
            here = cursor[sweep, digit]
            cursor[sweep, digit] = running
            running += here
        shift = np.uint64(sweep * _DIGIT_BITS)
        for j in range(count):
            digit = ((key[j] - low) >> shift) & mask
            place = cursor[sweep, digit]
            cursor[sweep, digit] = place + 1
            index2[place], key2[place] = index[j], key[j]
        index, index2 = index2, index
        key, key2 = key2, key
    return sweeps % 2
