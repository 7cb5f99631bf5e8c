"""Likely planes of symmetry, found in three steps of rising cost.

All planes are ranked by the evidence for them (``coarse_scorer``); the best ones that differ are
scored on voxels (``fine_scorer``); the best of those are moved to where P and its copy agree.

Conventions
-----------
* Planes are numbered as in ``planes.features``: (angle, offset).
* A plane's score is the fine scorer's belief in it and those near it, in [0, 1].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gscomplete.networks.perceptron import Perceptron
from gscomplete.networks.precision import cpu_precision
from gscomplete.shape.evidence import Evidence
from gscomplete.shape.partial_voxels import PartialVoxels
from gscomplete.shape.planes.coarse_scorer import packaged_coarse_scorer
from gscomplete.shape.planes.features import (
    ANGLES,
    OFFSETS,
    PartSamples,
    plane_features,
    plane_places,
)
from gscomplete.shape.planes.fine_scorer import (
    colored_cells,
    folded_volumes,
    packaged_fine_scorer,
)
from gscomplete.shape.symmetry import SymmetryMap, mirror
from gscomplete.shape.voxels import CELL_SIDE
from gscomplete.util.arrays import BoolArray, Float32Array

FINELY_SCORED = 48
"""How many planes the fine scorer ranks. On 45 cuts of 15 real objects the true score of the best
of 48 planes is .68 on average, of the best of 8 .63, of the best of all planes .72."""
APART_DEG = 11.0
APART_OFFSET = 0.05
"""Planes that the fine scorer ranks differ from each other by at least one of these."""
_NEAR_DEG = 15.0
_NEAR_OFFSET = 0.1
"""Planes that differ by less than both are nearly the same: the beliefs in them add up."""
_REFINEMENTS = 6
_FEWEST_MATCHES = 40
_LARGEST_TURN = math.radians(8.0)
_LARGEST_MOVE = 0.05
"""Most that refinement may turn a plane, and move it in object sizes."""


@dataclass(frozen=True, slots=True)
class RankedPlanes:
    """The planes that the coarse scorer puts first, in its order."""

    planes: NDArray[np.intp]  # [K, 2] angle, offset
    features: Float32Array  # [K, F]
    logits: Float32Array  # [K] the coarse scorer's


def ranked_planes(
    part: PartSamples, evidence: Evidence, scorer: Perceptron, count: int
) -> RankedPlanes:
    """Return the planes that the scorer ranks first and that differ from each other."""
    features = plane_features(part, evidence)
    logits = scorer(features)
    planes = distinct_planes(logits, count)
    a, o = planes.T
    return RankedPlanes(planes, features[a, o], logits[a, o])


def distinct_planes(
    symmetry_scores: Float32Array, count: int
) -> NDArray[np.intp]:  # [A, O] -> [K, 2]
    """Return at most ``count`` planes that differ from each other, the best first."""
    left = symmetry_scores.astype(np.float64)
    found: list[tuple[int, int]] = []
    while len(found) < count and np.isfinite(left).any():
        a, o = np.unravel_index(int(left.argmax()), left.shape)
        found.append((int(a), int(o)))
        left[_alike(int(a), int(o), APART_DEG, APART_OFFSET)] = -np.inf
    return np.array(found)


def candidate_planes(
    voxels: PartialVoxels, count: int, *, bfloat16: bool = False
) -> list[SymmetryMap]:
    """Return mirror images through the planes of highest score, the best first.

    Args:
        voxels: P.
        count: how many planes.
        bfloat16: precision of the fine scorer.
    """
    part = voxels.samples()
    ranked = ranked_planes(part, voxels.evidence, packaged_coarse_scorer(), FINELY_SCORED)
    angles, offsets = plane_places(ranked.planes)
    volumes = folded_volumes(colored_cells(voxels.volume), voxels.shares, angles, offsets)
    with torch.no_grad(), cpu_precision(bfloat16=bfloat16):
        logits, _ = packaged_fine_scorer()(
            volumes, torch.from_numpy(ranked.features), torch.from_numpy(ranked.logits)
        )
    belief = torch.softmax(logits.double(), dim=0).numpy()
    tree = cKDTree(part.spread)
    found = []
    for index in np.argsort(-belief, kind="stable")[:count]:
        a, o = ranked.planes[index]
        near = _alike(int(a), int(o), _NEAR_DEG, _NEAR_OFFSET)
        score = belief[near[ranked.planes[:, 0], ranked.planes[:, 1]]].sum()
        place = refined(part, tree, float(angles[index]), float(offsets[index]))
        found.append(mirror(*place, float(score)))
    return found


def refined(
    part: PartSamples, tree: cKDTree, angle: float, offset: float
) -> tuple[float, float]:  # radians, object sizes
    """Move a plane to where P's copy fits P best, by point-to-plane Gauss-Newton steps.

    Only samples whose copy is within a cell and a half of P count; with too few the plane stays.
    """
    found = angle, offset
    for _ in range(_REFINEMENTS):
        nx, ny = math.cos(found[0]), math.sin(found[0])
        normal = np.array([nx, ny, 0.0])
        across = np.array([-ny, nx, 0.0])
        along = part.points @ normal
        copies = part.points + 2 * (found[1] - along)[:, None] * normal
        distance, index = tree.query(copies)
        # Samples in the plane are their own copies, so they do not tell where it is.
        use = (distance < 1.5 * CELL_SIDE) & (np.abs(found[1] - along) > 1.5 * CELL_SIDE)
        if use.sum() < _FEWEST_MATCHES:
            break
        turned = part.normals[use] - 2 * (part.normals[use] @ normal)[:, None] * normal
        gap = ((part.spread[index[use]] - copies[use]) * turned).sum(axis=1)
        by_offset = 2 * (turned @ normal)
        by_angle = -2 * (part.points[use] @ across) * (turned @ normal)
        by_angle += 2 * (found[1] - along[use]) * (turned @ across)
        slopes = np.stack([by_angle, by_offset], axis=1)
        weight = 1.0 / (1.0 + np.square(gap / (0.3 * CELL_SIDE)))
        system = (slopes * weight[:, None]).T @ slopes + np.eye(2) * 1e-2 * len(gap)
        move = np.linalg.solve(system, (slopes * weight[:, None]).T @ gap)
        found = (
            angle + float(np.clip(found[0] + move[0] - angle, -_LARGEST_TURN, _LARGEST_TURN)),
            offset + float(np.clip(found[1] + move[1] - offset, -_LARGEST_MOVE, _LARGEST_MOVE)),
        )
    return found


def _alike(
    angle_index: int, offset_index: int, apart_deg: float, apart_offset: float
) -> BoolArray:  # [A, O]
    """Mark the planes that differ from one plane, itself included, by less than both limits."""
    turn = np.abs(np.arange(ANGLES) - angle_index) * (180.0 / ANGLES)
    # A normal turned by half a turn describes the same plane with the opposite offset.
    sign = np.where(turn > 90.0, -1.0, 1.0)[:, None]
    apart = np.abs(sign * np.array(OFFSETS) - OFFSETS[offset_index])
    near_turn = np.minimum(turn, 180.0 - turn)[:, None] < apart_deg
    return near_turn & (apart < apart_offset)
