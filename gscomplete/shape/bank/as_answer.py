"""A known shape in the place of the network's answer, where the user lets the prompt decide.

A shape that was only turned, scaled and moved to fit P still does not meet it: a handle is thinner,
a seat deeper. So the shape is bent: about each point of P it is displaced by the offset between P
and its own nearest surface. This is done once, with a smooth fall-off; repeated until the shape
meets P everywhere, it would tear.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.shape.bank.fit import FitLimits, FittedShape
from gscomplete.shape.voxels import CELL_SIDE, CELLS, cell_centers
from gscomplete.util.arrays import Float64Array

DECIDING = FitLimits(
    most_cost=0.25, most_growth=200.0, in_front_cost=0.15, synonym_cost=0.02, other_noun_cost=0.04
)
"""Limits for shapes that users ask for by name. They are wide, because P may be a small piece of
the shape and fit it badly."""
LIKE_PARTIAL = 0.08
"""Parts of the shape this near to P count as P's own and are left out, object sizes."""
_STEEPNESS = 8.0
"""Logits per cell across the surface: steep enough that every level in use finds the same
surface."""
_MOST_BENT = 0.15
"""Points of P farther than this from the shape do not bend it, object sizes."""
_WIDTH = 0.08
"""Standard deviation of the Gaussian over which a point's effect falls off, object sizes."""
_FALL_OFF = 0.5
"""Weight of "no displacement" in the mean of displacements; a point of P at distance 0 has 1."""
_POINTS, _NEIGHBOURS = 3000, 24
"""Most points of P that bend the shape, and how many of them count at each place."""


def occupancy_of(
    shape: FittedShape,
    part: Float64Array,  # [N, 3] points of P, at least one
) -> Tensor:  # [1, C, C, C] logits
    """Bend a shape to P and return its occupancy, one cell thick beyond it as the network's is.

    Args:
        shape: fitted to P, in the frame of the grid.
        part: points of P that bend the shape, same frame.
    """
    centers = cell_centers(CELLS).reshape(-1, 3).astype(np.float64)
    cells = shape.distances(centers + _bending(shape, part, centers)) / CELL_SIDE
    logits = _STEEPNESS * (1.0 - torch.from_numpy(cells).float())
    return logits.reshape(1, CELLS, CELLS, CELLS)


def _bending(
    shape: FittedShape,
    part: Float64Array,  # [N, 3]
    places: Float64Array,  # [M, 3]
) -> Float64Array:  # [M, 3]
    """Return, for every place, the offset to where the unbent shape is to be looked up."""
    some = part[np.linspace(0, len(part) - 1, min(len(part), _POINTS)).astype(np.int64)]
    distance, nearest = cKDTree(shape.points).query(some)
    near = distance < _MOST_BENT
    if not near.any():
        return np.zeros_like(places)
    points, offsets = some[near], (shape.points[nearest] - some)[near]
    away, index = cKDTree(points).query(places, k=range(1, min(_NEIGHBOURS, len(points)) + 1))
    weights = np.exp(-0.5 * (away / _WIDTH) ** 2)
    total = weights.sum(axis=1, keepdims=True) + _FALL_OFF
    bending: Float64Array = np.einsum("mk,mkc->mc", weights, offsets[index]) / total
    return bending
