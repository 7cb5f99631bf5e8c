"""Find the splats of a set that can be drawn, and count why the others cannot.

Conventions
-----------
* A filter returns a mask of what to keep and a count for each reason to drop; a row is counted
  under the first reason that applies. Nothing is changed or thrown away here: the file's records
  are passed on whatever the mask says.
"""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from gscomplete.splats.record import Splats

MAX_MAGNITUDE = 1e18
"""Largest coordinate or scale whose square is a finite float32."""
MAX_COEFFICIENT = 1e12
"""Largest SH coefficient; squared colours have a finite float32 sum over the pixels of an image."""


def usable_rows(splats: Splats) -> tuple[Tensor, dict[str, int]]:  # [N] bool
    """Mark the splats whose values are finite, representable when squared, and within their range.

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


def thinned(splats: Splats, limit: int, generator: torch.Generator) -> Splats:
    """Return an even random choice of at most ``limit`` splats, widths grown to match."""
    count = len(splats)
    if count <= limit:
        return splats
    chosen = splats.select(torch.randperm(count, generator=generator)[:limit].sort().values)
    return dataclasses.replace(chosen, scales=chosen.scales * (count / limit) ** 0.5)
