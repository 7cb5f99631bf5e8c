"""Spread the blocks of a record table over a few threads.

Conventions
-----------
* A block is a slice of rows whose records fit the processor's cache: what one pass has just read,
  the next finds there.
* The work touches nothing but its own rows.
* The number of threads is Numba's (``NUMBA_NUM_THREADS``), at most ``MAX_THREADS``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import numba
import numpy as np
from numpy.typing import NDArray

from gscomplete.util.kernels import share_out

BLOCK_BYTES = 1 << 19
"""Bytes of records in a block: half of what a core's second-level cache holds."""

WRITE_BYTES = 1 << 22
"""Bytes handed to the system at once when writing: it does large pieces in less time."""

MAX_THREADS = 4
"""More threads than this only queue for the memory."""


class Scratch(threading.local):
    """A buffer of each thread's own that lasts over its blocks, so that it stays in the cache."""

    def __init__(self) -> None:
        """Start without memory."""
        self._records = np.empty(0, np.void)

    def records(self, count: int, dtype: np.dtype) -> NDArray[np.void]:  # [count]
        """Return ``count`` records with the values they last had, or arbitrary ones."""
        if len(self._records) < count or self._records.dtype != dtype:
            self._records = np.empty(count, dtype)
        return self._records[:count]


def blocks(count: int, row_size: int, block_bytes: int | None = None) -> Iterator[slice]:
    """Cut ``count`` rows of ``row_size`` bytes into slices of ``block_bytes`` (``BLOCK_BYTES``)."""
    step = max(1, (block_bytes or BLOCK_BYTES) // max(row_size, 1))
    for start in range(0, count, step):
        yield slice(start, min(start + step, count))


def for_each_block(
    count: int, row_size: int, work: Callable[[slice], None], block_bytes: int | None = None
) -> None:
    """Call ``work`` for every block of rows, in threads when there are several blocks.

    Args:
        count: number of rows.
        row_size: bytes of one record.
        work: what to do with a slice of rows.
        block_bytes: bytes of records in a block; None = ``BLOCK_BYTES``.

    Raises:
        Exception: what ``work`` raised for the first block that failed; later blocks may be left
            undone.
    """
    todo = list(blocks(count, row_size, block_bytes))
    threads = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    share_out(lambda number: work(todo[number]), len(todo), min(threads, MAX_THREADS))
