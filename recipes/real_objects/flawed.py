"""What captures leave beside an object, added to clean parts: flying points, haze, a table.

Conventions
-----------
* The object frame; lengths are in object sizes. P's own splats come first, unchanged.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
import torch
from numpy.typing import ArrayLike

from gscomplete.splats import Splats, concatenate
from splatcomplete_data.cuts.geometry import splat_points

Flaw = Literal["none", "flying", "haze", "table"]

_FLYING_SHARE, _FLYING_SPREAD = 0.01, 0.15
_HAZE_SHARE, _HAZE_SPREAD, _HAZE_SIZE, _HAZE_OPACITY = 0.1, 0.06, 0.02, 0.06
_TABLE_SHARE, _TABLE_MARGIN, _TABLE_NOISE = 0.15, 0.1, 0.002
"""A table has so many of P's splats, reaches so far beyond the object, and is so uneven."""


def with_flaw(partial: Splats, complete: Splats, flaw: Flaw, rng: np.random.Generator) -> Splats:
    """Add a flaw to a part.

    Args:
        partial: a part.
        complete: the object that it is a part of.
        flaw: what is added; "none" = nothing.
        rng: draws it.
    """
    if flaw == "none":
        return partial
    add = {"flying": _flying, "haze": _haze, "table": _table}[flaw]
    return concatenate([partial, add(partial, complete, rng)])


def _flying(partial: Splats, _: Splats, rng: np.random.Generator) -> Splats:
    """Return splats of P that lie anywhere about it."""
    some = _some(partial, _FLYING_SHARE, rng)
    return _at(some, splat_points(some) + rng.normal(0, _FLYING_SPREAD, (len(some), 3)))


def _haze(partial: Splats, _: Splats, rng: np.random.Generator) -> Splats:
    """Return large, nearly transparent splats in P's colours."""
    some = _some(partial, _HAZE_SHARE, rng)
    some = _at(some, splat_points(some) + rng.normal(0, _HAZE_SPREAD, (len(some), 3)))
    return dataclasses.replace(
        some,
        scales=torch.full_like(some.scales, _HAZE_SIZE),
        opacities=torch.full_like(some.opacities, _HAZE_OPACITY),
    )


def _table(partial: Splats, complete: Splats, rng: np.random.Generator) -> Splats:
    """Return a grey level layer at the object's lowest place, on the side that P shows."""
    points = splat_points(complete)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = (low + high)[:2] / 2, (high - low)[:2] / 2 + _TABLE_MARGIN
    some = _some(partial, _TABLE_SHARE, rng)
    places = np.empty((len(some), 3))
    places[:, :2] = middle + rng.uniform(-1, 1, (len(some), 2)) * half
    places[:, 2] = low[2] + rng.normal(0, _TABLE_NOISE, len(some))
    shown = splat_points(partial)[:, :2].mean(axis=0) - points[:, :2].mean(axis=0)
    on_side = (places[:, :2] - middle) @ shown >= 0
    table = dataclasses.replace(_at(some, places), sh=torch.zeros_like(some.sh))
    return table.select(torch.from_numpy(on_side))


def _some(partial: Splats, share: float, rng: np.random.Generator) -> Splats:
    count = max(1, round(share * len(partial)))
    return partial.select(torch.from_numpy(rng.integers(len(partial), size=count)))


def _at(splats: Splats, places: ArrayLike) -> Splats:  # [N, 3]
    means = torch.from_numpy(np.asarray(places, np.float32))
    return dataclasses.replace(splats, means=means)
