"""A surface as splats without colours: one round splat in each cell that it passes.

It is what the four-view denoiser is shown of a known shape.
"""

from __future__ import annotations

import numpy as np
import torch

from gscomplete.shape.bank.store import BANK_CELLS
from gscomplete.splats import Splats
from gscomplete.util.arrays import Float64Array

_WIDTH = 0.5
"""Standard deviation of a splat, cells."""
_OPACITY = 0.95


def cell_splats(centers: Float64Array, scale: float = 1.0) -> Splats:  # [N, 3]
    """Return grey splats at the centres of the bank's cells, whose cube has the side ``scale``."""
    count = len(centers)
    quaternions = torch.zeros(count, 4)
    quaternions[:, 0] = 1.0
    return Splats(
        torch.from_numpy(centers).float(),
        quaternions,
        torch.full((count, 3), _WIDTH * scale / BANK_CELLS),
        torch.full((count,), _OPACITY),
        torch.zeros(count, 1, 3),
    )


def cells_passed(points: Float64Array) -> Float64Array:  # [N, 3] -> [M, 3]
    """Return the centres of the bank's cells that hold points of the unit cube about the origin."""
    cell = np.floor((points + 0.5) * BANK_CELLS).clip(0, BANK_CELLS - 1).astype(np.int64)
    centers: Float64Array = (np.unique(cell, axis=0) + 0.5) / BANK_CELLS - 0.5
    return centers
