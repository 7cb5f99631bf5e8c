"""Known shapes fitted to P: turned about the vertical, scaled along their axes, and moved.

A coarse search over turns, sizes and places of P's box within the shape's box finds poses, and the
best of all shapes are refined. A fitted shape costs more the farther P's points are from its
surface, the more of it would hide P from c, the more of what c sees of it P lacks, and the larger
it is compared with P: any small part fits somewhere in a large shape.

Conventions
-----------
* Poses are those of ``pose``. Distances of P's points from a shape are in units of P's largest side
  and count up to ``FAR``, because P may have something that the shape lacks.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_fill_holes, map_coordinates
from scipy.spatial import cKDTree

from gscomplete.shape.bank.improve import FAR, improve_poses
from gscomplete.shape.bank.pose import (
    MARGIN,
    Pose,
    distance_field,
    surface_centers,
)
from gscomplete.shape.bank.store import BANK_CELLS, Naming, ShapeBank, ShapeName
from gscomplete.splats.rotations import turn_about_z
from gscomplete.util.arrays import BoolArray, Float64Array

_MOST_SHAPES = 80
"""Most shapes of the prompt's noun that are tried."""
_MOST_REFINED = 60
"""Most poses that are refined, over all shapes."""
_POSES_PER_SHAPE = 6
_COARSE_POINTS, _FINE_POINTS, _SEEN_POINTS = 150, 300, 6000
"""Points of P in the coarse search, in refinement, and in the comparison as seen from c."""
_TURNS = 16
_SHARES = (1.0, 0.85, 0.72, 0.6, 0.5)
"""Sizes tried: P's box over the shape's box, along the axis where that ratio is largest."""
_SLACK = 1.08
"""Factor on these sizes: P may stick out of the shape's box by a little."""
_MIDDLE = 0.5
_PLACES = np.array(list(itertools.product((0.0, _MIDDLE, 1.0), repeat=3)))
"""Places tried: along each axis P's box is at one end of the shape's box, in its middle, or at the
other end."""
_NEXT_TO_NO_ROOM = 0.06
"""Along axes where P's box has less room than this within the shape's, only the middle is tried
(in units of the shape's largest side)."""
_SHARE_COST = 0.03
"""Cost of a small share in the coarse search, per natural logarithm."""
_IN_FRONT_COST, _UNSEEN_COST, _GROWTH_COST = 0.15, 0.06, 0.012
"""Weights of ``FittedShape.in_front``, ``unseen`` and ``growth`` in its cost."""
_PICTURE_PX = 40
"""Pixels across P in the pictures from c that P and the shape are compared in."""
_LEAST_ACROSS = 0.04
"""P's extent across the picture counts as at least this share of the extent of both. Otherwise a
rod seen along its axis would make pixels so small that the picture does not fit into memory."""
_TOLERANCE = 0.06
"""A shape hides P where it is this much nearer to c than P, in units of P's largest side."""
_SEEN_DEPTH, _NEAR = 0.03, 0.07
"""c sees those points of a shape that lie at most the first behind its nearest one in their pixel;
P lacks those of them that no point of P is nearer to than the second (same units)."""


@dataclass(frozen=True, slots=True)
class FitLimits:
    """Which fitted shapes suit P."""

    most_cost: float = 0.065
    """Shapes that cost more are left out. Most pairs of random shapes of one noun fit worse."""
    most_growth: float = 3.0
    """Shapes are left out if the box of P and the shape has more than so many times the volume of
    P's box. Then P is little more than one face of the shape, and does not tell how large the rest
    is."""
    in_front_cost: float = 0.0
    """Additional cost of the share of a shape that would hide P, for callers that cut that share
    away."""
    synonym_cost: float = 0.0
    """Additional cost of shapes that another word names: a bird bath for "a bathtub"."""
    other_noun_cost: float = 0.0
    """Additional cost of shapes that only mention the noun in their captions: a lamp table for
    "a lamp"."""

    def cost_of(self, shape: FittedShape, naming: Naming) -> float:
        """Return the additional cost of a shape under these limits."""
        by_name = {"noun": 0.0, "synonym": self.synonym_cost, "caption": self.other_noun_cost}
        return self.in_front_cost * shape.in_front + by_name[naming]


