"""A frame that has room for the known shapes, for when the guessed object frame has not.

P's box tells little of what stands below or behind P: a frame about a chair's seat and back leaves
no room for legs. Known shapes that suit P tell more.

Conventions
-----------
* ``wider_from_object`` takes the object frame to one of the same axes in which the box of P and of
  the best known shape is centred and its largest side is 1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from gscomplete.shape.bank.fit import FittedShape
from gscomplete.shape.voxels import HALF_SIDE
from gscomplete.splats.transform import Similarity
from gscomplete.util.arrays import Float64Array

_LEAST_OUTSIDE = 0.05
"""The frame has no room for the best known shape if at least this share of it is off the grid."""


def wider_from_object(
    points: Float64Array,  # [N, 3] of P
    known: Sequence[FittedShape],
) -> Similarity | None:
    """Return the wider frame; None where the object frame has room for the best known shape."""
    if not known:
        return None
    outside = (np.abs(known[0].points) > HALF_SIDE).any(axis=1)
    if float(outside.mean()) < _LEAST_OUTSIDE:
        return None
    both = np.concatenate([points, known[0].points])
    low, high = both.min(axis=0), both.max(axis=0)
    scale = 1.0 / float((high - low).max())
    center = torch.from_numpy((low + high) / 2)
    return Similarity(scale, torch.eye(3, dtype=torch.float64), -scale * center)


def shape_in(shape: FittedShape, frame: Similarity) -> FittedShape:
    """Return a known shape in another frame."""
    return shape.moved(frame.scale, frame.translation.numpy())
