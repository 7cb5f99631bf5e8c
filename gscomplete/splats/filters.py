"""Find the splats of a set that can be drawn, and count why the others cannot.

Conventions
-----------
* A filter returns a mask of what to keep and a count for each reason to drop; a row is counted
  under the first reason that applies. Nothing is changed or thrown away here: the file's records
  are passed on whatever the mask says.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gscomplete.splats.record import Splats
from gscomplete.util.arrays import BoolArray, Float32Array, Float64Array

MAX_MAGNITUDE = 1e18
"""Largest coordinate or scale whose square is a finite float32."""
MAX_COEFFICIENT = 1e12
"""Largest SH coefficient; squared colours have a finite float32 sum over the pixels of an image."""

FAR_FACTOR = 10.0
"""Positions further than this many half-widths of the middle 90 % from the median are far away."""


def usable_rows(splats: Splats) -> tuple[Tensor, dict[str, int]]:  # [N] bool
    """Mark the splats whose values are finite, representable when squared, and within their range.

    Args:
        splats: N splats in any frame.

    Returns:
        The mask [N], and the number of rows dropped for each reason: ``non_finite_mean``,
        ``non_finite_quaternion``, ``non_finite_scale``, ``non_finite_opacity``, ``non_finite_sh``,
        ``too_large``, ``opacity_out_of_range`` (outside [0, 1], which is no share of the light).
        Reasons without rows are left out.
    """
    tests = {
        "non_finite_mean": splats.means.isfinite().all(dim=1),
        "non_finite_quaternion": splats.quaternions.isfinite().all(dim=1),
        "non_finite_scale": splats.scales.isfinite().all(dim=1),
        "non_finite_opacity": splats.opacities.isfinite(),
        "non_finite_sh": splats.sh.isfinite().flatten(1).all(dim=1),
        "too_large": (splats.means.abs() < MAX_MAGNITUDE).all(dim=1)
        & (splats.scales < MAX_MAGNITUDE).all(dim=1)
        & (splats.sh.abs() < MAX_COEFFICIENT).flatten(1).all(dim=1),
        "opacity_out_of_range": (splats.opacities >= 0) & (splats.opacities <= 1),
    }
    keep = torch.ones(len(splats), dtype=torch.bool, device=splats.means.device)
    counts: dict[str, int] = {}
    for reason, passed in tests.items():
        dropped = int((keep & ~passed).sum())
        if dropped:
            counts[reason] = dropped
        keep &= passed
    return keep, counts


def reason_in_words(reason: str) -> str:
    """Return a reason to drop rows as text for users; JSON has the reason itself."""
    return reason.replace("_", " ")


def in_words(counts: dict[str, int]) -> str:
    """Return the counts of a filter's reasons as text."""
    return ", ".join(f"{count:,} {reason_in_words(reason)}" for reason, count in counts.items())


def near_rows(splats: Splats) -> tuple[Tensor, dict[str, int]]:  # [N] bool
    """Mark the splats that are not far outside the others; in a sound file, all but floaters.

    Args:
        splats: at least one, all finite.

    Returns:
        The mask [N], and the number of rows dropped as ``far_away``; empty if there are none.
    """
    means = splats.means.detach().cpu().numpy()
    far = torch.from_numpy(far_positions(means, *middle_and_extent(means), FAR_FACTOR))
    count = int(far.sum())
    return ~far.to(splats.means.device), {"far_away": count} if count else {}


def middle_and_extent(
    means: Float32Array,  # [N, 3]
) -> tuple[Float64Array, float]:  # [3]
    """Return the median position, and the largest side of the box of the middle 90 % by axis."""
    low, middle, high = np.quantile(means, (0.05, 0.5, 0.95), axis=0).astype(np.float64)
    return middle, float((high - low).max())


def far_positions(
    means: Float32Array,  # [N, 3]
    middle: Float64Array,  # [3]
    extent: float,
    factor: float,
) -> BoolArray:  # [N]
    """Mark positions further than ``factor`` half extents from the middle along any axis."""
    if not extent > 0:
        return np.zeros(len(means), bool)
    offsets = np.abs(means - middle.astype(np.float32)).max(axis=1)
    return np.asarray(offsets > factor * extent / 2)
