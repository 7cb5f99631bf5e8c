"""A known shape in the place of the network's answer, where the user lets the prompt decide.

A shape that is turned, scaled and moved still stands off P: a handle is thinner, a seat deeper. It
is bent to P: near P it is looked up where its own surface nearest to P is, once and smoothly (done
again until it meets P, as it could be, it tears).
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.shape.bank.fit import FitLimits, FittedShape
from gscomplete.shape.bank.pose import FloatArray
from gscomplete.shape.voxels import CELL_SIDE, CELLS, cell_centers

DECIDING = FitLimits(
    most_cost=0.25, most_growth=200.0, in_front_cost=0.15, synonym_cost=0.02, other_noun_cost=0.04
)
"""Of shapes that users ask for by name: P may be a small piece of them, and suit them badly."""
LIKE_PARTIAL = 0.08
"""What of a shape is this near to P, object sizes, stands for what P has."""
_STEEPNESS = 8.0
"""Logits per cell, so that no level that surfaces are taken at moves them."""
_MOST_BENT = 0.15
"""Points of P farther than this from the shape do not bend it, object sizes."""
_WIDTH = 0.08
"""Over which what a point of P bends falls off."""
_FALL_OFF = 0.5
"""Points of P, at no distance, whose effect "not bent" weighs as much as."""
_POINTS, _NEIGHBOURS = 3000, 24


def occupancy_of(
    shape: FittedShape,
    part: FloatArray,  # [N, 3] points of P, at least one
) -> Tensor:  # [1, C, C, C] logits
    """Return what of the grid a shape fills, with a cell round it, as the network fills cells.

    Args:
        shape: in the frame of the grid, as P is.
        part: bends the shape.
    """
    centers = cell_centers(CELLS).reshape(-1, 3).astype(np.float64)
    cells = shape.distances(centers + _bending(shape, part, centers)) / CELL_SIDE
    logits = _STEEPNESS * (1.0 - torch.from_numpy(cells).float())
    return logits.reshape(1, CELLS, CELLS, CELLS)


def _bending(
    shape: FittedShape,
    part: FloatArray,  # [N, 3]
    places: FloatArray,  # [M, 3]
) -> FloatArray:  # [M, 3]
    """Return how far from places the shape's places lie that go there."""
    some = part[np.linspace(0, len(part) - 1, min(len(part), _POINTS)).astype(np.int64)]
    distance, nearest = cKDTree(shape.points).query(some)
    near = distance < _MOST_BENT
    if not near.any():
        return np.zeros_like(places)
    points, offsets = some[near], (shape.points[nearest] - some)[near]
    away, index = cKDTree(points).query(places, k=range(1, min(_NEIGHBOURS, len(points)) + 1))
    weights = np.exp(-0.5 * (away / _WIDTH) ** 2)
    total = weights.sum(axis=1, keepdims=True) + _FALL_OFF
    bending: FloatArray = np.einsum("mk,mkc->mc", weights, offsets[index]) / total
    return bending