@dataclass(frozen=True, slots=True)
class FittedShape:
    """A known shape in the place that suits P best."""

    name: ShapeName
    cells: BoolArray  # [C, C, C] that its surface passes, shape's frame
    pose: Pose
    points: Float64Array  # [M, 3] centres of these cells, object frame
    residual: float
    """Mean distance of P's points from its surface, in units of P's largest side."""
    in_front: float
    """Share of the shape's surface that would hide P from c."""
    unseen: float
    """Of the surface that c would see of the shape alone, the share that P lacks."""
    growth: float
    """Natural logarithm of the ratio of volumes: the common box of P and the shape over P's box."""
    added_cost: float = 0.0
    """Additional cost under the limits in use (``FitLimits.cost_of``)."""

    @property
    def cost(self) -> float:
        """How badly it suits P; less is better."""
        contradicted = _IN_FRONT_COST * self.in_front + _UNSEEN_COST * self.unseen
        return self.residual + contradicted + _GROWTH_COST * self.growth + self.added_cost

    def moved(self, scale: float, move: Float64Array) -> FittedShape:  # [3]
        """Return the shape for an object whose points p have become ``scale * p + move``."""
        pose = self.pose.of_moved(scale, move)
        return dataclasses.replace(self, pose=pose, points=scale * self.points + move)

    def distances(self, points: Float64Array) -> Float64Array:  # [N, 3] -> [N]
        """Return the distances of points from the shape, object frame; 0 inside a closed shape.

        They are approximate where the pose scales axes differently: the mean scale is used.
        """
        solid = binary_fill_holes(self.cells)
        place = self.pose.to_shape(points)
        within = np.clip(place, -0.5 - MARGIN, 0.5 + MARGIN)
        at = (within + 0.5 + MARGIN) * len(solid) - 0.5
        near: Float64Array = map_coordinates(distance_field(solid), at.T, order=1, mode="nearest")
        beyond = np.linalg.norm(place - within, axis=1)
        far: Float64Array = (near + beyond) / float(self.pose.scales.mean())
        return far


