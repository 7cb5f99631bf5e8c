"""Parts of objects with strays: flying points, floaters, clumps, haze, and worn surfaces without.

Conventions
-----------
* A pure function of the splats, which are in a frame like the object frame, and of random numbers.
* Shares are of the part's splats; lengths are in object sizes.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import torch
from scipy.spatial import cKDTree

from gscomplete.splats import Splats, concatenate
from gscomplete.splats.rotations import thinnest_axes
from gscomplete.util.arrays import BoolArray, Float32Array
from splatcomplete_data.cuts.geometry import eyes_at, splat_points

_FEWEST = 300
_WORN_SHARE = 0.7
"""Share of the parts whose surface is worn."""
_LEAST_KEPT, _MOST_NOISE = 0.1, 0.006
_HOLES_OF_SAMPLES, _HOLE_RADII = 4, (0.05, 0.25)
"""Most places about which a part is sparser, and how far."""
_KIND_SHARE = 0.4
"""Probability of each kind of strays."""
_FLYING, _FLYING_SPREAD = (0.0005, 0.02), (0.03, 0.25)
_CLUTTER, _CLUTTER_BOX = (0.001, 0.1), (1.0, 1.6)
_EDGE, _EDGE_BEHIND, _GRAZING = (0.003, 0.05), (0.01, 0.15), 0.35
_HAZE, _HAZE_SPREAD, _HAZE_SIZE, _HAZE_OPACITY = (
    (0.01, 0.2), (0.02, 0.1), (0.01, 0.06), (0.02, 0.2),
)  # fmt: skip
_CLUMPS, _CLUMP_SPLATS, _CLUMP_SPREAD, _CLUMP_AWAY = 6, (3, 40), (0.005, 0.02), (0.05, 0.3)
_OFF = 0.02
"""What was added this near to the surface is no stray."""


@dataclasses.dataclass(frozen=True, slots=True)
class StrayPart:
    """A part, and which of its splats are strays."""

    splats: Splats
    is_stray: BoolArray  # [N]
    is_surface: BoolArray  # [N] splats that are neither were added on the surface


def stray_part(part: Splats, complete: Splats, rng: np.random.Generator) -> StrayPart | None:
    """Wear a part and add strays to it; None = it has too few splats.

    Args:
        part: without strays.
        complete: the object that it is a part of.
        rng: draws everything.
    """
    if len(part) < _FEWEST:
        return None
    worn = _worn(part, rng) if rng.random() < _WORN_SHARE else part
    kinds = (_flying, _clutter, _edges, _haze, _clumps)
    added = [kind(worn, rng) for kind in kinds if rng.random() < _KIND_SHARE]
    splats = concatenate([worn, *added])
    is_surface = np.arange(len(splats)) < len(worn)
    away, _ = cKDTree(splat_points(complete)).query(splat_points(splats))
    return StrayPart(splats, ~is_surface & (away > _OFF), is_surface)


def _worn(part: Splats, rng: np.random.Generator) -> Splats:
    """Make a surface noisy and uneven, and its splats round, faint or of many sizes."""
    points = splat_points(part)
    kept = rng.random(len(points)) < rng.uniform(_LEAST_KEPT, 1.0)
    for _ in range(int(rng.integers(_HOLES_OF_SAMPLES + 1))):
        anchor = points[int(rng.integers(len(points)))]
        is_near = np.linalg.norm(points - anchor, axis=1) < rng.uniform(*_HOLE_RADII)
        kept &= ~is_near | (rng.random(len(points)) < rng.uniform(0.02, 0.5))
    if int(kept.sum()) < _FEWEST:
        kept[:] = True
    part = part.select(torch.from_numpy(kept))
    count = len(part)
    changed = {}
    if rng.random() < 0.5:
        noise = rng.normal(0, rng.uniform(0, _MOST_NOISE), (count, 3))
        changed["means"] = part.means + torch.from_numpy(noise.astype(np.float32))
    scales = part.scales
    if rng.random() < 0.5:
        size = float(scales.amax(dim=1).median()) * float(rng.uniform(0.5, 1.5))
        scales = torch.full_like(scales, size)
    if rng.random() < 0.4:
        scales = scales * _lognormal(count, 0.5, rng)
    changed["scales"] = scales
    if rng.random() < 0.4:
        low = float(rng.uniform(0.05, 0.9))
        changed["opacities"] = torch.from_numpy(rng.uniform(low, 1, count).astype(np.float32))
    return dataclasses.replace(part, **changed)


def _flying(part: Splats, rng: np.random.Generator) -> Splats:
    strays = _some(part, _count(part, _FLYING, rng), rng)
    return _moved(strays, rng.normal(0, rng.uniform(*_FLYING_SPREAD), (len(strays), 3)))


def _clutter(part: Splats, rng: np.random.Generator) -> Splats:
    strays = _some(part, _count(part, _CLUTTER, rng), rng)
    points = splat_points(part)
    low, high = points.min(axis=0), points.max(axis=0)
    half = float(rng.uniform(*_CLUTTER_BOX)) * (high - low) / 2
    places = (low + high) / 2 + rng.uniform(-1, 1, (len(strays), 3)) * half
    return _moved(strays, places - splat_points(strays))


def _edges(part: Splats, rng: np.random.Generator) -> Splats:
    """Return flying points on the way of a depth camera's rays that graze the surface."""
    eye = eyes_at(float(rng.uniform(0, 2 * math.pi)), float(rng.uniform(0, 0.7)), 2.0).reshape(3)
    sight = splat_points(part) - eye
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    normals = thinnest_axes(part.quaternions, part.scales).numpy()
    grazing = np.flatnonzero(np.abs((normals * sight).sum(axis=1)) < _GRAZING)
    if not len(grazing):
        return part.select(torch.arange(0))
    rows = rng.choice(grazing, _count(part, _EDGE, rng))
    behind = rng.uniform(*_EDGE_BEHIND, (len(rows), 1))
    return _moved(part.select(torch.from_numpy(rows)), behind * sight[rows])


