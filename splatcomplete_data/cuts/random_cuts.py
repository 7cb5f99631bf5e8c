"""Random cuts of complete objects, for training and tests.

Conventions
-----------
* Random cuts are pure functions of (seed, index) and of the splats, which are expected in the
  object frame (centred, largest side 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.splats.record import Splats
from gscomplete.util.arrays import Float32Array
from splatcomplete_data.cuts.geometry import (
    PartialCut,
    by_box,
    by_plane,
    by_visibility,
    eyes_at,
    splat_points,
)

_KEEP_SHARE = (0.35, 0.75)
"""Share of splats that plane cuts keep."""
_FEWEST_SHARE, _MOST_SHARE = 0.12, 0.92
"""A cut that keeps less, or more, is replaced by a plane cut."""
_KIND_SHARES = (0.42, 0.18, 0.25, 0.08, 0.07)
"""Shares of plane, box, visibility, plane+box and plane+visibility."""
_SCAN_ELEVATION_DEG = (-10.0, 45.0)
"""Elevations of the scanner's views."""
_SLIGHT_KIND_SHARES = (0.25, 0.35, 0.2, 0.2)
"""Shares of nothing cut, views from all round, a plane, and a box taken out."""
_SLIGHT_VIEWS = (3, 6)
"""Least and most views from all round."""
_SLIGHT_PLANE_SHARE = (0.85, 0.98)
"""Share of splats that planes keep."""
_SLIGHT_FEWEST_SHARE = 0.35
"""If a cut keeps a smaller share, everything is kept instead. (Of double walls half is out of
sight.)"""
_SLIGHT_VIEW_JITTER_DEG = 25.0
"""Largest difference of a view's azimuth from an even spread."""
_SLIGHT_VIEW_ELEVATION_DEG = (-10.0, 45.0)
"""Elevations of views."""
_SLIGHT_BOX_SIZE = (0.15, 0.35)
"""Edges of boxes, object frame."""


def _random_direction(rng: np.random.Generator) -> Float32Array:  # [3]
    """Draw a unit vector; half of the time along an axis or level, as people cut."""
    kind = rng.random()
    angle = rng.uniform(0, 2 * math.pi)
    if kind < 0.5:
        return np.array([math.cos(angle), math.sin(angle), 0.0], np.float32)
    if kind < 0.65:
        return np.array([0.0, 0.0, 1.0 if kind < 0.58 else -1.0], np.float32)
    direction = rng.normal(size=3)
    return (direction / np.linalg.norm(direction)).astype(np.float32)


def _random_plane(splats: Splats, rng: np.random.Generator, share: float) -> PartialCut:
    """Cut by a random plane that keeps about ``share`` of the splats."""
    normal = _random_direction(rng)
    along = splat_points(splats) @ normal
    return by_plane(splats, normal, float(np.quantile(along, 1.0 - share)))


def _random_box(splats: Splats, rng: np.random.Generator) -> PartialCut:
    """Take away a corner or a hole, or keep a slab."""
    angle = rng.uniform(0, 2 * math.pi)
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]], np.float32)
    points = splat_points(splats)
    anchor = points[int(rng.integers(len(points)))]
    kind = rng.integers(3)
    if kind == 0:
        size, keep = rng.uniform(0.35, 0.8, 3), "outside"
    elif kind == 1:
        size, keep = rng.uniform(0.3, 0.7, 3) * np.array([1, 9, 9]), "inside"
        size[0] = rng.uniform(0.3, 0.6)
    else:
        size, keep = rng.uniform(0.25, 0.45, 3) * np.array([1, 1, 9]), "outside"
    return by_box(splats, anchor, size, turn=turn, keep=keep)  # type: ignore[arg-type]


def _random_scan(splats: Splats, rng: np.random.Generator, bounds: Sequence[float]) -> PartialCut:
    """See the object from one to three views within a sector, as a hand-held scanner does."""
    count = int(rng.choice([1, 2, 3], p=[0.5, 0.3, 0.2]))
    azimuth = rng.uniform(0, 2 * math.pi) + np.cumsum(rng.uniform(0.3, 1.0, count))
    return _scan_from(splats, rng, azimuth, bounds)


