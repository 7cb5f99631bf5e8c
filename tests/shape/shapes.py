"""Simple objects as splats, and a tiny network, for tests of the shape network's parts."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from gscomplete.shape.network import ShapeCompleter, ShapeModelConfig
from gscomplete.shape.partial_voxels import ShapeInputs, voxelize_partial
from gscomplete.shape.symmetry import SymmetryMap
from gscomplete.shape.symmetry_choice import CANDIDATES
from gscomplete.shape.symmetry_proposals import candidate_planes
from gscomplete.shape.voxels import COARSE_CELLS
from gscomplete.splats import Splats, colors_to_sh
from gscomplete.splats.rotations import quaternions_facing
from gscomplete.views import ViewDistribution

TINY = ShapeModelConfig(vocabulary_size=8, widths=(8, 8, 16), blocks=(1, 1, 1), embedding=8)


def tiny_network() -> ShapeCompleter:
    """Return a network whose answers depend on all that it is given."""
    torch.manual_seed(0)
    model = ShapeCompleter(TINY, COARSE_CELLS)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.05 * torch.randn(parameter.shape))
    return model.eval()


def sphere(
    count: int = 6000, radius: float = 0.4, center: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Splats:
    """Return discs on a sphere whose colour is its outward normal."""
    points = np.random.default_rng(1).normal(size=(count, 3))
    normals = torch.from_numpy(points / np.linalg.norm(points, axis=1, keepdims=True)).float()
    spacing = radius * (4 * np.pi / count) ** 0.5
    scales = torch.full((count, 3), 0.7 * spacing)
    scales[:, 2] *= 0.1
    return Splats(
        radius * normals + torch.tensor(center),
        quaternions_facing(normals),
        scales,
        torch.full((count,), 0.95),
        colors_to_sh(0.5 + 0.4 * normals),
    )


def half(splats: Splats, axis: int = 0) -> Splats:
    """Return what lies beyond the middle along an axis."""
    return splats.select(splats.means[:, axis] > 0)


def moved(splats: Splats, shift: tuple[float, float, float]) -> Splats:
    """Return the splats elsewhere."""
    return dataclasses.replace(splats, means=splats.means + torch.tensor(shift))


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
