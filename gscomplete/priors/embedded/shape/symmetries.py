"""Mirror images of P that may show what is missing.

Most objects have an upright plane of symmetry, and many have two, so what P lacks is often there,
elsewhere: on real objects one well-chosen plane shows most of what is missing. Planes are ranked by
a small trained network and moved to where P and its copy agree best. The shape network is shown the
copies through two of them (``choice``) and their composition, and decides what to take.

Conventions
-----------
* A map takes x to ``matrix x + shift`` in the object frame.
* A map's score is the ranker's belief in its plane and those near it, in [0, 1].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gscomplete.priors.embedded.shape.evidence import Evidence
from gscomplete.priors.embedded.shape.grid import CELL_SIDE, FloatArray
from gscomplete.priors.embedded.shape.plane_ranker import PlaneRanker
from gscomplete.priors.embedded.shape.planes import (
    ANGLES,
    OFFSETS,
    PartSamples,
    plane_features,
)
from gscomplete.splats.transform import Similarity

COPIES = 3
_APART_DEG = 15.0
_APART_OFFSET = 0.1
"""Planes are unlike each other if they differ by more than one of these."""
_REFINEMENTS = 4
_FEWEST_MATCHES = 40
_LARGEST_TURN = math.radians(4.0)
_LARGEST_MOVE = 0.03


@dataclass(frozen=True, slots=True)
class SymmetryMap:
    """A rigid map of P onto what it may lack."""

    matrix: FloatArray  # [3, 3] orthogonal
    shift: FloatArray  # [3]
    score: float

    def apply(self, points: FloatArray) -> FloatArray:  # [N, 3] -> [N, 3]
        """Map points."""
        return np.ascontiguousarray(points @ self.matrix.T + self.shift, dtype=np.float32)

    def undo(self, points: FloatArray) -> FloatArray:  # [N, 3] -> [N, 3]
        """Map points back."""
        return np.ascontiguousarray((points - self.shift) @ self.matrix, dtype=np.float32)

    def in_frame(self, moved: Similarity) -> SymmetryMap:
        """Return the same map for points that were moved and scaled, not turned."""
        move = moved.translation.numpy().astype(np.float32)
        shift = np.float32(moved.scale) * self.shift + move - self.matrix @ move
        return SymmetryMap(self.matrix, shift.astype(np.float32), self.score)


def candidate_planes(
    part: PartSamples, evidence: Evidence, ranker: PlaneRanker, count: int
) -> list[SymmetryMap]:
    """Return mirror images through likely planes unlike each other, the likeliest first."""
    logits = ranker(plane_features(part, evidence)).astype(np.float64)
    belief = np.exp(logits - logits.max())
    belief /= belief.sum()
    left = belief.copy()
    tree = cKDTree(part.spread)
    found = []
    for _ in range(count):
        index = np.unravel_index(int(left.argmax()), left.shape)
        a, o = int(index[0]), int(index[1])
        alike = _alike(a, o)
        angle, offset = refined(part, tree, math.pi * a / ANGLES, OFFSETS[o])
        found.append(_mirror(angle, offset, float(belief[alike].sum())))
        left[alike] = -1.0
    return found


def shown_symmetries(one: SymmetryMap, other: SymmetryMap) -> tuple[SymmetryMap, ...]:
    """Return what the shape network is shown: two mirror images, and one after the other."""
    both = SymmetryMap(
        other.matrix @ one.matrix,
        other.matrix @ one.shift + other.shift,
        0.5 * (one.score + other.score),
    )
    return one, other, both


def refined(
    part: PartSamples, tree: cKDTree, angle: float, offset: float
) -> tuple[float, float]:  # radians, object sizes
    """Move a plane to where P's copy fits P best: Gauss-Newton, point to surface.

    Only samples that land within a cell and a half of P count; with few of them the plane stays.
    """
    found = angle, offset
    for _ in range(_REFINEMENTS):
        nx, ny = math.cos(found[0]), math.sin(found[0])
        normal = np.array([nx, ny, 0.0])
        across = np.array([-ny, nx, 0.0])
        along = part.points @ normal
        copies = part.points + 2 * (found[1] - along)[:, None] * normal
        distance, index = tree.query(copies)
        # Samples in the plane are their own copies: they say nothing of where it is.
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


def _mirror(angle: float, offset: float, score: float) -> SymmetryMap:
    """Return the mirror image through a plane."""
    normal = np.array([math.cos(angle), math.sin(angle), 0.0])
    matrix = np.eye(3) - 2 * np.outer(normal, normal)
    shift = 2 * offset * normal
    return SymmetryMap(matrix.astype(np.float32), shift.astype(np.float32), score)


def _alike(angle_index: int, offset_index: int) -> NDArray[np.bool_]:  # [ANGLES, offsets]
    """Mark the planes like one, itself included."""
    turn = np.abs(np.arange(ANGLES) - angle_index) * (180.0 / ANGLES)
    # Half a turn further, the same plane has the other sign.
    sign = np.where(turn > 90.0, -1.0, 1.0)[:, None]
    apart = np.abs(sign * np.array(OFFSETS) - OFFSETS[offset_index])
    near_turn = np.minimum(turn, 180.0 - turn)[:, None] < _APART_DEG
    return near_turn & (apart < _APART_OFFSET)
