"""Coloured points to splats of one size (paper, section 4: Singleview and LiDAR subsets).

Conventions
-----------
* The paper's authors chose the size by hand from the cloud's density; here it is a multiple of the
  median distance from a point to its nearest neighbour, the cloud's spacing.
* Splats are round: a point has no orientation.
* Points are float64, splats float32, which has no digits left for an object far from the origin
  (georeferenced scans). Coordinates that it cannot tell apart have an ``Offset`` taken away first;
  whoever takes it records it as the similarity ``without_offset``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gscomplete.errors import UserError
from gscomplete.splats import Similarity, Splats, colors_to_sh
from gscomplete.util.arrays import BoolArray, Float64Array, IntArray
from gscomplete.util.device import plain_torch

Offset = tuple[float, float, float]
"""What is taken from coordinates before they become float32, in whole units of the file."""
_MAX_POINTS_FOR_SPACING = 20_000
"""Spacing is measured at this many evenly chosen points of a larger cloud."""


@dataclass(frozen=True, slots=True)
class PointSplatSettings:
    """How a point becomes a splat."""

    sigma_per_spacing: float = 0.6
    """Standard deviation over spacing; below about 0.5 surfaces show holes."""
    opacity: float = 0.95
    """Opacity of every splat, in [0, 1]."""


def median_spacing(
    points: NDArray[np.floating],  # [N, 3]
    max_points: int | None = None,
) -> float:
    """Return the median distance from a point to its nearest distinct neighbour.

    Args:
        points: the cloud.
        max_points: at least so many points are measured at, and less than twice as many; None =
            all.

    Raises:
        UserError: there are fewer than two distinct points.
    """
    unique = np.unique(np.asarray(points, np.float64), axis=0)
    if len(unique) < 2:
        raise UserError(f"points: expected at least 2 distinct points, found {len(unique)}")
    chosen = unique[:: max(1, len(unique) // (max_points or len(unique)))]
    distances, _ = cKDTree(unique).query(chosen, k=2)
    return float(np.median(distances[:, 1]))


def sigma_of(
    points: NDArray[np.floating],  # [N, 3]
    settings: PointSplatSettings,
) -> float:
    """Return the standard deviation that the cloud's spacing asks for.

    Raises:
        UserError: there are fewer than two distinct points.
    """
    return settings.sigma_per_spacing * median_spacing(points, _MAX_POINTS_FOR_SPACING)


def offset_for_float32(
    low: NDArray[np.floating],  # [3]
    high: NDArray[np.floating],  # [3]
    finest: float | None = None,
) -> Offset | None:
    """Choose what is to be taken from coordinates, if float32 is too coarse for them.

    It is where its steps at the largest coordinate exceed 1/100 of the finest length. What lies no
    farther out than about ten times its own extent stays: taking an offset would gain no digit.

    Args:
        low: lower corner of the box of the points.
        high: upper corner.
        finest: smallest length that matters, such as the size of a splat; None = 1/1000 of the
            largest side.
    """
    extent = float((high - low).max())
    with np.errstate(all="ignore"):
        step = float(np.spacing(np.float32(max(abs(low).max(), abs(high).max()))))
    if not step > max((extent / 1000 if finest is None else finest) / 100, 1e-6 * extent):
        return None
    # of an object smaller than a unit, a whole unit would leave too much
    unit = 10.0 ** min(0, math.floor(math.log10(extent))) if extent > 0 else 1.0
    x, y, z = (np.round((low + high) / 2 / unit) * unit + 0.0).tolist()  # + 0.0: no negative zero
    return None if (x, y, z) == (0.0, 0.0, 0.0) else (x, y, z)


def without_offset(offset: Offset) -> Similarity:
    """Return the similarity that takes an offset away."""
    away = 0.0 - torch.tensor(offset, dtype=torch.float64)
    return Similarity(1.0, torch.eye(3, dtype=torch.float64), away)


def offset_note(offset: Offset) -> str:
    """Say for people what was taken from the coordinates."""
    numbers = ",".join(f"{value:.15g}" for value in offset)
    return (
        f"{numbers} was subtracted from the coordinates (file_from_source), as float32 is too "
        "coarse so far from the origin"
    )


@plain_torch()
def points_to_splats(
    points: NDArray[np.floating],  # [N, 3]
    colors: NDArray[np.floating],  # [N, 3] sRGB in [0, 1]
    settings: PointSplatSettings | None = None,
    *,
    sigma: float | None = None,
) -> Splats:
    """Turn coloured points into round splats of one size.

    Args:
        points: the cloud.
        colors: its colours.
        settings: None means the default settings.
        sigma: standard deviation of every splat; None = from the spacing.

    Raises:
        UserError: there are fewer than two distinct points, or ``sigma`` is not positive.
    """
    chosen = settings or PointSplatSettings()
    if sigma is None:
        sigma = sigma_of(points, chosen)
    if not 0 < sigma < float("inf"):
        raise UserError(f"--splat-size: expected a positive standard deviation, found {sigma:g}")
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


def thin_to_spacing(
    points: NDArray[np.floating],  # [N, 3]
    spacing: float,
) -> BoolArray:  # [N]
    """Keep one point, the one nearest to the middle, in every cube of side ``spacing``.

    Raises:
        UserError: the spacing is not positive.
    """
    if not 0 < spacing < float("inf"):
        raise UserError(f"--spacing: expected a positive length, found {spacing:g}")
    local = (np.asarray(points, np.float64) - points.min(axis=0)) / spacing
    cubes = np.floor(local)
    off_center = np.square(local - cubes - 0.5).sum(axis=1)
    keys = _cube_numbers(cubes)
    order = np.lexsort((off_center, keys))
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    keep = np.zeros(len(points), np.bool_)
    keep[order[first]] = True
    return keep


def _cube_numbers(cubes: Float64Array) -> IntArray:  # [N, 3] >= 0, whole -> [N]
    """Give every cube a number of its own, in the order of x, then y, then z."""
    extent = cubes.max(axis=0) + 1
    if extent.prod() < 2.0**62:
        x, y, z = cubes.astype(np.int64).T
        _, wide, high = extent.astype(np.int64)
        numbers: IntArray = (x * wide + y) * high + z
        return numbers
    # Places among all cubes of the box would be beyond 64 bits: places among those with points.
    return np.unique(cubes, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def thin_to_count(
    points: NDArray[np.floating],  # [N, 3]
    count: int,
) -> tuple[BoolArray, float]:  # [N]
    """Keep at most, and nearly, ``count`` evenly spread points; return the spacing found too.

    Raises:
        UserError: the count is not positive.
    """
    if count < 1:
        raise UserError(f"--count: expected a positive number, found {count}")
    if count >= len(points):
        return np.ones(len(points), np.bool_), 0.0
    high = float(np.ptp(points, axis=0).max()) * 1.01 + 1e-30
    low = high * 1e-5
    best, spacing = thin_to_spacing(points, high), high
    for _ in range(24):
        middle = float(np.sqrt(low * high))
        mask = thin_to_spacing(points, middle)
        if mask.sum() > count:
            low = middle
        else:
            best, spacing, high = mask, middle, middle
            if mask.sum() > 0.98 * count:
                break
    return best, spacing
