"""Nearest points by look-up: a cube of cells, each of which knows the point nearest to it.

Conventions
-----------
* A cloud lies in ``[-1/2, 1/2]``^3; the cube reaches ``REACH`` to either side along every axis.
* Every cell refers to the mean of the points in the nearest cell that holds any. So a look-up is
  accurate to about a cell. Places outside the cube are first moved onto its boundary.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from gscomplete.util.arrays import Float64Array

CELLS = 48
"""Cells along an axis."""
REACH = 0.75
"""Half the side of the cube."""


@dataclass(frozen=True, slots=True, eq=False)
class NearestGrid:
    """Nearest point for every cell."""

    index: NDArray[np.int32]  # [CELLS, CELLS, CELLS] row of ``points``
    points: Float64Array  # [n, 3] means of the points of a cell


def nearest_grid(points: Float64Array) -> NearestGrid:  # [n, 3]
    """Build the look-up for a cloud."""
    cell = np.floor((points + REACH) / (2 * REACH) * CELLS).astype(np.int64).clip(0, CELLS - 1)
    flat = (cell[:, 0] * CELLS + cell[:, 1]) * CELLS + cell[:, 2]
    held, row, count = np.unique(flat, return_inverse=True, return_counts=True)
    means = np.zeros((len(held), 3))
    np.add.at(means, row, points)
    means /= count[:, None]
    rows = np.full(CELLS**3, -1, np.int32)
    rows[held] = np.arange(len(held), dtype=np.int32)
    empty = (rows < 0).reshape(CELLS, CELLS, CELLS)
    nearest = distance_transform_edt(empty, return_distances=False, return_indices=True)
    x, y, z = nearest
    return NearestGrid(rows[(x * CELLS + y) * CELLS + z], means)
