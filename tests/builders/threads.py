"""Numbers of threads that results must not depend on."""

from __future__ import annotations

from collections.abc import Iterator

import numba
import torch


def each_thread_count() -> Iterator[int]:
    """Set PyTorch and the kernels to one thread, then to two; set them back at the end."""
    before = torch.get_num_threads(), numba.get_num_threads()
    try:
        for count in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            torch.set_num_threads(count)
            numba.set_num_threads(count)
            yield count
    finally:
        torch.set_num_threads(before[0])
        numba.set_num_threads(before[1])
