"""Known shapes fitted to P: turned about the vertical, scaled along their axes, and moved.

Poses are tried coarsely (turns, sizes, and P's box against the sides of the shape's box), and the
best of all shapes refined. A fit is judged by how far P's points are from the shape's surface, how
much of the shape would hide P from c, how much of what c sees of it P does not have, and how much
larger than P it is: a large shape has a place for any small part.

Conventions
-----------
* Poses are those of ``pose``. Distances count in P's largest side, up to ``FAR`` of it: what P has
  and the shape lacks.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, map_coordinates
from scipy.spatial import cKDTree

from gscomplete.shape.bank.improve import FAR, improve_poses
from gscomplete.shape.bank.pose import (
    MARGIN,
    FloatArray,
    Pose,
    distance_field,
    surface_centers,
    turn_about_z,
)
from gscomplete.shape.bank.store import BANK_CELLS, Naming, ShapeBank, ShapeName

_MOST_SHAPES = 80
"""Shapes of the prompt's noun that are looked at."""
_MOST_REFINED = 60
"""Poses of all shapes together."""
_POSES_PER_SHAPE = 6
_COARSE_POINTS, _FINE_POINTS, _SEEN_POINTS = 150, 300, 6000
_TURNS = 16
_SHARES = (1.0, 0.85, 0.72, 0.6, 0.5)
"""How much of the shape P is along the axis where it is most of it ..."""
_SLACK = 1.08
"""... of which it may be a little more."""
_MIDDLE = 0.5
_PLACES = np.array(list(itertools.product((0.0, _MIDDLE, 1.0), repeat=3)))
"""Places of P's box within the shape's, by the room along each axis ..."""
_NEXT_TO_NO_ROOM = 0.06
"""... of which less than this, of the shape's side, leaves it in the middle."""
_SHARE_COST = 0.03
_IN_FRONT_COST, _UNSEEN_COST, _GROWTH_COST = 0.15, 0.06, 0.012
_PICTURE_PX = 40
_LEAST_ACROSS = 0.04
"""P's extent across c counts as no less, of P's and the shape's together: the picture of a rod that
is seen along its axis would fill the memory."""
_TOLERANCE = 0.06
"""In front of P by more than this, object sizes, a shape would hide it."""
_SEEN_DEPTH, _NEAR = 0.03, 0.07
"""What lies this near behind the nearest part of a shape is seen of it; P has what is this near."""


@dataclass(frozen=True, slots=True)
class FitLimits:
    """Which fitted shapes suit P."""

    most_cost: float = 0.065
    """Worse shapes are left out; of two random shapes of one noun most are."""
    most_growth: float = 3.0
    """A shape that needs more than so many times P's box is left out: P is no more than a face of
    it, and what is behind a face may have any size."""
    in_front_cost: float = 0.0
    """More for the share that would hide P: what hides it is cut away."""
    synonym_cost: float = 0.0
    """More for shapes of another word for the noun: a bird bath for "a bathtub"."""
    other_noun_cost: float = 0.0
    """More for shapes that only their captions connect with it: a lamp table for "a lamp"."""

    def cost_of(self, shape: FittedShape, naming: Naming) -> float:
        """Return what is added to a shape's cost."""
        by_name = {"noun": 0.0, "synonym": self.synonym_cost, "caption": self.other_noun_cost}
        return self.in_front_cost * shape.in_front + by_name[naming]


@dataclass(frozen=True, slots=True)
class FittedShape:
    """A known shape in the place that suits P best."""

    name: ShapeName
    cells: NDArray[np.bool_]  # [C, C, C] that its surface passes, shape's frame
    pose: Pose
    points: FloatArray  # [M, 3] centres of these cells, object frame
    residual: float
    """Mean distance of P's points from its surface."""
    in_front: float
    """Share of it that would hide P from c."""
    unseen: float
    """Share of what c sees of it that P does not have."""
    growth: float
    """Logarithm of the volume of its box and P's together over that of P's."""
    added_cost: float = 0.0
    """What the limits add to the cost."""

    @property
    def cost(self) -> float:
        """How badly it suits P; less is better."""
        contradicted = _IN_FRONT_COST * self.in_front + _UNSEEN_COST * self.unseen
        return self.residual + contradicted + _GROWTH_COST * self.growth + self.added_cost

    def moved(self, scale: float, move: FloatArray) -> FittedShape:  # [3]
        """Return it in the place of an object whose points p are now ``scale * p + move``."""
        pose = self.pose.of_moved(scale, move)
        return dataclasses.replace(self, pose=pose, points=scale * self.points + move)

    def distances(self, points: FloatArray) -> FloatArray:  # [N, 3] -> [N]
        """Return how far points of the object frame are from the shape; 0 within a closed one.

        Where the shape is scaled differently along its axes the mean scale counts.
        """
        solid = binary_fill_holes(self.cells)
        place = self.pose.to_shape(points)
        within = np.clip(place, -0.5 - MARGIN, 0.5 + MARGIN)
        at = (within + 0.5 + MARGIN) * len(solid) - 0.5
        near: FloatArray = map_coordinates(distance_field(solid), at.T, order=1, mode="nearest")
        beyond = np.linalg.norm(place - within, axis=1)
        far: FloatArray = (near + beyond) / float(self.pose.scales.mean())
        return far


def fit_known_shapes(
    bank: ShapeBank,
    prompt: str,
    points: FloatArray,  # [N, 3]
    toward_c: FloatArray,  # [3]
    count: int,
    limits: FitLimits,
) -> list[FittedShape]:
    """Return the shapes of the prompt's noun that suit P, the best first, one from each pack.

    Shapes of one maker are alike, so their agreement says little.

    Args:
        bank: known shapes.
        prompt: names the noun.
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


def _spread(points: FloatArray, count: int) -> FloatArray:
    """Return at most ``count`` of the points, evenly along their order."""
    if len(points) <= count:
        return points
    return points[np.linspace(0, len(points) - 1, count).astype(np.int64)]


def _coarse(
    surface: NDArray[np.bool_],  # [C, C, C]
    points: FloatArray,  # [N, 3]
) -> list[tuple[float, Pose]]:
    """Try poses; return the best with their costs."""
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
    cells: NDArray[np.bool_],  # [C, C, C]
    pose: Pose,
    residual: float,
    part: FloatArray,  # [N, 3]
    toward_c: FloatArray,  # [3]
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
