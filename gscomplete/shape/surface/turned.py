"""The rest of a surface of revolution: P turned about its axis, where P has no surface yet.

P's points are given the mean place of the points that are alike in radius, height and normal,
whatever their azimuth, which takes scanners' noise out. Places where the whole surface goes round
but P does not are then drawn at random azimuths.

Conventions
-----------
* Object frame; axis coordinates as in ``splats.geometry.axis_coordinates``.
* Normals point away from the other side of a thin wall, else to the side that V's views see empty,
  else away from the middle, unless most of those at the same radius and height point the other way.
* The body is what of P belongs to the surface of revolution; the rest, such as a handle, is its
  features.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.shape.evidence import Evidence
from gscomplete.splats import Splats
from gscomplete.splats.geometry.axis_coordinates import SECTORS, Turning, turned
from gscomplete.splats.geometry.nearest import query_nearest
from gscomplete.splats.geometry.neighbourhood import normals_at, one_sidedness
from gscomplete.splats.geometry.revolution import Revolution
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import BoolArray, Float32Array, Float64Array, IntArray

_MOST_POINTS = 20_000
_DRAWN = 60_000
"""Places on the whole surface, P's part included."""
_TIMES, _SIDEWAYS = 4, 0.01
"""So many places are made of each one that is drawn, within this distance to both sides."""
_OUT = 0.06
"""Evidence is asked for this far to both sides of P's surface."""
_MORE_EMPTY = 0.2
"""A side is the outer one if so many more views see it empty."""
_WALLS, _WALL_REACH = (0.015, 0.025, 0.04, 0.06, 0.09), 0.4
"""Depths at which the other side of a wall is looked for, and how far about these, in depths."""
_LEVEL = 0.3
"""A surface whose normal's radial part is smaller faces up or down rather than out."""
_NORMAL_REACH, _OWN_NORMAL_REACH = 0.1, 0.05
"""Lengths of normals beside places when points are compared: both walls of a cup are kept apart."""
_ALIKE = 12
_LEAST_ROUND = 0.45
"""Points whose like are in fewer sectors than this share of the median are not turned."""
_NEAR, _NEAR_RIM, _ONE_SIDED = 0.03, 0.01, 0.7
"""Limits like those of ``cover.SurfaceSettings``: a place is P's own, but only by the wall that
faces its way."""
_LEAST_MISSING, _MOST_HIDING = 0.03, 0.1
"""The surface is not used if P lacks less of it, or if views see more of what P lacks in front of
P."""
_LEAST_BESIDE_COPIES = 0.2
"""Least share of the places that mirrored splats leave for the surface to be used beside them."""
_SPACED = 2000
"""About so many places tell how far apart all are."""
_BEFORE, _FACING = 0.01, 0.5
"""A point lies before the body if it is so far before the nearest place, in a direction that is so
near to the normal's (cosine). A normal is opposite to another from the same cosine on."""
_ON_BODY = 0.015
"""A point lies on the body if it is nearer to it."""
_FEATURE_REACH = 0.05


@dataclass(frozen=True, slots=True)
class AgainstBody:
    """Which of M points the body of a surface of revolution leaves no room for."""

    contradicts: Tensor  # [M] bool
    """They would lie before it."""
    repeats: Tensor  # [M] bool
    """They lie on it, and do not face the other way, as the other side of a thin wall does."""


