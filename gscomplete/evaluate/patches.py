"""How similar the local patches of two pictures are, wherever in the pictures they lie.

Conventions
-----------
* The sliced Wasserstein distance (Rabin et al. 2011; of patches: Karras et al. 2018) between the
  patches round the pixels of a region: their values, projected on fixed directions, are sorted and
  compared. A correct but displaced pattern costs little, a smeared or discoloured one costs much;
  with PSNR and SSIM it is the other way round.
* The unit is that of colours: a picture that is brighter by d everywhere has the distance d.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

SIDE_PX = 7
_DIRECTIONS = 64
_MOST = 20_000
"""Most patches; if the region has more pixels, every n-th is used."""
_LEVELS = 512
"""Quantiles that distributions are compared at."""


def patch_distance(
    ours: Tensor,  # [V, H, W, 3] in [0, 1]
    theirs: Tensor,  # [V, H, W, 3] in [0, 1]
    region: Tensor,  # [V, H, W] bool
) -> float | None:
    """Return the distance; None where the region is empty.

    Args:
        ours: pictures.
        theirs: pictures to compare with.
        region: pixels round which patches are taken, of both.
    """
    places = torch.nonzero(region)
    if len(places) == 0:
        return None
    places = places[:: -(-len(places) // _MOST)]
    size = SIDE_PX * SIDE_PX * 3
    directions = np.random.default_rng(0).normal(size=(size, _DIRECTIONS))
    directions /= np.linalg.norm(directions, axis=0)
    levels = (np.arange(_LEVELS) + 0.5) / _LEVELS
    quantiles = [
        np.quantile(_patches(pictures, places) @ directions, levels, axis=0)
        for pictures in (ours, theirs)
    ]
    apart = np.abs(quantiles[0] - quantiles[1]).mean(axis=0)
    return float(apart.sum() / np.abs(directions.sum(axis=0)).sum())


def _patches(pictures: Tensor, places: Tensor) -> np.ndarray:  # [V, H, W, 3], [n, 3] -> [n, 147]
    half = SIDE_PX // 2
    padded = F.pad(pictures.double().permute(0, 3, 1, 2), (half,) * 4, mode="replicate")
    windows = padded.unfold(2, SIDE_PX, 1).unfold(3, SIDE_PX, 1)  # [V, 3, H, W, s, s]
    view, row, column = places.T
    return windows[view, :, row, column].reshape(len(places), -1).cpu().numpy()
