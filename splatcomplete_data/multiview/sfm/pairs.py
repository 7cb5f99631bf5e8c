"""Which photos of known poses are compared: those that can show the same surface."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from splatcomplete_data.multiview.photos.posed import PosedPhotos

WIDEST_TURN_DEG = 60.0
"""Photos whose viewing directions differ by more share no features: SIFT stands half of that."""


def near_pairs(capture: PosedPhotos, neighbours: int) -> list[tuple[str, str]]:
    """Pair every photo with the nearest ones that are taken in a like direction.

    Args:
        capture: photos with cameras.
        neighbours: most photos that one photo asks for; it may be asked for by others, too.

    Returns:
        Pairs of names, each once, in the photos' order.
    """
    names, positions, forwards = capture.names, capture.positions, capture.forwards
    distances = np.linalg.norm(positions[:, None] - positions, axis=2)
    distances[forwards @ forwards.T < np.cos(np.radians(WIDEST_TURN_DEG))] = np.inf
    np.fill_diagonal(distances, np.inf)
    nearest = np.argsort(distances, axis=1, kind="stable")[:, :neighbours]
    chosen = np.zeros(distances.shape, np.bool_)
    np.put_along_axis(chosen, nearest, True, axis=1)
    chosen &= np.isfinite(distances)
    first, second = np.nonzero(np.triu(chosen | chosen.T))
    return [(names[i], names[j]) for i, j in zip(first, second, strict=True)]


def can_be_listed(names: Iterable[str]) -> bool:
    """Say whether COLMAP's list of pairs can hold the names: it is divided by spaces."""
    return not any(name.startswith("#") or any(map(str.isspace, name)) for name in names)
