"""The shape network's inputs: voxels of P and of its mirror images, and the views' evidence.

Conventions
-----------
* Volumes are those of ``voxels``: occupancy and colour at ``CELLS``, evidence (in front, behind,
  beside) at ``COARSE_CELLS``.
* The first colour volume is P, then follow ``COPIES`` mirror images of P.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gscomplete.shape.evidence import Evidence, gather_evidence
from gscomplete.shape.outline.one_view import best_view_share
from gscomplete.shape.planes.features import PartSamples, part_samples
from gscomplete.shape.symmetry import (
    SymmetryMap,
    second_symmetry,
    with_composition,
)
from gscomplete.shape.voxels import (
    CELLS,
    COARSE_CELLS,
    cell_centers,
    fill_colored,
    splat_arrays,
)
from gscomplete.splats import Splats
from gscomplete.util.arrays import Float32Array, Float64Array
from gscomplete.views import ViewDistribution

_SHAPE_REACH = 0.008
"""Standard deviation, in object sizes, of the discs that stand for points of a known shape."""
_SHAPE_SCORE = 0.5
"""Score of a known shape as an input, on the scale of the planes' scores."""


@dataclass(frozen=True, slots=True)
class ShapeInputs:
    """Everything the network sees but the prompt."""

    volumes: Float32Array  # [SOURCES, 4, C, C, C] occupancy and colour
    evidence: Float32Array  # [3, C/2, C/2, C/2]
    scores: Float32Array  # [COPIES]
    symmetries: tuple[SymmetryMap, ...]  # COPIES


@dataclass(frozen=True)
class PartialVoxels:
    """P as the network sees it, whatever mirror images are given beside it."""

    positions: Float32Array  # [N, 3]
    tangents: Float32Array  # [N, 2, 3]
    opacities: Float32Array  # [N]
    colors: Float32Array  # [N, 3]
    volume: Float32Array  # [4, C, C, C]
    evidence: Evidence
    shares: Float32Array  # [3, C/2, C/2, C/2]

    @functools.cached_property
    def shown_at_once(self) -> float:
        """How much of P its best view shows."""
        return best_view_share(self.positions)

    def samples(self) -> PartSamples:
        """Return the samples of P that planes are scored on."""
        return part_samples(self.positions, self.tangents, self.colors, self.volume)

    def input_symmetries(
        self, planes: Sequence[SymmetryMap], first: int
    ) -> tuple[SymmetryMap, ...]:  # COPIES
        """Return the network's mirror images: one plane, a second one, and their composition."""
        return with_composition(planes[first], second_symmetry(planes, first, self.positions))

    def with_copies(self, symmetries: tuple[SymmetryMap, ...]) -> ShapeInputs:
        """Return the network's inputs with these mirror images."""
        volumes = [self.volume]
        for symmetry in symmetries:
            turned = np.ascontiguousarray(self.tangents @ symmetry.matrix.T)
            copies = symmetry.apply(self.positions)
            volumes.append(fill_colored(copies, turned, self.opacities, self.colors, CELLS))
        scores = np.array([s.score for s in symmetries], np.float32)
        return ShapeInputs(np.stack(volumes), self.shares, scores, symmetries)

    def with_shape(
        self,
        inputs: ShapeInputs,
        points: Float64Array,  # [M, 3]
    ) -> ShapeInputs:
        """Return inputs with a surface as the first mirror image, in P's nearest colours.

        Args:
            inputs: inputs from :meth:`with_copies`; their last mirror image is dropped.
            points: of the surface, object frame.
        """
        places = np.ascontiguousarray(points, np.float32)
        _, nearest = cKDTree(self.positions).query(places)
        tangents = np.zeros((len(places), 2, 3), np.float32)
        tangents[:, 0, 0] = tangents[:, 1, 2] = _SHAPE_REACH
        surface = fill_colored(
            places, tangents, np.ones(len(places), np.float32), self.colors[nearest], CELLS
        )
        volumes = np.stack([inputs.volumes[0], surface, *inputs.volumes[1:-1]])
        scores = np.array([_SHAPE_SCORE, *inputs.scores[:-1]], np.float32)
        same = SymmetryMap(np.eye(3, dtype=np.float32), np.zeros(3, np.float32), _SHAPE_SCORE)
        return ShapeInputs(volumes, inputs.evidence, scores, (same, *inputs.symmetries[:-1]))


def voxelize_partial(partial: Splats, distribution: ViewDistribution) -> PartialVoxels:
    """Voxelise P and gather what the views V tell about the space around it.

    Args:
        partial: P in the object frame.
        distribution: V.
    """
    positions, tangents, opacities, colors = splat_arrays(partial)
    volume = fill_colored(positions, tangents, opacities, colors, CELLS)
    evidence = gather_evidence(partial, distribution)
    shares = evidence.classify(cell_centers(COARSE_CELLS))
    split = np.ascontiguousarray(shares.T.reshape(3, *(COARSE_CELLS,) * 3))
    return PartialVoxels(positions, tangents, opacities, colors, volume, evidence, split)
