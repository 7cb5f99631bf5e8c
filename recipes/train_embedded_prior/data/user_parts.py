"""Parts of complete objects as users bring them: scans, arcs, halves, boxes, with scanner flaws.

Conventions
-----------
* A pure function of (seed, index) and of the splats, which are in the object frame.
* Kinds: one scanner view; two to four views along an arc of 50 to 180 degrees; a plane near the
  middle at any azimuth, mostly upright; a box; the cuts of ``random_partial``.
* Scanner flaws are those of a depth camera: noise and steps along the line of sight, grazing
  surfaces lost, fixed-size round splats, a patch of the table below.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.splats import Splats, concatenate
from gscomplete.splats.rotations import thinnest_axes
from gscomplete.util.arrays import Float32Array
from splatcomplete_data.cuts.geometry import (
    by_box,
    by_plane,
    by_visibility,
    eyes_at,
    splat_points,
)
from splatcomplete_data.cuts.random_cuts import random_partial, slight_partial
from splatcomplete_data.flaws import corrupt

_SHARES = (0.28, 0.2, 0.24, 0.13, 0.15)
"""Of one view, an arc, a plane, a box, and ``random_partial``."""
_FEWEST_SHARE = 0.08
_ALMOST_ALL = 0.97
"""A cut again that keeps more than this share is none; it keeps a half at least."""
_TABLE_SHARE = 0.08
"""Share of disturbed scans that keep a patch of the table."""
_TABLE_COLORS = 0.25


def user_part(splats: Splats, seed: int, index: int, *, disturb: bool, slight: bool) -> Splats:
    """Return a part of an object.

    Args:
        splats: a complete object in the object frame.
        seed: seed of the stream.
        index: which part of the stream.
        disturb: give it flaws of real captures.
        slight: let it lack little or nothing.
    """
    rng = np.random.default_rng((seed, index, 21))
    if slight:
        mask = slight_partial(splats, seed, index).mask
        return corrupt(splats, mask, seed, index) if disturb else splats.select(mask)
    kind = int(np.searchsorted(np.cumsum(_SHARES), rng.random(), side="right"))
    eyes = None
    if kind == 0:
        eyes = _eyes(np.array([rng.uniform(0, 2 * math.pi)]), rng)
    elif kind == 1:
        arc = math.radians(float(rng.uniform(50, 180)))
        count = 2 + int(arc / math.radians(65))
        eyes = _eyes(rng.uniform(0, 2 * math.pi) + np.linspace(0, arc, count), rng)
    if eyes is not None:
        mask = by_visibility(splats, eyes, fov_deg=30.0).mask
    elif kind == 2:
        mask = by_plane(splats, _normal(rng), float(rng.uniform(-0.15, 0.15))).mask
    elif kind == 3:
        anchor = splat_points(splats)[int(rng.integers(len(splats)))]
        mask = by_box(splats, anchor, rng.uniform(0.35, 0.85, 3), keep="outside").mask
    else:
        mask = random_partial(splats, seed, index).mask
    if float(mask.float().mean()) < _FEWEST_SHARE:
        mask, eyes = random_partial(splats, seed, index).mask, None
    if not disturb:
        return splats.select(mask)
    part = corrupt(splats, mask, seed, index)
    if eyes is None:
        return part
    return _scanned(part, splats, eyes, rng)


def cut_again(part: Splats, rng: np.random.Generator) -> Splats:
    """Cut a part once more, by a plane through one of its points; not where little would go.

    Args:
        part: in the object frame.
        rng: draws the plane.
    """
    normal = _normal(rng)
    anchor = splat_points(part)[int(rng.integers(len(part)))]
    mask = by_plane(part, normal, float(anchor @ normal)).mask
    if float(mask.float().mean()) < 0.5:
        mask = ~mask
    return part.select(mask) if float(mask.float().mean()) < _ALMOST_ALL else part


def _eyes(azimuth: NDArray[np.floating], rng: np.random.Generator) -> Float32Array:  # [V] -> [V, 3]
    """Place scanners at one distance and about one elevation."""
    elevation = np.radians(rng.uniform(-5, 40) + rng.uniform(-6, 6, len(azimuth)))
    return (eyes_at(azimuth, elevation) * rng.uniform(1.4, 2.8)).astype(np.float32)


def _normal(rng: np.random.Generator) -> Float32Array:  # [3]
    """Draw a plane's normal: upright in two of three, else at any tilt."""
    azimuth = float(rng.uniform(0, 2 * math.pi))
    tilt = 0.0 if rng.random() < 0.67 else float(rng.uniform(-math.pi / 2, math.pi / 2))
    flat = math.cos(tilt)
    return np.array(
        [flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(tilt)], np.float32
    )


def _scanned(
    part: Splats, complete: Splats, eyes: Float32Array, rng: np.random.Generator
) -> Splats:
    """Give a scan the flaws of a depth camera."""
    points = splat_points(part)
    nearest = np.square(points[:, None] - eyes[None]).sum(axis=2).argmin(axis=1)
    sight = points - eyes[nearest]
    distance = np.linalg.norm(sight, axis=1)
    sight /= distance[:, None]
    kept = np.ones(len(points), np.bool_)
    if rng.random() < 0.6:
        normals = thinnest_axes(part.quaternions, part.scales).numpy()
        kept = np.abs((normals * sight).sum(axis=1)) > rng.uniform(0.08, 0.35)
        if kept.mean() < 0.5:
            kept[:] = True
    step = float(rng.uniform(0, 0.012)) * float(rng.random() < 0.5)
    moved = rng.normal(0, rng.uniform(0, 0.006), len(points))
    if step > 1e-4:
        moved += np.round(distance / step) * step - distance
    means = (points + sight * moved[:, None]).astype(np.float32)
    part = dataclasses.replace(part, means=torch.from_numpy(means))
    part = part.select(torch.from_numpy(kept))
    if rng.random() < 0.6:
        size = float(part.scales.amax(dim=1).median()) * float(rng.uniform(0.7, 1.3))
        part = dataclasses.replace(part, scales=torch.full_like(part.scales, size))
    if rng.random() < _TABLE_SHARE:
        part = concatenate([part, _table(part, complete, rng)])
    return part


def _table(part: Splats, complete: Splats, rng: np.random.Generator) -> Splats:
    """Return splats of a flat patch under the object's lowest point, to one side of its middle."""
    count = int(len(part) * rng.uniform(0.03, 0.15))
    chosen = part.select(torch.from_numpy(rng.integers(len(part), size=count)))
    points = splat_points(complete)
    low, high = points.min(axis=0), points.max(axis=0)
    middle = rng.uniform(low[:2], high[:2])
    spread = rng.uniform(0.05, 0.25)
    place = np.empty((count, 3), np.float32)
    place[:, :2] = middle + rng.uniform(-spread, spread, (count, 2))
    place[:, 2] = low[2] + rng.normal(0, 0.004, count)
    sh = torch.full_like(chosen.sh, float(rng.uniform(-1, 1)))
    sh += _TABLE_COLORS * torch.from_numpy(rng.standard_normal(3).astype(np.float32))
    return dataclasses.replace(chosen, means=torch.from_numpy(place), sh=sh)