@dataclass(frozen=True, slots=True)
class TurnedSurface:
    """What P lacks of the surface of revolution that it is part of."""

    points: Tensor  # [N, 3]
    normals: Tensor  # [N, 3] outward
    revolution: Revolution
    body: Turning
    """P's body, normals outward."""
    features: Float64Array  # [F, 3]
    """P's features, axis coordinates."""

    def beside_copies(self, is_missing: Tensor) -> TurnedSurface | None:  # [N] bool
        """Return what is missing beside mirrored splats; None = too little to be used.

        Narrow strips are better closed by the network's surface, which meets both of their sides.
        """
        asked = is_missing.numpy(), self.points.double().numpy(), self.normals.double().numpy()
        kept = torch.from_numpy(_mostly(*asked))
        if float(kept.double().mean()) < _LEAST_BESIDE_COPIES:
            return None
        return dataclasses.replace(self, points=self.points[kept], normals=self.normals[kept])

    def colored_by(self, partial: Splats) -> Splats:
        """Return the splats away from P's features: the turned surface takes their colours."""
        there = self.revolution.axis.to_axis(partial.means.double().numpy())
        kept = torch.from_numpy(~self._is_beside_feature(there))
        return partial.select(kept) if bool(kept.any()) else partial

    def spacing(self) -> float:
        """Return the median distance of places from their nearest neighbours."""
        places = self.points.numpy()
        asked = every_nth(places, _SPACED)
        distance, _ = cKDTree(places).query(asked, k=range(1, min(2, len(places)) + 1))
        return float(np.median(distance[:, -1])) if len(places) else 0.0

    def against_body(
        self,
        points: Tensor,  # [M, 3]
        normals: Tensor,  # [M, 3] outward
    ) -> AgainstBody:
        """Compare points with P's body, turned to the place nearest to each of them.

        Where P's body is seen nothing lies before it, so nothing belongs there all round, and on it
        the turned surface is all there is. Beside P's features points are not marked: they may
        belong to these. So a handle stays the only one.
        """
        axis = self.revolution.axis
        there = axis.to_axis(points.double().numpy())
        distance, before, facing = self._from_body(there)
        normal = normals.double().numpy() @ axis.rotation.T
        outward = there[:, :2] / np.hypot(there[:, 0], there[:, 1]).clip(1e-9)[:, None]
        along = (normal[:, :2] * outward).sum(axis=1) * facing[:, 0] + normal[:, 2] * facing[:, 1]
        contradicts = (before > _BEFORE) & (before > _FACING * distance)
        repeats = (distance < _ON_BODY) & (along > -_FACING)
        marked = np.flatnonzero(contradicts | repeats)
        exempt = marked[self._is_beside_feature(there[marked])]
        contradicts[exempt] = repeats[exempt] = False
        return AgainstBody(torch.from_numpy(contradicts), torch.from_numpy(repeats))

    def _from_body(
        self, there: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array]:  # [M, 3] -> [M], [M], [M, 2]
        """Turn places in axis coordinates to the nearest of P's body.

        Returns:
            How far they are from it and how far before it, and its normal, radially and upward.
        """
        places = np.stack([np.hypot(there[:, 0], there[:, 1]), there[:, 2]], axis=1)
        body = np.stack([self.body.radius, self.body.points[:, 2]], axis=1)
        distance, nearest = query_nearest(cKDTree(body), places)
        facing = np.stack([self.body.radial, self.body.normals[:, 2]], axis=1)[nearest]
        return distance, ((places - body[nearest]) * facing).sum(axis=1), facing

    def _is_beside_feature(self, there: Float64Array) -> BoolArray:  # [M, 3] -> [M]
        """Mark places in axis coordinates."""
        if not len(self.features):
            return np.zeros(len(there), np.bool_)
        away, _ = query_nearest(cKDTree(self.features), there, within=2 * _FEATURE_REACH)
        return np.asarray(away <= _FEATURE_REACH)


