"""Mirror images of P that may show what is missing.

Most objects have an upright plane of symmetry, and many have two, so what P lacks is often there,
elsewhere. Planes of many directions and offsets are judged by samples of P mirrored through them:
good where they land in new places; bad where they would show from V in front of P or beside it,
where they nearly but not quite meet P, where they leave the frame, or where a gap remains between
the two halves. The network is shown the best two and their composition, and decides.

Conventions
-----------
* A map takes x to ``matrix x + shift`` in the object frame; upright planes face azimuth ``angle``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gscomplete.priors.embedded.shape.evidence import Evidence
from gscomplete.priors.embedded.shape.grid import CELL_SIDE, HALF_SIDE, FloatArray

COPIES = 3
_SAMPLES = 600
_ANGLES = 36
_OFFSETS = tuple(0.025 * k for k in range(-6, 7))
_APART_DEG = 40.0


@dataclass(frozen=True, slots=True)
class SymmetryWeights:
    """What counts against novelty (the share of the copy that is new); shares of the copy."""

    front: float = 3.0
    beside: float = 2.0
    near: float = 0.6
    """For samples that miss P by little: the plane is slightly wrong."""
    outside: float = 1.0
    """For samples outside the object frame's box."""
    gap: float = 4.0
    """Per object size between P and the plane."""
    offset: float = 0.5
    """Per object size between the plane and the frame's centre."""


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


def likely_symmetries(
    points: FloatArray,  # [N, 3]
    occupancy: FloatArray,  # [cells, cells, cells] of P
    evidence: Evidence,
    weights: SymmetryWeights | None = None,
) -> tuple[SymmetryMap, SymmetryMap, SymmetryMap]:
    """Return the best plane, the best one well apart from it, and one after the other."""
    chosen = weights or SymmetryWeights()
    step = max(len(points) // _SAMPLES, 1)
    samples = np.ascontiguousarray(points[::step][:_SAMPLES])
    scores = _score_planes(samples, occupancy, evidence, chosen)
    first = np.unravel_index(int(scores.argmax()), scores.shape)
    apart = np.abs(np.arange(_ANGLES) - first[0]) * (180.0 / _ANGLES)
    apart = np.minimum(apart, 180.0 - apart)
    rest = np.where(apart[:, None] >= _APART_DEG, scores, -np.inf)
    second = np.unravel_index(int(rest.argmax()), rest.shape)
    a, b = (_plane(int(k[0]), int(k[1]), float(scores[k])) for k in (first, second))
    both = SymmetryMap(b.matrix @ a.matrix, b.matrix @ a.shift + b.shift, 0.5 * (a.score + b.score))
    return a, b, both


def _plane(angle_index: int, offset_index: int, score: float) -> SymmetryMap:
    """Return the mirror image through a plane of the table."""
    angle = math.pi * angle_index / _ANGLES
    normal = np.array([math.cos(angle), math.sin(angle), 0.0])
    matrix = np.eye(3) - 2 * np.outer(normal, normal)
    shift = 2 * _OFFSETS[offset_index] * normal
    return SymmetryMap(matrix.astype(np.float32), shift.astype(np.float32), score)


def _score_planes(
    samples: FloatArray, occupancy: FloatArray, evidence: Evidence, weights: SymmetryWeights
) -> NDArray[np.float64]:  # [_ANGLES, offsets]
    angles = np.pi * np.arange(_ANGLES) / _ANGLES
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1).astype(np.float32)
    offsets = np.array(_OFFSETS, np.float32)
    distance = _cells_to_surface(occupancy)
    along = samples[:, :2] @ normals.T  # [N, A]
    low, high = along.min(axis=0)[:, None], along.max(axis=0)[:, None]
    gap = np.maximum(np.maximum(low - offsets, offsets - high), 0.0)
    copies = np.repeat(samples[None, None], len(normals), 0).repeat(len(offsets), 1)
    shift = 2 * (offsets[None, :, None] - along.T[:, None, :])  # [A, O, N]
    copies[..., 0] += shift * normals[:, None, None, 0]
    copies[..., 1] += shift * normals[:, None, None, 1]
    shares = evidence.classify(copies).reshape(len(normals), len(offsets), -1, 3)
    cells = np.clip(((copies + HALF_SIDE) / CELL_SIDE).astype(np.int32), 0, len(distance) - 1)
    far = distance[cells[..., 0], cells[..., 1], cells[..., 2]]
    novel = (far >= 2).mean(axis=-1)
    near = (far == 2).mean(axis=-1)
    outside = (np.abs(copies) > 0.53).any(axis=-1).mean(axis=-1)
    is_new = (far >= 2)[..., None]
    violated = (shares * is_new).mean(axis=2)
    return (
        novel
        - weights.front * violated[..., 0]
        - weights.beside * violated[..., 2]
        - weights.near * near
        - weights.outside * outside
        - weights.gap * gap
        - weights.offset * np.abs(offsets)
    ).astype(np.float64)


@numba.njit(cache=True)
def _cells_to_surface(occupancy: FloatArray) -> NDArray[np.uint8]:
    """Return the distance to P in cells (largest coordinate difference), at most 3."""
    n = occupancy.shape[0]
    distance = np.full((n, n, n), 3, np.uint8)
    for i in range(n):
        for j in range(n):
            for k in range(n):
                if occupancy[i, j, k] <= 0.2:
                    continue
                for x in range(max(i - 2, 0), min(i + 3, n)):
                    for y in range(max(j - 2, 0), min(j + 3, n)):
                        for z in range(max(k - 2, 0), min(k + 3, n)):
                            away = max(abs(x - i), abs(y - j), abs(z - k))
                            distance[x, y, z] = min(distance[x, y, z], np.uint8(away))
    return distance
