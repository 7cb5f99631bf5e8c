"""Scores of mirror images of P by the truth.

Conventions
-----------
* The score of a copy is the share of the missing surface that it covers, less half the share of the
  copy that is new but not on the complete object's surface. 1 is perfect, 0 is as good as no copy.
* Distances are in the cells of ``grid``; a surface is met within 1, missed beyond 1.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gscomplete.shape.planes.answer_scorer import WRONG_WEIGHT
from gscomplete.shape.planes.features import OFFSETS, plane_normals
from gscomplete.shape.symmetry import SymmetryMap
from gscomplete.shape.voxels import (
    CELL_SIDE,
    CELLS,
    HALF_SIDE,
    fill_colored,
    splat_arrays,
)
from gscomplete.splats import Splats
from gscomplete.util.arrays import BoolArray, Float32Array

_SAMPLES = 400


@dataclass(frozen=True, slots=True)
class Truth:
    """A part and the complete object, by which copies are scored."""

    to_part: Float32Array  # [C, C, C] cells
    to_complete: Float32Array  # [C, C, C] cells
    missing: Float32Array  # [M, 3] points of the complete object's surface that P lacks
    points: Float32Array  # [N, 3] of P

    @classmethod
    def of(cls, partial: Splats, complete: Splats) -> Truth:
        """Look at both, in one object frame."""
        part = splat_arrays(partial)
        to_part, to_complete = _cells_to(*part), _cells_to(*splat_arrays(complete))
        cells = np.argwhere((to_complete == 0) & (to_part > 1.5))
        rng = np.random.default_rng(0)
        cells = cells[rng.permutation(len(cells))[:_SAMPLES]]
        missing = ((cells + 0.5) * CELL_SIDE - HALF_SIDE).astype(np.float32)
        points = part[0][rng.permutation(len(part[0]))[:_SAMPLES]]
        return cls(to_part, to_complete, missing, points)

    def map_score(self, symmetry: SymmetryMap) -> float:
        """Return the score of the copy by one map."""
        back, copies = symmetry.undo(self.missing), symmetry.apply(self.points)
        return float(self._true_scores(back[None], copies[None])[0])

    def plane_scores(self) -> Float32Array:  # [A, O]
        """Return the scores of the copies through all planes of ``planes``."""
        rows = [
            self._true_scores(_mirrored(self.missing, normal), _mirrored(self.points, normal))
            for normal in plane_normals()
        ]
        return np.stack(rows)

    def _true_scores(
        self,
        back: Float32Array,  # [K, M, 3] missing points, mapped back to where P should have them
        copies: Float32Array,  # [K, N, 3]
    ) -> Float32Array:  # [K]
        if not len(self.missing):
            return np.zeros(len(back), np.float32)
        covered = _at(self.to_part, back) <= 1.0
        wrong = (_at(self.to_complete, copies) > 1.5) & (_at(self.to_part, copies) > 1.5)
        score = covered.mean(axis=1) - WRONG_WEIGHT * wrong.mean(axis=1)
        return score.astype(np.float32)


def _mirrored(points: Float32Array, normal: Float32Array) -> Float32Array:  # [N, 3] -> [O, N, 3]
    """Mirror points through all the planes of one normal."""
    shift = 2 * (np.array(OFFSETS, np.float32)[:, None] - points[:, :2] @ normal)
    copies = np.repeat(points[None], len(OFFSETS), axis=0)
    copies[..., :2] += shift[..., None] * normal
    return copies


def _cells_to(
    positions: Float32Array, tangents: Float32Array, opacities: Float32Array, colors: Float32Array
) -> Float32Array:  # [C, C, C]
    """Return distances to a surface in cells."""
    filled = fill_colored(positions, tangents, opacities, colors, CELLS)[0] > 0
    return cells_away(filled)


def cells_away(filled: BoolArray) -> Float32Array:  # [C, C, C] -> [C, C, C]
    """Return every cell's distance to the nearest filled one in cells; ``CELLS`` if none is."""
    if not filled.any():
        return np.full(filled.shape, CELLS, np.float32)
    return ndimage.distance_transform_edt(~filled).astype(np.float32)


def _at(volume: Float32Array, points: Float32Array) -> Float32Array:
    """Look points up; outside the grid everything is far."""
    cells = np.floor((points + HALF_SIDE) / CELL_SIDE).astype(np.intp)
    inside: BoolArray = ((cells >= 0) & (cells < CELLS)).all(axis=-1)
    i, j, k = np.moveaxis(cells.clip(0, CELLS - 1), -1, 0)
    return np.where(inside, volume[i, j, k], np.float32(CELLS))
