"""Find the axis that P's surface turns about, if P is part of a surface of revolution.

Bowls, bottles, lamps and tapes are such surfaces, up to a handle or a spout. The normals of a
surface of revolution meet its axis (Pottmann and Randrup, "Rotational and helical surface
approximation for reverse engineering", Computing 60, 1998), and points that are alike in height and
normal are equally far from it. An upright axis is drawn from pairs of normals, refined with its
tilt by least squares over all normals, and then by the distances, which determine it more exactly.

Conventions
-----------
* z is up. The axis is upright or nearly so; coordinates about it as in ``axis_coordinates``.
* Lengths are in sides of P's box, unless a docstring says otherwise. Arithmetic is float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gscomplete.splats.geometry.axis_coordinates import (
    NEAR_AXIS,
    OFF,
    OFF_SINE,
    STEEP,
    Axis,
    Turning,
    in_box_sides,
    off_plane,
    turned,
)
from gscomplete.splats.geometry.neighbourhood import lie_on_surface, normals_at
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import BoolArray, Float64Array

_MOST_POINTS = 20_000
_TESTED = 2500
_FEWEST_STEEP = 100
_PAIRS = 500
_LEAST_CROSSING = 0.25
"""Least sine between two normals that an axis is drawn from."""
_TILT, _MOST_TILT = 0.1, 0.2
"""Tilts are small: standard deviation of the prior, and largest tangent."""
_STEPS, _RADIUS_STEPS = 12, 4
_LARGEST_STEP = 0.02
_MOST_TANGENTIAL = 0.25
"""Only points whose normals have a smaller tangential part tell the axis by their radii."""
_ALIKE = 0.06
"""Points are alike within this distance in radius, height and, weighted by the next, normal."""
_NORMAL_WEIGHT = 0.15
_ALIKE_NEIGHBOURS = 12
_OUTERMOST = 0.995
"""Share of the body within its radius; the rest is noise."""
_TURNS_RAD, _SMALL_TURNS_RAD = (0.35, 1.6), (0.05, 0.15)
_SAME_NORMAL = 0.8
_LEAST_UPRIGHT_SHARE, _LEAST_SHARE, _LEAST_EVENNESS = 0.4, 0.55, 0.08
_LEAST_BODY, _LEAST_FIT, _LEAST_MET = 0.7, 0.74, 0.55
_LEAST_WIDTH, _LEAST_FLATNESS = 0.15, 0.09
"""P is part of a surface of revolution if enough of its normals meet the axis, these face several
ways, most of P belongs to the body, turned points meet P often enough and then fit it, and it is
neither a thin stick nor flat. Of 537 such parts of 1,122 train objects, 465 turn into surfaces of
which more than nine tenths lie within .02 of the true one, 26 into less than three quarters. Of the
parts that turn into such good ones, 87 % are found."""
_CLEAR_SHARE, _CLEAR_MET, _CLEAR_FIT = 0.85, 0.6, 0.725
"""If so many normals meet the axis, as much of P belongs to the body, and turned points meet P so
often, these may fit less well: so many times as well as after small turns, which tell how noisy P
is. Scans are; oval things such as hats fit after small turns only. The last limit was chosen on 22
parts of train objects and five of validation objects, which lose without it."""
ALONG_AXIS = 0.01
"""The axis lies in a plane at most this far from it, in sizes of the whole. P that seems cut along
such a plane is better mirrored, which keeps its details: 27 cuts through the middle are within .007
and lose otherwise. 16 others, of halves and of arcs that only seem cut, are .013 or farther from
the axis, and P is better turned."""


@dataclass(frozen=True, slots=True)
class Revolution:
    """The surface of revolution that P is part of."""

    axis: Axis
    """In the coordinates and units of the points given."""
    radius: float
    """Of the body."""
    heights: tuple[float, float]
    """Lowest and highest along the axis, of all of P."""

    @property
    def size(self) -> float:
        """Largest side of the body's box, the axis upright."""
        return max(2 * self.radius, self.heights[1] - self.heights[0])

    def distance_of(self, azimuth_rad: float, offset: float) -> float:
        """Return how far the upright plane of that normal and offset passes the axis."""
        return off_plane(self.axis.point, azimuth_rad, offset)


