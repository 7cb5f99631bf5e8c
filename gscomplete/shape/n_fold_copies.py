"""P's own splats, turned by the steps of its n-fold symmetry to where P lacks them.

The object is cut into n sectors about the axis. Those that P covers best are copied to the others,
each of which gets one copy, of the nearest of them.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from gscomplete.shape.assemble import beyond, hides_nothing
from gscomplete.shape.evidence import Evidence
from gscomplete.shape.symmetry import SymmetryMap, mirror_image
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.geometry.n_fold import NFold

_PHASES = 8
"""Places of the sectors' borders that are tried: P covers one sector as well as possible."""
_COVERED = 0.95
"""Sectors count as covered if they have this share of the splats of the one that has most."""
_MOST_HIDING = 0.1
"""There are no copies if views see more of them in front of P."""
_LEAST_COPIED = 0.03
"""Nor if they are fewer than this share of P's splats."""


def n_fold_copies(
    partial: Splats, fold: NFold, evidence: Evidence, generator: torch.Generator
) -> Splats | None:
    """Return copies of P's splats where P has none; None = views contradict them, or P lacks few.

    Args:
        partial: P in the object frame.
        fold: the symmetry of P's centres.
        evidence: what V's views say about space.
        generator: chooses the splats of P that copies are compared with, if there are too many.
    """
    body = partial.select(torch.from_numpy(fold.is_body))
    places = body.means.double().numpy()[:, :2] - fold.center
    turns = np.arctan2(places[:, 1], places[:, 0]) / (2 * math.pi) * fold.folds
    phases = np.arange(_PHASES) / _PHASES
    sectors = [np.floor(turns + phase).astype(int) % fold.folds for phase in phases]
    counts = [np.bincount(sector, minlength=fold.folds) for sector in sectors]
    best = int(np.argmax([count.max() for count in counts]))
    sector, count = sectors[best], counts[best]
    covered = np.flatnonzero(count >= _COVERED * count.max())
    copies = []
    for target in np.setdiff1d(np.arange(fold.folds), covered):
        steps = (target - covered + fold.folds // 2) % fold.folds - fold.folds // 2
        step = int(steps[np.abs(steps).argmin()])
        source = body.select(torch.from_numpy(sector == (target - step) % fold.folds))
        copies.append(mirror_image(source, _turn(fold, step)))
    if not copies:
        return None
    found = beyond(concatenate(copies), partial, generator)
    allowed = hides_nothing(found, evidence)
    found_share = len(found) / len(partial)
    if found_share < _LEAST_COPIED or float(allowed.double().mean()) < 1.0 - _MOST_HIDING:
        return None
    return found.select(allowed)


def _turn(fold: NFold, step: int) -> SymmetryMap:
    """Return the turn by whole steps of a symmetry."""
    matrix = fold.rotation(step).astype(np.float32)
    center = np.array([*fold.center, 0.0], np.float32)
    return SymmetryMap(matrix, center - matrix @ center, 1.0)
