"""One object at several places and scales in the voxel grid, and the mean answer about it.

What the shape network fills depends on how large an object is in the grid and on where its cells
lie, which tells nothing about the object. Answers about the same object, placed in other ways, err
differently, and their mean has its surface more exactly where the object's is.

Conventions
-----------
* A placement takes the object frame to one of the same axes, in which the grid is the same cube.
* Mirror images are those that were chosen in the object frame: chosen anew for each placement they
  differ, and a mean of answers that were given different images blurs.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from gscomplete.shape.ask import mean_answer
from gscomplete.shape.mirror_plane import Mirror, MirrorPlane
from gscomplete.shape.network import ShapeCompleter, ShapeOutput
from gscomplete.shape.partial_voxels import ShapeInputs, voxelize_partial
from gscomplete.shape.symmetry import SymmetryMap
from gscomplete.shape.voxels import CELL_SIDE, CELLS, HALF_SIDE, cell_centers, sample_volume
from gscomplete.splats import Splats
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.views import ViewDistribution

_SCALES = (0.88, 1.14)
"""How large an object is in the grid, relative to its size there in the object frame."""
_SHIFT = CELL_SIDE / 2
"""How far an object is moved along each axis: it then lies differently in the cells."""


def placements() -> tuple[Similarity, ...]:
    """Return the placements that answers are averaged over beside the object frame itself."""
    turn, shift = torch.eye(3, dtype=torch.float64), torch.full((3,), _SHIFT, dtype=torch.float64)
    return tuple(Similarity(scale, turn, shift) for scale in _SCALES)


def mean_over_placements(
    model: ShapeCompleter,
    answer: ShapeOutput,
    inputs: ShapeInputs,
    partial: Splats,
    distribution: ViewDistribution,
    prompts: Sequence[Tensor],  # [L] each
    *,
    bfloat16: bool = False,
) -> ShapeOutput:
    """Average an answer's logits with those about the same object in other placements.

    Args:
        model: in evaluation mode, on the CPU.
        answer: to ``inputs``, for a batch of one.
        inputs: the network's inputs in the object frame.
        partial: P in the object frame.
        distribution: V.
        prompts: as for ``ask.mean_answer``.
        bfloat16: whether the network runs in bfloat16.

    Returns:
        The answer with other logits. Cells that a placement takes off the grid keep the logits of
        ``answer`` in its place.
    """
    total = answer.occupancy.clone()
    for frame in placements():
        given = transform_splats(partial.with_sh_degree(0), frame)
        voxels = voxelize_partial(given, views_in(distribution, frame))
        copies = tuple(symmetry_in(symmetry, frame) for symmetry in inputs.symmetries)
        found = mean_answer(model, voxels.with_copies(copies), prompts, bfloat16=bfloat16)
        total += brought_back(found.occupancy, frame, answer.occupancy)
    return dataclasses.replace(answer, occupancy=total / (1 + len(_SCALES)))


def brought_back(
    logits: Tensor,  # [1, C, C, C] in the placement
    frame: Similarity,
    elsewhere: Tensor,  # [1, C, C, C] in the object frame
) -> Tensor:  # [1, C, C, C] in the object frame
    """Bring logits from a placement's grid to the object frame's.

    Args:
        logits: in the placement's grid.
        frame: takes the object frame to the placement.
        elsewhere: logits of the cells that the placement takes off its grid.
    """
    centers = torch.from_numpy(cell_centers(CELLS).reshape(-1, 3)).double()
    places = frame.apply(centers)
    off_grid = (places.abs() > HALF_SIDE - CELL_SIDE / 2).any(dim=1).reshape(elsewhere.shape)
    found = sample_volume(logits, places.float())[:, 0].reshape(elsewhere.shape)
    return torch.where(off_grid, elsewhere, found)


def views_in(views: ViewDistribution, frame: Similarity) -> ViewDistribution:
    """Return the same cameras in a frame of the same axes."""
    target = frame.apply(torch.tensor(views.target, dtype=torch.float64))
    x, y, z = target.tolist()
    return dataclasses.replace(views, target=(x, y, z), radius=views.radius * frame.scale)


def plane_in(mirror: Mirror, frame: Similarity) -> Mirror:
    """Return a plane to mirror P through in a frame of the same axes.

    Where it is too far from that frame's centre to be asked for, the plane is to be guessed.
    """
    if not isinstance(mirror, MirrorPlane):
        return mirror
    angle = math.radians(mirror.azimuth_deg)
    x, y, _ = frame.translation.tolist()
    offset = frame.scale * mirror.offset + x * math.cos(angle) + y * math.sin(angle)
    return dataclasses.replace(mirror, offset=offset) if abs(offset) <= 1 else "guess"


def symmetry_in(symmetry: SymmetryMap, frame: Similarity) -> SymmetryMap:
    """Return a map of P in a frame of the same axes."""
    move = frame.translation.numpy()
    shift = frame.scale * symmetry.shift + move - symmetry.matrix @ move
    return dataclasses.replace(symmetry, shift=shift.astype(np.float32))
