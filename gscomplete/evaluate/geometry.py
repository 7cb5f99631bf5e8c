"""How near a completion's new surface is to the true surface that P does not show.

Conventions
-----------
* Object frame: distances are shares of the object's largest side. Surfaces are the centres of
  splats with an opacity above ``SOLID``. Both surfaces are first thinned to one point per cell of
  ``SPACING``, so that neither the density nor the order of a method's splats matters.
* Hidden truth is the true surface farther than ``OWN`` from P's surface; new surface is the
  completion's surface farther than ``OWN`` from P's.
* The chamfer distance is the mean of two mean nearest distances: from hidden truth to the
  completion (with P) and from new surface to the truth. Recall and precision are the shares of
  hidden truth and of new surface within a distance; the F-score is their harmonic mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gscomplete.splats import Splats
from gscomplete.util.arrays import Float64Array

SOLID = 0.3
"""Opacity above which a splat counts as surface."""
SPACING = 0.005
"""Side of the cells that surfaces are thinned to."""
OWN = 0.015
"""Surface this near to P's is P's own."""
_FEWEST = 20
"""With fewer places of hidden truth there is nothing to measure."""


@dataclass(frozen=True, slots=True)
class HiddenSurfaceErrors:
    """Distances between the new surface and the hidden truth."""

    chamfer: float | None
    """Mean of both mean distances; None where the completion adds no surface."""
    f_score_1: float
    """F-score within 1 % of the object's size."""
    f_score_3: float
    """F-score within 3 % of the object's size."""
    hidden_share: float
    """Share of the truth's surface that P does not show."""


def hidden_surface_errors(
    completed: Splats, partial: Splats, truth: Splats
) -> HiddenSurfaceErrors | None:
    """Compare surfaces; None = P shows nearly all of the truth.

    Args:
        completed: O in the object frame.
        partial: P in the object frame.
        truth: T in the object frame.
    """
    known, real = _surface(partial), _surface(truth)
    found = _surface(completed)
    hidden = real[_distances(real, known) > OWN]
    if len(hidden) < _FEWEST:
        return None
    new = found[_distances(found, known) > OWN]
    reach = _distances(hidden, np.concatenate([known, new]))
    excess = _distances(new, real)
    chamfer = 0.5 * float(reach.mean() + excess.mean()) if len(new) else None
    return HiddenSurfaceErrors(
        chamfer, _f_score(reach, excess, 0.01), _f_score(reach, excess, 0.03),
        len(hidden) / len(real),
    )  # fmt: skip


def _surface(splats: Splats) -> Float64Array:  # [n, 3]
    """Return the centres of solid splats, averaged by cell."""
    solid = splats.opacities > SOLID
    means = splats.means[solid].detach().double().cpu().numpy()
    means = means[np.isfinite(means).all(axis=1) & (np.abs(means) < 1e3).all(axis=1)]
    if len(means) == 0:
        return np.zeros((0, 3))
    _, row, count = np.unique(
        np.floor(means / SPACING).astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    row = row.reshape(-1)
    sums = [np.bincount(row, means[:, axis], len(count)) for axis in range(3)]
    return np.stack(sums, axis=1) / count[:, None]


def _distances(points: Float64Array, surface: Float64Array) -> Float64Array:  # [n]
    """Return the distance of every point to the nearest of a surface; infinite if that is empty."""
    if len(surface) == 0 or len(points) == 0:
        return np.full(len(points), np.inf)
    return np.asarray(cKDTree(surface).query(points)[0])


def _f_score(reach: Float64Array, excess: Float64Array, limit: float) -> float:
    """Return the harmonic mean of recall and precision within a distance."""
    recall = float((reach < limit).mean())
    precision = float((excess < limit).mean()) if len(excess) else 0.0
    return 2 * recall * precision / (recall + precision) if recall + precision > 0 else 0.0
