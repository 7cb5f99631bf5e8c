"""P's own splats, mirrored to where P lacks them.

Where a mirror image is right, nothing shows the missing part as exactly as the splats it is made
of: thin boards, legs and patterns that the network's cells blur.

Conventions
-----------
* Ellipsoids are symmetric about their centres, so their mirror image is a turn of them: by the
  map's matrix, or by its negative where it mirrors. Colours are base colours: what shines stays
  where it is.
"""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from gscomplete.shape.evidence import Evidence
from gscomplete.shape.symmetry import SymmetryMap
from gscomplete.shape.voxels import sample_volume
from gscomplete.splats import Splats
from gscomplete.splats.transform import multiply_quaternions, quaternion_from_rotation

_LEAST_LOGIT = -2.0
"""Copies in cells that the network finds emptier than this are left out ..."""
_MOST_IN_FRONT = 0.5
"""... and those that more than this share of the views sees to be in front of P."""


def mirror_image(splats: Splats, symmetry: SymmetryMap) -> Splats:
    """Return the image of splats under a map; see the module's conventions for colours."""
    matrix = torch.from_numpy(symmetry.matrix).double()
    turn = matrix if float(torch.linalg.det(matrix)) > 0 else -matrix
    quaternion = quaternion_from_rotation(turn).to(splats.quaternions)
    plain = splats.with_sh_degree(0)
    return dataclasses.replace(
        plain,
        means=torch.from_numpy(symmetry.apply(splats.means.numpy())),
        quaternions=multiply_quaternions(quaternion, plain.quaternions),
    )


def select_consistent(
    copies: Splats,
    occupancy: Tensor,  # [1, C, C, C] logits of the network's answer
    evidence: Evidence,
) -> Splats:
    """Return the copies that neither the network nor the views contradict."""
    logit = sample_volume(occupancy, copies.means)[:, 0]
    in_front = torch.from_numpy(evidence.classify(copies.means.numpy())[:, 0])
    return copies.select((logit > _LEAST_LOGIT) & (in_front <= _MOST_IN_FRONT))