def _scan_from(
    splats: Splats,
    rng: np.random.Generator,
    azimuth: NDArray[np.floating],  # [V] radians
    bounds: Sequence[float],
) -> PartialCut:
    """See the object from views at random elevations (degrees) and one random distance."""
    elevation = np.radians(rng.uniform(bounds[0], bounds[1], len(azimuth)))
    eyes = eyes_at(azimuth, elevation) * rng.uniform(1.6, 2.6)
    return by_visibility(splats, eyes, fov_deg=30.0)


def _drawn_kind(weights: Sequence[float], rng: np.random.Generator) -> int:
    """Draw the number of a kind of cut by the kinds' shares."""
    return int(np.searchsorted(np.cumsum(weights), rng.random(), side="right"))


def random_partial(splats: Splats, seed: int, index: int) -> PartialCut:
    """Cut an object at random: planes, boxes, scanner views, or two of them.

    Args:
        splats: a complete object in the object frame.
        seed: seed of the stream.
        index: which cut of the stream.

    Raises:
        ValueError: there are no splats.
    """
    if len(splats) == 0:
        raise ValueError("random_partial: no splats to cut")
    rng = np.random.default_rng((seed, index, 11))
    kind = _drawn_kind(_KIND_SHARES, rng)
    low, high = _KEEP_SHARE
    share = float(rng.uniform(low, high))
    cuts: list[PartialCut]
    if kind == 0:
        cuts = [_random_plane(splats, rng, share)]
    elif kind == 1:
        cuts = [_random_box(splats, rng)]
    elif kind == 2:
        cuts = [_random_scan(splats, rng, _SCAN_ELEVATION_DEG)]
    elif kind == 3:
        cuts = [_random_plane(splats, rng, 0.5 + 0.5 * share), _random_box(splats, rng)]
    else:
        scan = _random_scan(splats, rng, _SCAN_ELEVATION_DEG)
        cuts = [_random_plane(splats, rng, 0.5 + 0.5 * share), scan]
    mask = torch.stack([cut.mask for cut in cuts]).all(dim=0)
    kept = float(mask.float().mean())
    if not _FEWEST_SHARE <= kept <= _MOST_SHARE:
        return _random_plane(splats, rng, share)
    if len(cuts) == 1:
        return cuts[0]
    details = {name: value for cut in cuts for name, value in cut.details.items()}
    return PartialCut(mask, "plane+box" if kind == 3 else "plane+visibility", details)


def slight_partial(splats: Splats, seed: int, index: int) -> PartialCut:
    """Take away little or nothing, as in a capture from all round, which misses what no camera saw.

    Args:
        splats: a complete object in the object frame.
        seed: seed of the stream.
        index: which cut of the stream.

    Raises:
        ValueError: there are no splats.
    """
    if len(splats) == 0:
        raise ValueError("slight_partial: no splats to cut")
    rng = np.random.default_rng((seed, index, 13))
    kind = _drawn_kind(_SLIGHT_KIND_SHARES, rng)
    found: PartialCut | None = None
    if kind == 1:
        count = int(rng.integers(_SLIGHT_VIEWS[0], _SLIGHT_VIEWS[1] + 1))
        jitter = np.radians(rng.uniform(-1, 1, count) * _SLIGHT_VIEW_JITTER_DEG)
        azimuth = rng.uniform(0, 2 * math.pi) + np.arange(count) * (2 * math.pi / count) + jitter
        found = _scan_from(splats, rng, azimuth, _SLIGHT_VIEW_ELEVATION_DEG)
    elif kind == 2:
        found = _random_plane(splats, rng, float(rng.uniform(*_SLIGHT_PLANE_SHARE)))
    elif kind == 3:
        anchor = splat_points(splats)[int(rng.integers(len(splats)))]
        found = by_box(splats, anchor, rng.uniform(*_SLIGHT_BOX_SIZE, 3), keep="outside")
    if found is None or found.kept < _SLIGHT_FEWEST_SHARE * len(splats):
        return PartialCut(torch.ones_like(splats.opacities, dtype=torch.bool), "nothing")
    return found
