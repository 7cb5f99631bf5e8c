"""The surface about a point, from the point's neighbours: its normal, and whether it ends there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

ON_RIM = 0.5
"""Points of which ``one_sidedness`` is larger are on the rim."""
_NORMAL_NEIGHBOURS = 16


def one_sidedness(ways: NDArray[np.floating]) -> NDArray[np.floating]:  # [N, K, 3] -> [N]
    """Return how much the neighbours of points lie to one side.

    Args:
        ways: offsets from each of N points to its K nearest neighbours.

    Returns:
        The length of the mean offset over the mean length of the offsets: near 0 within a surface,
        about 0.5 at a straight rim, up to 1 beyond it, and 0 without neighbours.
    """
    if ways.shape[1] == 0:
        return np.zeros(len(ways), ways.dtype)
    length = np.linalg.norm(ways, axis=2).mean(axis=1)
    return np.linalg.norm(ways.mean(axis=1), axis=1) / length.clip(1e-6)


def normals_of(
    neighbours: NDArray[np.float64],  # [N, K, 3]
) -> NDArray[np.float64]:  # [N, 3]
    """Return unit normals, of either sign: the directions along which neighbours vary least.

    Args:
        neighbours: the K nearest points of each of N places.
    """
    offsets = neighbours - neighbours.mean(axis=1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))[1][:, :, 0]


def normals_at(
    places: NDArray[np.float64],  # [K, 3]
    points: NDArray[np.float64],  # [N, 3]
    tree: cKDTree,
) -> NDArray[np.float64]:  # [K, 3]
    """Return unit normals of the surface of points, of either sign; ``tree`` holds the points."""
    _, index = tree.query(places, k=_NORMAL_NEIGHBOURS + 1)
    return normals_of(points[index])
