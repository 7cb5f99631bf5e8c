"""Coloured points to splats of one size (paper, section 4: Singleview and LiDAR subsets).

Conventions
-----------
* The paper's authors chose the size by hand from the cloud's density; here it is a multiple of the
  median distance from a point to its nearest neighbour, the cloud's spacing.
* Splats are round: a point has no orientation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gscomplete.errors import UserError
from gscomplete.splats import Splats, colors_to_sh


@dataclass(frozen=True, slots=True)
class PointSplatSettings:
    """How a point becomes a splat."""

    sigma_per_spacing: float = 0.6
    """Standard deviation over spacing; below about 0.5 surfaces show holes."""
    opacity: float = 0.95
    """Opacity of every splat, in [0, 1]."""
    max_points_for_spacing: int = 20_000
    """Spacing is measured at this many evenly chosen points of a larger cloud."""


def median_spacing(
    points: NDArray[np.floating],  # [N, 3]
    max_points: int | None = None,
) -> float:
    """Return the median distance from a point to its nearest distinct neighbour.

    Args:
        points: the cloud.
        max_points: number of points measured at; None = all.

    Raises:
        UserError: there are fewer than two distinct points.
    """
    unique = np.unique(np.asarray(points, np.float64), axis=0)
    if len(unique) < 2:
        raise UserError(f"points: expected at least 2 distinct points, found {len(unique)}")
    chosen = unique[:: max(1, len(unique) // (max_points or len(unique)))]
    distances, _ = cKDTree(unique).query(chosen, k=2)
    return float(np.median(distances[:, 1]))


def points_to_splats(
    points: NDArray[np.floating],  # [N, 3]
    colors: NDArray[np.floating],  # [N, 3] sRGB in [0, 1]
    settings: PointSplatSettings | None = None,
) -> Splats:
    """Turn coloured points into round splats of one size; None means the default settings.

    Raises:
        UserError: there are fewer than two distinct points.
    """
    chosen = settings or PointSplatSettings()
    sigma = chosen.sigma_per_spacing * median_spacing(points, chosen.max_points_for_spacing)
    count = len(points)
    quaternions = torch.zeros(count, 4)
    quaternions[:, 0] = 1.0
    return Splats(
        means=torch.from_numpy(np.array(points, dtype=np.float32)),
        quaternions=quaternions,
        scales=torch.full((count, 3), sigma),
        opacities=torch.full((count,), chosen.opacity),
        sh=colors_to_sh(torch.from_numpy(np.array(colors, dtype=np.float32))),
    )
