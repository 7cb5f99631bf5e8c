"""Numbers of threads that results must not depend on."""

from __future__ import annotations

from collections.abc import Iterator

import numba
import torch

COUNTS = (1, 2, 5)
"""The last divides no size of a grid: parts of the work end within a vector."""


def each_thread_count() -> Iterator[int]:
    """Set PyTorch and the kernels to one thread, two and five; set them back at the end.

    Kernels take no more threads than the process was started for.
    """
    before = torch.get_num_threads(), numba.get_num_threads()
    try:
        for count in COUNTS:
            torch.set_num_threads(count)
            numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
            yield count
    finally:
        torch.set_num_threads(before[0])
        numba.set_num_threads(before[1])