def find_revolution(
    points: Float64Array,  # [N, 3] z up
    axes: Float64Array | None = None,  # [N, 3]
    cut: tuple[float, float] | None = None,
) -> Revolution | None:
    """Return the surface of revolution that P is part of; None = none, or P is better mirrored.

    Args:
        points: centres of P's splats, in any unit.
        axes: of these splats (``neighbourhood.flat_axes``); None = unknown.
        cut: an upright plane that P is symmetric about: the azimuth of its normal in radians, and
            its offset. If the axis lies in it, P is better mirrored. None = there is none.
    """
    placed = in_box_sides(points, axes, _MOST_POINTS)
    if placed is None:
        return None
    chosen, axes, middle, side = placed
    tested = every_nth(chosen, _TESTED)
    tree = cKDTree(chosen)
    normals = normals_at(tested, chosen, tree, axes)
    start = upright_axis(tested, normals)
    if start is None or _share_met(start, tested, normals) < _LEAST_UPRIGHT_SHARE:
        return None
    axis = _by_radii(_by_normals(start, tested, normals), tested, normals)
    share = _share_met(axis, tested, normals)
    if share < _LEAST_SHARE:
        return None
    turning = Turning.about(axis, chosen, normals_at(chosen, chosen, tree, axes))
    body, _ = turning.body()
    if body.mean() < _LEAST_BODY:
        return None
    heights = float(turning.points[:, 2].min()), float(turning.points[:, 2].max())
    radius = float(np.quantile(turning.radius[body], _OUTERMOST))
    if 2 * radius < _LEAST_WIDTH or heights[1] - heights[0] < 2 * _LEAST_FLATNESS * radius:
        return None
    met, fit = _turned_fit(turning, body)
    if met < _LEAST_MET or fit < _LEAST_FIT:
        if met < _CLEAR_MET or min(share, body.mean()) < _CLEAR_SHARE:
            return None
        if fit < _CLEAR_FIT * _turned_fit(turning, body, _SMALL_TURNS_RAD)[1]:
            return None
    found = Axis(axis.point * side + middle, axis.direction, axis.rotation)
    whole = Revolution(found, radius * side, (heights[0] * side, heights[1] * side))
    if cut is not None and whole.distance_of(*cut) <= ALONG_AXIS * whole.size:
        return None
    return whole


def box_of(
    revolution: Revolution,
    points: Float64Array,  # [N, 3]
) -> tuple[Float64Array, float]:  # [3]
    """Return the centre and the largest side of the box of P and the whole body."""
    around = np.linspace(0.0, 2 * math.pi, 48, endpoint=False)
    circle = revolution.radius * np.stack([np.cos(around), np.sin(around)], axis=1)
    ends = [np.column_stack([circle, np.full(len(circle), z)]) for z in revolution.heights]
    whole = np.concatenate([points, *(revolution.axis.from_axis(end) for end in ends)])
    low, high = whole.min(axis=0), whole.max(axis=0)
    return (low + high) / 2, float((high - low).max())


def _turned_fit(
    turning: Turning,
    body: BoolArray,  # [N]
    turns_rad: tuple[float, float] = _TURNS_RAD,
) -> tuple[float, float]:
    """Turn points of the body about the axis, by least and most so far, and compare them with P.

    Returns:
        The share of turned points that have P's surface near, and how many of those fit it.
    """
    random = np.random.default_rng(0)
    index = random.choice(np.flatnonzero(body), _TESTED)
    angle = random.uniform(*turns_rad, _TESTED) * random.choice([-1.0, 1.0], _TESTED)
    points, normals = (turned(v[index], angle) for v in (turning.points, turning.normals))
    tree = cKDTree(turning.points)
    near = lie_on_surface(points, normals, tree, turning.normals, _ALIKE_NEIGHBOURS, _SAME_NORMAL)
    met, fits = near
    return float(met.mean()), float(fits[met].mean()) if met.any() else 0.0


def upright_axis(points: Float64Array, normals: Float64Array) -> Axis | None:  # [N, 3] each
    """Return the upright axis that most normals meet, of those that pairs of them give."""
    steep = np.hypot(normals[:, 0], normals[:, 1])
    weights = np.where(steep > STEEP, steep, 0.0)
    if np.count_nonzero(weights) < _FEWEST_STEEP:
        return None
    across = np.stack([normals[:, 1], -normals[:, 0]], axis=1) / steep.clip(1e-9)[:, None]
    passes = (across * points[:, :2]).sum(axis=1)
    random = np.random.default_rng(0)
    pairs = random.choice(len(points), (_PAIRS, 2), p=weights / weights.sum())
    rows, right = across[pairs], passes[pairs]
    crossing = np.linalg.det(rows)
    clear = np.abs(crossing) > _LEAST_CROSSING
    if not clear.any():
        return None
    places = np.linalg.solve(rows[clear], right[clear, :, None])[:, :, 0]
    places = places[np.abs(places).max(axis=1) <= 1.0]
    best, most = None, 0.0
    for place in places:
        distance = np.abs(passes - across @ place)
        radius = np.hypot(*(points[:, :2] - place).T)
        off = distance / np.maximum(OFF, OFF_SINE * radius)
        score = float((weights * (1.0 - off**2).clip(0.0)).sum())
        if score > most:
            best, most = place, score
    return None if best is None else Axis.through(np.array([*best, 0.0]), np.array([0.0, 0.0, 1.0]))


def _share_met(axis: Axis, points: Float64Array, normals: Float64Array) -> float:
    """Return how many of the normals meet the axis; 0 if these do not face several ways."""
    turning = Turning.about(axis, points, normals)
    weights = np.where(turning.horizontal > STEEP, turning.horizontal, 0.0)
    met = weights * (turning.off_axis() < 1.0)
    if not met.any():
        return 0.0
    facing = turning.normals[:, :2] / turning.horizontal.clip(1e-9)[:, None]
    spread = (facing * met[:, None]).T @ facing / met.sum()
    if np.linalg.eigvalsh(spread)[0] < _LEAST_EVENNESS:
        return 0.0
    return float(met.sum() / weights.sum())


