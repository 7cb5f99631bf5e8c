"""Predict with a small network how far inside the predicted surface the true one lies.

Where the shape network is certain, its logits fall steeply, and the true surface is where they
fall. Where it is uncertain, they fall slowly, and thin walls are filled whole. The logits along the
normal, and where P and its mirror images lie along it, show how deep the true surface is. A small
network has learned this from parts of meshes whose true surface is known
(``recipes/train_embedded_prior``).

Conventions
-----------
* Depths are measured inward along the normal from where the logits cross their level.
"""

from __future__ import annotations

import functools

import torch
import torch.nn.functional as F
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.networks.packaged import PACKAGED_WEIGHTS
from gscomplete.networks.perceptron import Perceptron
from gscomplete.shape.network import ShapeOutput
from gscomplete.shape.partial_voxels import ShapeInputs
from gscomplete.shape.symmetry import SOURCES
from gscomplete.shape.voxels import CELL_SIDE, sample_volume
from gscomplete.splats.geometry.nearest import query_nearest
from gscomplete.util.arrays import Float32Array
from gscomplete.util.same_bits import fixed_softmax

SURFACE_DEPTH_FILE = "surface_depth.safetensors"
DEPTHS = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0)
"""Depths at which logits are read, cells. The depths below are in cells, too."""
_SMOOTH_DEPTHS = (-2.0, 0.0, 2.0, 4.0)
"""Depths at which smoothed logits are read."""
_FILLED_DEPTHS = (-1.0, 0.0, 1.0, 2.0, 3.0)
"""Depths at which the cells of P and of its mirror images are read."""
_EVIDENCE_DEPTHS = (-1.0, 1.0, 3.0)
"""Depths at which evidence is read."""
_EVIDENCE = ("in_front", "behind", "beside")
_SIDE = 1.5
"""How far to the sides of a point logits are read, cells."""
_SIDE_DEPTHS = (0.0, 1.5)
_SMOOTHED = 5
"""Smoothed logits are means over cubes of this side, cells."""
_MOST_LOGITS = 8.0
_NEIGHBOURS, _NORMALS_WEIGH = 8, 0.05
"""A point's depth is the mean over so many neighbours, which are near it and face the same way: in
the distance between two points, normals one radian apart count as this length, object sizes."""
FEATURES = (
    *(f"logit_{d}" for d in DEPTHS),
    *(f"smooth_{d}" for d in _SMOOTH_DEPTHS),
    *(f"{who}_{d}" for who in ("partial", "first_copy", "copies") for d in _FILLED_DEPTHS),
    *(f"{what}_{d}" for what in _EVIDENCE for d in _EVIDENCE_DEPTHS),
    *(f"source_{k}" for k in range(SOURCES + 1)),
    *(f"{which}_side_{d}" for d in _SIDE_DEPTHS for which in ("least", "mean", "most")),
    "slope",
    "upward",
    "height",
    "off_axis",
    "level",
    "score",
)


@functools.cache
def packaged_surface_depth() -> Perceptron:
    """Return the network that ships with the package."""
    return Perceptron.load(PACKAGED_WEIGHTS / SURFACE_DEPTH_FILE, len(FEATURES))


def surface_depths(
    output: ShapeOutput,
    inputs: ShapeInputs,
    level: float,
    points: Tensor,  # [N, 3] where logits cross the level
    normals: Tensor,  # [N, 3] outward
) -> Tensor:  # [N] object sizes
    """Return how deep the true surface lies; arguments as for ``depth_features``."""
    if not len(points):
        return points.new_zeros(0)
    depths = packaged_surface_depth()(depth_features(output, inputs, level, points, normals))
    places = torch.cat([points, _NORMALS_WEIGH * normals], dim=1).numpy()
    nearest = range(1, min(_NEIGHBOURS, len(points)) + 1)
    _, index = query_nearest(cKDTree(places), places, nearest)
    return torch.from_numpy(depths[index].mean(axis=1)) * CELL_SIDE


def depth_features(
    output: ShapeOutput,
    inputs: ShapeInputs,
    level: float,
    points: Tensor,  # [N, 3] where logits cross the level
    normals: Tensor,  # [N, 3] outward
) -> Float32Array:  # [N, F]
    """Return the small network's input for points of the predicted surface, as ``FEATURES``.

    Args:
        output: of the shape network, for a batch of one.
        inputs: input of the shape network.
        level: logit of the surface.
        points: points of the surface, object frame.
        normals: their outward normals.
    """

    def along(volume: Tensor, depths: tuple[float, ...]) -> Tensor:  # [K, n, n, n] -> [N, K * D]
        places = torch.cat([points - depth * CELL_SIDE * normals for depth in depths])
        found = sample_volume(volume, places).reshape(len(depths), len(points), -1)
        return found.permute(1, 2, 0).reshape(len(points), -1)

    logits = output.occupancy[:1].float().clamp(-_MOST_LOGITS, _MOST_LOGITS)
    smooth = F.avg_pool3d(logits, _SMOOTHED, 1, _SMOOTHED // 2, count_include_pad=False)
    filled = torch.from_numpy(inputs.volumes[:, 0])
    filled = torch.stack([filled[0], filled[1], filled[1:].amax(dim=0)])
    sources = fixed_softmax(output.sources[0].float(), dim=0)
    beside = torch.stack([_to_sides(logits, points, normals, depth) for depth in _SIDE_DEPTHS], 1)
    profile = along(logits, DEPTHS)
    inside = points - CELL_SIDE * normals
    zero = DEPTHS.index(0.0)
    columns = [
        profile,
        along(smooth, _SMOOTH_DEPTHS),
        along(filled, _FILLED_DEPTHS),
        along(torch.from_numpy(inputs.evidence), _EVIDENCE_DEPTHS),
        sample_volume(sources, inside),
        beside.flatten(1),
        profile[:, zero + 1 : zero + 2] - profile[:, zero - 1 : zero],
        normals[:, 2:],
        points[:, 2:],
        points[:, :2].norm(dim=1, keepdim=True),
        points.new_full((len(points), 1), level),
        points.new_full((len(points), 1), inputs.symmetries[0].score),
    ]
    found: Float32Array = torch.cat(columns, dim=1).numpy()
    return found


def _to_sides(logits: Tensor, points: Tensor, normals: Tensor, depth: float) -> Tensor:  # [N, 3]
    """Return the least, mean and largest of the logits on four sides of each point at a depth."""
    least = F.one_hot(normals.abs().argmin(dim=1), 3).to(normals.dtype)
    across = F.normalize(torch.linalg.cross(normals, least, dim=1), dim=1)
    other = torch.linalg.cross(normals, across, dim=1)
    at = points - depth * CELL_SIDE * normals
    step = _SIDE * CELL_SIDE
    places = torch.cat([at + step * d for d in (across, -across, other, -other)])
    found = sample_volume(logits, places).reshape(4, len(points))
    return torch.stack([found.amin(dim=0), found.mean(dim=0), found.amax(dim=0)], dim=1)