def fit_known_shapes(
    bank: ShapeBank,
    prompt: str,
    points: Float64Array,  # [N, 3]
    toward_c: Float64Array,  # [3]
    count: int,
    limits: FitLimits,
) -> list[FittedShape]:
    """Return the shapes of the prompt's noun that suit P, the best first, at most one per pack.

    Shapes in one pack come from one maker and resemble each other, so two of them agreeing is
    little evidence.

    Args:
        bank: known shapes.
        prompt: text whose noun names the object.
        points: of P, object frame.
        toward_c: unit vector from the object towards the input view.
        count: most shapes.
        limits: which of them suit P.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    size, middle = float((high - low).max()), (low + high) / 2
    if not size > 0:
        return []
    part = (points - middle) / size
    few, more, many = (_spread(part, n) for n in (_COARSE_POINTS, _FINE_POINTS, _SEEN_POINTS))
    shapes = {k: bank.surface(k) for k in bank.named(prompt, _MOST_SHAPES)}
    tried = [(cost, k, pose) for k, cells in shapes.items() for cost, pose in _coarse(cells, few)]
    tried.sort(key=lambda entry: entry[:2])
    begun = tried[:_MOST_REFINED]
    place = {k: n for n, k in enumerate(dict.fromkeys(k for _, k, _ in begun))}
    fields = [distance_field(shapes[k]) for k in place]
    improved = improve_poses(fields, [(place[k], pose) for _, k, pose in begun], more)
    found: dict[int, FittedShape] = {}
    for (_, index, _), (residual, refined) in zip(begun, improved, strict=True):
        fitted = _judged(bank.names[index], shapes[index], refined, residual, many, toward_c)
        added = limits.cost_of(fitted, bank.naming(index, prompt))
        fitted = dataclasses.replace(fitted, added_cost=added)
        if index not in found or fitted.cost < found[index].cost:
            found[index] = fitted
    best: dict[str, FittedShape] = {}
    for shape in sorted(found.values(), key=lambda shape: shape.cost):
        grows = math.exp(shape.growth)
        suits = shape.cost <= limits.most_cost and grows <= limits.most_growth
        if suits and len(best) < count:
            best.setdefault(shape.name.pack, shape)
    return [shape.moved(size, middle) for shape in best.values()]


def _spread(points: Float64Array, count: int) -> Float64Array:
    """Return at most ``count`` of the points, evenly along their order."""
    if len(points) <= count:
        return points
    return points[np.linspace(0, len(points) - 1, count).astype(np.int64)]


def _coarse(
    surface: BoolArray,  # [C, C, C]
    points: Float64Array,  # [N, 3]
) -> list[tuple[float, Pose]]:
    """Search poses of one shape coarsely; return the best few with their costs, the best first."""
    half = BANK_CELLS // 2
    cells = np.asarray(surface.reshape(half, 2, half, 2, half, 2).any(axis=(1, 3, 5)))
    field = distance_field(cells)
    filled = np.argwhere(cells)
    low, high = filled.min(axis=0) / half - 0.5, (filled.max(axis=0) + 1) / half - 0.5
    sides = high - low
    shares = np.array(_SHARES)
    share_costs = np.array([_SHARE_COST * math.log(share) for share in _SHARES])
    found = []
    for yaw in 2 * math.pi * np.arange(_TURNS) / _TURNS:
        turned = points @ turn_about_z(yaw).T
        corner = turned.min(axis=0)
        extent = np.maximum(np.ptp(turned, axis=0), 0.02)
        scales = _SLACK * float((sides / extent).min()) * shares
        room = sides - scales[:, None] * extent
        shifts = low + _PLACES * room[:, None] - scales[:, None, None] * corner
        fits = (room[:, None] > _NEXT_TO_NO_ROOM) | (_PLACES == _MIDDLE)
        tried = np.nonzero(fits.all(axis=2))
        scale, shift = scales[tried[0], None], shifts[tried]
        index = np.zeros((len(shift), len(points)), np.int32)
        for axis in range(3):
            cell = (scale * turned[:, axis] + shift[:, axis, None] + 0.5 + MARGIN) * half
            index = index * len(field) + np.clip(cell.astype(np.int32), 0, len(field) - 1)
        away = np.minimum(field.ravel()[index] / scale, FAR).mean(axis=1)
        costs = np.full(fits.shape[:2], np.inf)
        costs[tried] = away - share_costs[tried[0]]
        for k, places in enumerate(np.argsort(costs, axis=1, kind="stable")[:, :2]):
            found += [(float(costs[k, n]), yaw, scales[k], shifts[k, n]) for n in places]
    found.sort(key=lambda entry: entry[0])
    return [
        (cost, Pose(float(yaw), np.full(3, scale), shift))
        for cost, yaw, scale, shift in found[:_POSES_PER_SHAPE]
        if cost < math.inf
    ]


def _judged(
    name: ShapeName,
    cells: BoolArray,  # [C, C, C]
    pose: Pose,
    residual: float,
    part: Float64Array,  # [N, 3]
    toward_c: Float64Array,  # [3]
) -> FittedShape:
    """Compare a placed shape with P as seen from c, by parallel rays."""
    surface = pose.to_object(surface_centers(cells))
    right = np.cross((0.0, 0.0, 1.0), toward_c)
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0, 0])
    axes = np.stack([right, np.cross(toward_c, right), toward_c])
    p, s = part @ axes.T, surface @ axes.T
    corner = np.minimum(p[:, :2].min(axis=0), s[:, :2].min(axis=0))
    both = float((np.maximum(p[:, :2].max(axis=0), s[:, :2].max(axis=0)) - corner).max())
    across = max(float(np.ptp(p[:, :2], axis=0).max()), _LEAST_ACROSS * both, 1e-6)
    scale = (_PICTURE_PX - 1) / across
    p_px, s_px = (np.floor((q[:, :2] - corner) * scale).astype(np.int64) for q in (p, s))
    shape = tuple(np.maximum(p_px.max(axis=0), s_px.max(axis=0)) + 1)
    part_depth, shape_depth = np.full(shape, -np.inf), np.full(shape, -np.inf)
    np.maximum.at(part_depth, tuple(p_px.T), p[:, 2])
    np.maximum.at(shape_depth, tuple(s_px.T), s[:, 2])
    behind = part_depth[tuple(s_px.T)]
    in_front = np.isfinite(behind) & (s[:, 2] > behind + _TOLERANCE)
    seen = s[:, 2] > shape_depth[tuple(s_px.T)] - _SEEN_DEPTH
    distance, _ = cKDTree(part).query(surface[seen], distance_upper_bound=_NEAR)
    low = np.minimum(part.min(axis=0), surface.min(axis=0))
    high = np.maximum(part.max(axis=0), surface.max(axis=0))
    growth = math.log(np.prod(high - low) / np.prod(np.maximum(np.ptp(part, axis=0), 0.05)))
    unseen = float(np.isinf(distance).mean())
    front = float(in_front.mean())
    return FittedShape(name, cells, pose, surface, residual, front, unseen, growth)
