"""Palettes: a few values that stand for many, by k-means.

Conventions
-----------
* Results are a function of the values: chosen rows and rounds are fixed.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gscomplete.util.arrays import Float32Array

CODES = 256
"""Values of a codebook: one byte."""
_ROUNDS = 24
_ROW_ROUNDS = 4
_BLOCK_ROWS = 4096


def codebook(
    values: Float32Array,  # [...]
) -> tuple[Float32Array, NDArray[np.uint8]]:  # [CODES], [...]
    """Return ascending values that stand for all, and which one stands for each.

    Args:
        values: numbers to quantise, any shape.

    Returns:
        One-dimensional k-means, and the nearest of them. Half of them start evenly spread over the
        values' range, so that rare values far from the others keep some of their own.
    """
    ordered = np.sort(values.reshape(-1).astype(np.float64))
    shares = (np.arange(CODES // 2) + 0.5) / (CODES // 2)
    even = ordered[0] + shares * (ordered[-1] - ordered[0])
    centers = np.sort(np.concatenate([np.quantile(ordered, shares), even]))
    sums = np.concatenate([[0.0], np.cumsum(ordered)])
    for _ in range(_ROUNDS):
        ends = np.searchsorted(ordered, (centers[1:] + centers[:-1]) / 2)
        ends = np.concatenate([[0], ends, [len(ordered)]])
        counts = np.diff(ends)
        means = np.diff(sums[ends]) / np.maximum(counts, 1)
        centers = np.where(counts > 0, means, centers)
    codes = centers.astype(np.float32)
    middles = (codes[1:] + codes[:-1]) / 2
    return codes, np.searchsorted(middles, values).astype(np.uint8)


def row_palette(rows: Tensor, most: int) -> tuple[Tensor, Tensor]:  # [N, D] -> [K, D], [N]
    """Return rows that stand for all, and which one stands for each.

    Args:
        rows: N rows.
        most: how many may stand for them; with no more than that each stands for itself.

    Returns:
        K-means of a few rounds from a fixed random choice.
    """
    if len(rows) <= most:
        return rows, torch.arange(len(rows))
    chosen = torch.randperm(len(rows), generator=torch.Generator().manual_seed(0))[:most]
    centers = rows[chosen.sort().values].clone()
    for _ in range(_ROW_ROUNDS):
        labels = _nearest(rows, centers)
        counts = torch.bincount(labels, minlength=most).to(rows)
        sums = torch.zeros_like(centers).index_add_(0, labels, rows)
        centers = torch.where(counts[:, None] > 0, sums / counts.clamp_min(1)[:, None], centers)
    return centers, _nearest(rows, centers)


def _nearest(rows: Tensor, centers: Tensor) -> Tensor:  # [N]
    """Return the index of the nearest centre of every row."""
    half = centers.square().sum(dim=1) / 2
    return torch.cat(
        [(half - block @ centers.T).argmin(dim=1) for block in rows.split(_BLOCK_ROWS)]
    )
