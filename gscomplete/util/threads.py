"""The same bytes whatever the number of processors.

Conventions
-----------
* PyTorch divides a sum among its threads, and rounds with the division. So what decides a result is
  computed with one number of threads everywhere, on fewer cores too. Numba's kernels give each
  thread rows of its own: their threads may be as many as there are cores.
* Across kinds of processors (AVX2, AVX-512, ARM) and versions of PyTorch, bytes still differ.
"""

from __future__ import annotations

import contextlib
import platform
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np
import scipy
import torch

import gscomplete

SUM_THREADS = 4
"""PyTorch's threads: on two cores they take turns."""


@contextlib.contextmanager
def fixed_threads() -> Iterator[None]:
    """Have PyTorch compute with ``SUM_THREADS`` threads in the block, or the decorated function."""
    before = torch.get_num_threads()
    torch.set_num_threads(SUM_THREADS)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def made_with() -> dict[str, Any]:
    """Return what bytes depend on besides the input, as JSON values."""
    return {
        "gscomplete": gscomplete.__version__,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": np.__version__,
        "numba": numba.__version__,
        "scipy": scipy.__version__,
        "torch_threads": torch.get_num_threads(),
        "numba_threads": numba.get_num_threads(),
        "processor": f"{platform.machine()} {torch.backends.cpu.get_cpu_capability()}",
    }


def differences_note(before: object) -> tuple[str, ...]:
    """Tell what has changed since a run began; its bytes may be others.

    Args:
        before: ``made_with`` of then, from a file that may be damaged.
    """
    now = made_with()
    if not isinstance(before, dict):
        return ()
    changed = [
        f"{name} {before[name]} (now {value})"
        for name, value in now.items()
        if name != "numba_threads" and name in before and before[name] != value
    ]
    if not changed:
        return ()
    return (
        f"resuming a run begun with {', '.join(changed)}: the result may differ in its last digits",
    )
