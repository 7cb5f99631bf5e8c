"""A tiny shape network, and what it is given."""

from __future__ import annotations

import numpy as np
import torch

from gscomplete.shape.network import ShapeCompleter, ShapeModelConfig, ShapeOutput
from gscomplete.shape.partial_voxels import ShapeInputs, voxelize_partial
from gscomplete.shape.planes.proposals import candidate_planes
from gscomplete.shape.predict import Prediction
from gscomplete.shape.symmetry import SOURCES, SymmetryMap
from gscomplete.shape.symmetry_choice import CANDIDATES
from gscomplete.shape.voxels import CELLS, COARSE_CELLS, cell_centers
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half

TINY = ShapeModelConfig(vocabulary_size=8, widths=(8, 8, 16), blocks=(1, 1, 1), embedding=8)


def tiny_network() -> ShapeCompleter:
    """Return a network whose answers depend on all that it is given."""
    torch.manual_seed(0)
    model = ShapeCompleter(TINY, COARSE_CELLS)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.05 * torch.randn(parameter.shape))
    return model.eval()


def likeliest_inputs(partial: Splats, distribution: ViewDistribution) -> ShapeInputs:
    """Return what the network is given with the copies that are believed in most."""
    voxels = voxelize_partial(partial, distribution)
    return voxels.with_copies(voxels.input_symmetries(candidate_planes(voxels, CANDIDATES), 0))


def mirrors() -> tuple[SymmetryMap, SymmetryMap, SymmetryMap]:
    """Return the mirror images through x = 0 and y = 0, and half a turn."""
    nothing = np.zeros(3, np.float32)
    return (
        SymmetryMap(np.diag([-1.0, 1.0, 1.0]).astype(np.float32), nothing, 0.6),
        SymmetryMap(np.diag([1.0, -1.0, 1.0]).astype(np.float32), nothing, 0.2),
        SymmetryMap(np.diag([-1.0, -1.0, 1.0]).astype(np.float32), nothing, 0.4),
    )


def predicted(symmetry_score: float, *, confidence: float = 200.0) -> Prediction:
    """Half a ball and its mirror image, of which the network thinks a ball (blurred inwards)."""
    partial = half(ball())
    voxels = voxelize_partial(partial, ViewDistribution(0.0, 10.0))
    distance = torch.from_numpy(np.linalg.norm(cell_centers(CELLS), axis=-1))
    nothing = torch.zeros(1, SOURCES + 1, *(COARSE_CELLS,) * 3)
    output = ShapeOutput((confidence * (0.42 - distance))[None], nothing[:, :3], nothing)
    inputs = voxels.with_copies(mirrors())
    return Prediction(voxels, inputs, output, output.occupancy, symmetry_score, True, None)
