"""What the shape network is shown of P: its voxels, its mirror images' voxels, the views' evidence.

Conventions
-----------
* Volumes are those of ``grid``: occupancy and colour at ``CELLS``, evidence (in front, behind,
  beside) at ``COARSE_CELLS``.
* The first colour volume is P, then follow ``COPIES`` mirror images of P.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscomplete.priors.embedded.shape.evidence import gather_evidence
from gscomplete.priors.embedded.shape.grid import (
    CELLS,
    COARSE_CELLS,
    FloatArray,
    cell_centers,
    fill_colored,
    splat_arrays,
)
from gscomplete.priors.embedded.shape.plane_ranker import packaged_ranker
from gscomplete.priors.embedded.shape.planes import part_samples
from gscomplete.priors.embedded.shape.symmetries import COPIES, SymmetryMap, likely_symmetries
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution

SOURCES = 1 + COPIES


@dataclass(frozen=True, slots=True)
class ShapeInputs:
    """Everything the network sees but the prompt."""

    volumes: FloatArray  # [SOURCES, 4, C, C, C] occupancy and colour
    evidence: FloatArray  # [3, C/2, C/2, C/2]
    scores: FloatArray  # [COPIES]
    symmetries: tuple[SymmetryMap, ...]  # COPIES


def shape_inputs(
    partial: Splats,
    distribution: ViewDistribution,
    symmetries: tuple[SymmetryMap, ...] | None = None,
) -> ShapeInputs:
    """Look at P.

    Args:
        partial: P in the object frame.
        distribution: V.
        symmetries: how P is mirrored; None = as P's own looks suggest.
    """
    positions, tangents, opacities, colors = splat_arrays(partial)
    alone = fill_colored(positions, tangents, opacities, colors, CELLS)
    evidence = gather_evidence(partial, distribution)
    if symmetries is None:
        part = part_samples(positions, tangents, colors, alone)
        symmetries = likely_symmetries(part, evidence, packaged_ranker())
    volumes = [alone]
    for symmetry in symmetries:
        turned = np.ascontiguousarray(tangents @ symmetry.matrix.T)
        volumes.append(fill_colored(symmetry.apply(positions), turned, opacities, colors, CELLS))
    shares = evidence.classify(cell_centers(COARSE_CELLS))
    shape = (COARSE_CELLS,) * 3
    return ShapeInputs(
        np.stack(volumes),
        np.ascontiguousarray(shares.T.reshape(3, *shape)),
        np.array([s.score for s in symmetries], np.float32),
        symmetries,
    )
