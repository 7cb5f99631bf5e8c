"""Nearest neighbours of many points, in threads that end safely when a signal arrives.

Conventions
-----------
* SciPy's own ``workers`` are daemon threads: when Ctrl-C or SIGTERM ends the wait for them, they
  still read the tree while the interpreter shuts down, and the process dies of a segmentation
  fault. The threads of a pool are always waited for.
* Each row is queried by exactly one thread, so results do not depend on the number of threads.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gscomplete.util.arrays import Float64Array

_FEWEST_ROWS = 4096
"""A thread is started for at least this many points."""


def query_nearest(
    tree: cKDTree,
    points: NDArray[Any],  # [N, D]
    k: int | Sequence[int] = 1,
    within: float = math.inf,
) -> tuple[Float64Array, NDArray[np.intp]]:  # [N], or [N, K] for a sequence or k > 1
    """Return distances and indices of the nearest points of a tree, as ``cKDTree.query`` does.

    Args:
        tree: of M points of D dimensions.
        points: query points.
        k: number of neighbours, or a sequence of ranks (1 = the nearest).
        within: neighbours at this distance or beyond count as infinitely far, which saves time.
    """

    def ask(rows: NDArray[Any]) -> tuple[Float64Array, NDArray[np.intp]]:
        return tree.query(rows, k=k, distance_upper_bound=within)

    threads = min(torch.get_num_threads(), len(points) // _FEWEST_ROWS)
    if threads <= 1:
        return ask(points)
    with ThreadPoolExecutor(threads) as pool:
        parts = pool.map(ask, np.array_split(points, threads))
        distances, indices = zip(*parts, strict=True)
    return np.concatenate(distances), np.concatenate(indices)
