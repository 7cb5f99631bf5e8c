"""Where a surface of points ends: there the neighbours of a point lie to one side of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ON_RIM = 0.5
"""Points of which ``one_sidedness`` is larger are on the rim."""


def one_sidedness(ways: NDArray[np.floating]) -> NDArray[np.floating]:  # [N, K, 3] -> [N]
    """Say how much of the ways from points to their neighbours leads to one side.

    Args:
        ways: from each of N points to its K nearest neighbours.

    Returns:
        The length of the mean way as a share of the mean length: near 0 within a surface, about 0.5
        at a straight rim, and up to 1 beyond it. 0 without neighbours.
    """
    if ways.shape[1] == 0:
        return np.zeros(len(ways), ways.dtype)
    length = np.linalg.norm(ways, axis=2).mean(axis=1)
    return np.linalg.norm(ways.mean(axis=1), axis=1) / length.clip(1e-6)
