"""Which photos of known poses are compared: those that can show the same surface."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

WIDEST_TURN_DEG = 60.0
"""Photos whose viewing directions differ by more share no features: SIFT stands half of that."""


def near_pairs(
    poses: Mapping[str, NDArray[np.float64]],  # camera_from_world [4, 4] by name
    neighbours: int,
) -> list[tuple[str, str]]:
    """Pair every photo with the nearest ones that are taken in a like direction.

    Args:
        poses: of every photo; cameras see along +z.
        neighbours: most photos that one photo asks for; it may be asked for by others, too.

    Returns:
        Pairs of names, each once, in the order of ``poses``.
    """
    names = list(poses)
    matrices = np.stack([np.asarray(poses[name], np.float64) for name in names])
    rotations, shifts = matrices[:, :3, :3], matrices[:, :3, 3]
    centers = -np.einsum("nji,nj->ni", rotations, shifts)
    directions = rotations[:, 2]
    distances = np.linalg.norm(centers[:, None] - centers, axis=2)
    turned = directions @ directions.T < np.cos(np.radians(WIDEST_TURN_DEG))
    distances[turned] = np.inf
    np.fill_diagonal(distances, np.inf)
    nearest = np.argsort(distances, axis=1, kind="stable")[:, :neighbours]
    chosen = np.zeros(distances.shape, np.bool_)
    np.put_along_axis(chosen, nearest, True, axis=1)
    chosen &= np.isfinite(distances)
    first, second = np.nonzero(np.triu(chosen | chosen.T))
    return [(names[i], names[j]) for i, j in zip(first, second, strict=True)]