def turned_surface(
    points: Float64Array,  # [N, 3]
    revolution: Revolution,
    evidence: Evidence,
    generator: torch.Generator,
    axes: Float64Array | None = None,  # [N, 3]
) -> TurnedSurface | None:
    """Turn P about its axis; None = P lacks next to nothing of the surface, or views contradict it.

    Args:
        points: centres of P's splats, object frame.
        revolution: the surface that they are part of.
        evidence: what V's views say about space.
        generator: chooses places on the surface.
        axes: of P's splats (``neighbourhood.flat_axes``); None = unknown.
    """
    chosen = every_nth(points, _MOST_POINTS)
    axes = None if axes is None else every_nth(axes, _MOST_POINTS)
    own = Turning.about(revolution.axis, chosen, _outward(chosen, axes, revolution, evidence))
    body, sectors = own.body()
    if not body.any():
        return None
    places, normals, around = _profile(own.select(body))
    goes_round = around > _LEAST_ROUND * np.median(around)
    sides = _drawn(goes_round * SECTORS / np.maximum(sectors[body], 1), generator)
    angle = 2 * math.pi * torch.rand(_DRAWN, generator=generator, dtype=torch.float64).numpy()
    places, normals = turned(places[sides], angle), turned(normals[sides], angle)
    lacks = _mostly(_is_missing(places, normals, own), places, normals)
    places, normals = places[lacks], normals[lacks]
    shown = _seen_empty(evidence, revolution, places) <= 0.5
    if lacks.mean() < _LEAST_MISSING or shown.mean() < 1.0 - _MOST_HIDING:
        return None
    places, normals = _denser(places[shown], normals[shown], generator)
    return TurnedSurface(
        torch.from_numpy(revolution.axis.from_axis(places)).float(),
        torch.from_numpy(normals @ revolution.axis.rotation).float(),
        revolution,
        own.select(body).select(goes_round),
        own.points[~body],
    )


def _outward(
    points: Float64Array,  # [N, 3]
    axes: Float64Array | None,  # [N, 3]
    revolution: Revolution,
    evidence: Evidence,
) -> Float64Array:  # [N, 3]
    """Return P's normals, object frame, turned outward as said above."""
    tree = cKDTree(points)
    normals = normals_at(points, points, tree, axes)
    ahead, behind = (
        evidence.classify((points + way * _OUT * normals).astype(np.float32))[:, 0]
        for way in (1.0, -1.0)
    )
    turning = Turning.about(revolution.axis, points, normals)
    height = turning.points[:, 2]
    away_up = turning.normals[:, 2] * np.sign(height - (height.min() + height.max()) / 2)
    away = np.where(np.abs(turning.radial) > _LEVEL, turning.radial, away_up)
    is_seen = np.abs(ahead - behind) > _MORE_EMPTY
    out = np.where(is_seen, ahead - behind, away)
    wall = _wall_ahead(points, normals, tree)
    sign = np.where(np.where(wall != 0, -wall, out) < 0, -1.0, 1.0)
    return normals * (sign * _against_others(turning, sign))[:, None]


def _against_others(turning: Turning, sign: Float64Array) -> Float64Array:  # [N] -> [N]
    """Return -1 where a normal of that sign opposes most of those at the same profile, else 1.

    Signs are wrong here and there, and what lies before the wall would seem to be behind it there.
    """
    places = np.stack([turning.radius, turning.points[:, 2]], axis=1)
    facing = sign[:, None] * np.stack([turning.radial, turning.normals[:, 2]], axis=1)
    nearest = range(1, min(_ALIKE, len(places)) + 1)
    _, index = query_nearest(cKDTree(places), places, nearest)
    along = (facing[index].mean(axis=1) * facing).sum(axis=1)
    return np.where(along < 0, -1.0, 1.0)


def _wall_ahead(
    points: Float64Array,  # [N, 3]
    normals: Float64Array,  # [N, 3]
    tree: cKDTree,
) -> Float64Array:  # [N]
    """Return 1 where the other side of a thin wall lies ahead, -1 where behind, 0 if unknown."""
    found = []
    for way in (1.0, -1.0):
        reached = np.zeros(len(points), np.bool_)
        for depth in _WALLS:
            distance, _ = tree.query(
                points + way * depth * normals, distance_upper_bound=_WALL_REACH * depth
            )
            reached |= np.isfinite(distance)
        found.append(reached)
    ahead, behind = found
    return np.where(ahead == behind, 0.0, np.where(ahead, 1.0, -1.0))


