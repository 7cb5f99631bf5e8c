"""What this machine can do at most: bytes copied and multiply-adds made in a second.

Conventions
-----------
* The copy is NumPy's, of arrays far larger than the caches, in as many threads as asked; a byte
  copied counts twice, read and written.
* The multiply-adds are chains of 8 in float32 over an array that stays in the first-level cache,
  compiled by Numba as the renderer is; one multiply-add counts as 2 operations.
* Both are the best of several repeats: a limit, not an average.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

_CHAIN = 8
_VALUES = 2048
_PASSES = 1600
_COPY_FLOATS = 16 * 2**20


@dataclass(frozen=True, slots=True)
class MachineLimits:
    """Upper bounds of the machine with a number of threads."""

    threads: int
    copy_gb_s: float
    """Gigabytes read plus written in a second by a copy."""
    gflop_s: float
    """Thousand million float32 operations in a second, a multiply-add counted as 2."""


@numba.njit(cache=True, parallel=True, fastmath={"contract"}, error_model="numpy")
def _multiply_adds(values: Any, passes: int, scale: Any, shift: Any) -> None:  # [threads, n]
    """Replace every value by 8 multiply-adds of itself, ``passes`` times."""
    for thread in numba.prange(values.shape[0]):
        row = values[thread]
        for _ in range(passes):
            for k in range(np.uint64(_VALUES)):
                x = row[k]
                for _ in range(_CHAIN):
                    x = x * scale + shift
                row[k] = x


def measure_limits(
    threads: int, repeats: int = 30, read: Callable[[], float] = time.perf_counter
) -> MachineLimits:
    """Measure both limits with this many threads (about a second)."""
    rates = (_copy_rate(threads, repeats, read), _operation_rate(threads, repeats, read))
    return MachineLimits(threads, *rates)


def _copy_rate(threads: int, repeats: int, read: Callable[[], float]) -> float:
    source = np.ones((threads, _COPY_FLOATS // threads), np.float32)
    target = np.zeros_like(source)
    seconds = []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(repeats):
            start = read()
            list(pool.map(np.copyto, target, source))
            seconds.append(read() - start)
    return 2 * source.nbytes / min(seconds) / 1e9


def _operation_rate(threads: int, repeats: int, read: Callable[[], float]) -> float:
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    values = np.ones((threads, _VALUES), np.float32)
    numbers = np.float32(0.999), np.float32(0.001)
    _multiply_adds(values, 1, *numbers)
    seconds = []
    for _ in range(repeats):
        start = read()
        _multiply_adds(values, _PASSES, *numbers)
        seconds.append(read() - start)
    numba.set_num_threads(before)
    return 2.0 * threads * _VALUES * _CHAIN * _PASSES / min(seconds) / 1e9