def _by_normals(start: Axis, points: Float64Array, normals: Float64Array) -> Axis:  # [N, 3] each
    """Refine place and tilt so that the normals meet the axis (Gauss-Newton, robust)."""
    x0, y0, tilt_x, tilt_y = *start.point[:2], 0.0, 0.0
    steep = np.hypot(normals[:, 0], normals[:, 1])
    nx, ny, nz = normals.T
    for _ in range(_STEPS):
        x, y, z = points[:, 0] - x0, points[:, 1] - y0, points[:, 2]
        moment = np.stack([y * nz - z * ny, z * nx - x * nz, x * ny - y * nx], axis=1)
        passes = tilt_x * moment[:, 0] + tilt_y * moment[:, 1] + moment[:, 2]
        allowed = np.maximum(OFF, OFF_SINE * np.hypot(x - tilt_x * z, y - tilt_y * z))
        allowed = allowed * steep.clip(1e-9)
        weights = (1.0 - (passes / allowed) ** 2).clip(0.0) / allowed**2
        weights = np.where(steep > STEEP, weights, 0.0)
        slopes = np.stack([tilt_y * nz - ny, nx - tilt_x * nz, moment[:, 0], moment[:, 1]], axis=1)
        tilt = np.array([tilt_x, tilt_y])
        step = _step(slopes, passes, weights, tilt, (1e-6, (OFF / _TILT) ** 2))
        x0, y0, tilt_x, tilt_y = np.array([x0, y0, tilt_x, tilt_y]) + step
        tilt_x, tilt_y = np.clip([tilt_x, tilt_y], -_MOST_TILT, _MOST_TILT)
    return Axis.through(np.array([x0, y0, 0.0]), np.array([tilt_x, tilt_y, 1.0]))


def _by_radii(start: Axis, points: Float64Array, normals: Float64Array) -> Axis:  # [N, 3] each
    """Refine place and tilt so that points alike in height and normal are equally far from it."""
    axis = start
    for _ in range(_RADIUS_STEPS):
        turning = Turning.about(axis, points, normals)
        is_body = (
            (np.abs(turning.tangential) < _MOST_TANGENTIAL)
            & (np.abs(turning.radial) > STEEP)
            & (turning.radius > NEAR_AXIS)
        )
        if np.count_nonzero(is_body) < _FEWEST_STEEP:
            return axis
        sign = np.where(turning.radial[is_body] < 0, -1.0, 1.0)
        facing = sign[:, None] * np.stack(
            [turning.radial[is_body], turning.normals[is_body, 2]], axis=1
        )
        places, radius = turning.points[is_body], turning.radius[is_body]
        outward = places[:, :2] / radius[:, None]
        like = np.column_stack([radius, places[:, 2], _NORMAL_WEIGHT * facing])
        distance, other = cKDTree(like).query(
            like, k=_ALIKE_NEIGHBOURS + 1, distance_upper_bound=_ALIKE
        )
        known = np.isfinite(distance[:, 1:])
        one = np.nonzero(known)[0]
        other = other[:, 1:][known]
        across = facing[one] + facing[other]
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        rise = places[one, 2] - places[other, 2]
        passes = across[:, 0] * (radius[one] - radius[other]) + across[:, 1] * rise
        lever = outward[one] * places[one, 2:] - outward[other] * places[other, 2:]
        slopes = np.column_stack(
            [
                -across[:, :1] * (outward[one] - outward[other]),
                -across[:, :1] * lever + across[:, 1:] * (places[one, :2] - places[other, :2]),
            ]
        )
        weights = (1.0 - (passes / (2 * OFF)) ** 2).clip(0.0) ** 2
        tilt = axis.direction[:2] / axis.direction[2]
        step = _step(slopes, passes, weights, tilt, (1e-3, 0.1 * (OFF / _TILT) ** 2))
        step = step.clip(-_LARGEST_STEP, _LARGEST_STEP)
        place = axis.point + np.array([step[0], step[1], 0.0])
        axis = Axis.through(place, np.array([*(tilt + step[2:]), 1.0]))
    return axis


def _step(
    slopes: Float64Array,  # [M, 4] by x, y and both tilts
    passes: Float64Array,  # [M]
    weights: Float64Array,  # [M]
    tilt: Float64Array,  # [2]
    stiffness: tuple[float, float],
) -> Float64Array:  # [4]
    """Return a Gauss-Newton step; ``stiffness`` keeps the place where it is and tilts at zero."""
    normal = (slopes * weights[:, None]).T @ slopes
    right = -(slopes * weights[:, None]).T @ passes
    keep = max(float(weights.sum()), 1e-12) * np.repeat(stiffness, 2)
    right[2:] -= keep[2:] * tilt
    step: Float64Array = np.linalg.solve(normal + np.diag(keep), right).astype(np.float64)
    return step