def _profile(
    body: Turning,
) -> tuple[Float64Array, Float64Array, IntArray]:  # [B, 3], [B, 3], [B]
    """Return the body's points at azimuth 0 and their normals, averaged over points alike.

    Also returns in how many sectors these are: few where a handle's foot is in the body.
    """
    places = np.stack([body.radius, body.points[:, 2]], axis=1)
    facing = np.stack([body.radial, body.normals[:, 2]], axis=1)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True).clip(1e-9)
    like = np.concatenate([places, _NORMAL_REACH * facing], axis=1)
    _, index = cKDTree(like).query(like, k=range(1, min(_ALIKE, len(like)) + 1))
    along = ((places[index] - places[:, None]) * facing[:, None]).sum(axis=2).mean(axis=1)
    places = places + along[:, None] * facing
    nothing = np.zeros(len(places))
    sectors = np.sort(body.sectors()[index], axis=1)
    return (
        np.stack([places[:, 0].clip(0.0), nothing, places[:, 1]], axis=1),
        np.stack([facing[:, 0], nothing, facing[:, 1]], axis=1),
        1 + (np.diff(sectors, axis=1) > 0).sum(axis=1),
    )


def _drawn(weights: Float64Array, generator: torch.Generator) -> IntArray:  # [B] -> [D]
    """Draw indices with these weights."""
    ends = np.cumsum(weights)
    at = torch.rand(_DRAWN, generator=generator, dtype=torch.float64).numpy() * ends[-1]
    return np.minimum(np.searchsorted(ends, at, side="right"), len(weights) - 1)


def _is_missing(
    places: Float64Array,  # [D, 3] axis coordinates
    normals: Float64Array,  # [D, 3]
    own: Turning,
) -> BoolArray:  # [D]
    """Mark the places where P has no surface that faces the same way."""
    tree = cKDTree(np.concatenate([own.points, _OWN_NORMAL_REACH * own.normals], axis=1))
    asked = np.concatenate([places, _OWN_NORMAL_REACH * normals], axis=1)
    distance, _ = query_nearest(tree, asked, within=_NEAR)
    beside, _ = query_nearest(cKDTree(own.points), places, within=_NEAR_RIM)
    missing: BoolArray = ~np.isfinite(distance) & ~np.isfinite(beside)
    close = np.flatnonzero(np.isfinite(distance) & ~np.isfinite(beside))
    _, index = query_nearest(tree, asked[close], range(1, min(_ALIKE, len(own.points)) + 1))
    offsets = own.points[index] - places[close, None]
    along = (offsets * normals[close, None]).sum(axis=2, keepdims=True)
    missing[close] = one_sidedness(offsets - along * normals[close, None]) > _ONE_SIDED
    return missing


def _mostly(
    missing: BoolArray,  # [D]
    places: Float64Array,  # [D, 3]
    normals: Float64Array,  # [D, 3]
) -> BoolArray:  # [D]
    """Keep the missing places among whose neighbours most are missing, too: no specks."""
    like = np.concatenate([places, _OWN_NORMAL_REACH * normals], axis=1)
    lacking = np.flatnonzero(missing)
    _, index = query_nearest(cKDTree(like), like[lacking], range(1, _ALIKE + 1))
    kept = np.zeros_like(missing)
    kept[lacking] = missing[index].mean(axis=1) > 0.5
    return kept


def _denser(
    places: Float64Array,  # [D, 3] axis coordinates
    normals: Float64Array,  # [D, 3]
    generator: torch.Generator,
) -> tuple[Float64Array, Float64Array]:  # [_TIMES * D, 3]
    """Add places a little to both sides of each one, as seen from the axis."""
    places, normals = (np.tile(rows, (_TIMES, 1)) for rows in (places, normals))
    radius = np.hypot(places[:, 0], places[:, 1])
    way = 2 * torch.rand(len(places), generator=generator, dtype=torch.float64).numpy() - 1
    angle = way * np.minimum(_SIDEWAYS / radius.clip(1e-9), math.pi)
    return turned(places, angle), turned(normals, angle)


def _seen_empty(
    evidence: Evidence,
    revolution: Revolution,
    places: Float64Array,  # [N, 3] axis coordinates
) -> Float32Array:  # [N]
    """Return the share of views that find each place in front of P."""
    return evidence.classify(revolution.axis.from_axis(places).astype(np.float32))[:, 0]