def _haze(part: Splats, rng: np.random.Generator) -> Splats:
    haze = _some(part, _count(part, _HAZE, rng), rng)
    haze = _moved(haze, rng.normal(0, rng.uniform(*_HAZE_SPREAD), (len(haze), 3)))
    sizes = rng.uniform(*_HAZE_SIZE, (len(haze), 1)) * rng.uniform(0.3, 1.0, (len(haze), 3))
    opacities = rng.uniform(*_HAZE_OPACITY, len(haze))
    return dataclasses.replace(
        haze,
        scales=torch.from_numpy(sizes.astype(np.float32)),
        opacities=torch.from_numpy(opacities.astype(np.float32)),
    )


def _clumps(part: Splats, rng: np.random.Generator) -> Splats:
    points, clumps = splat_points(part), []
    for _ in range(int(rng.integers(1, _CLUMPS + 1))):
        clump = _some(part, int(rng.integers(*_CLUMP_SPLATS)), rng)
        way = rng.standard_normal(3)
        away = float(rng.uniform(*_CLUMP_AWAY)) * way / np.linalg.norm(way)
        place = points[int(rng.integers(len(points)))] + away
        spread = rng.normal(0, rng.uniform(*_CLUMP_SPREAD), (len(clump), 3))
        clumps.append(_moved(clump, place + spread - splat_points(clump)))
    return concatenate(clumps)


def _some(part: Splats, count: int, rng: np.random.Generator) -> Splats:
    """Draw splats of a part; half the time with other sizes, opacities, colours."""
    some = part.select(torch.from_numpy(rng.integers(len(part), size=count)))
    changed = {}
    if rng.random() < 0.5:
        changed["scales"] = some.scales * _lognormal(count, 0.7, rng)
    if rng.random() < 0.5:
        changed["opacities"] = torch.from_numpy(rng.uniform(0.05, 1, count).astype(np.float32))
    if rng.random() < 0.5:
        changed["sh"] = torch.from_numpy(rng.uniform(-1.7, 1.7, some.sh.shape).astype(np.float32))
    return dataclasses.replace(some, **changed)


def _count(part: Splats, shares: tuple[float, float], rng: np.random.Generator) -> int:
    low, high = (math.log(share) for share in shares)
    return max(1, round(math.exp(float(rng.uniform(low, high))) * len(part)))


def _moved(splats: Splats, offsets: Float32Array) -> Splats:  # [N, 3]
    return dataclasses.replace(
        splats, means=splats.means + torch.from_numpy(offsets.astype(np.float32))
    )


def _lognormal(count: int, spread: float, rng: np.random.Generator) -> torch.Tensor:  # [N, 1]
    return torch.from_numpy(np.exp(rng.normal(0, spread, (count, 1))).astype(np.float32))
