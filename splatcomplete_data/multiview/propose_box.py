"""Propose a box around what the cameras look at.

Conventions
-----------
* Splats count by the area they cover times their opacity, so that a smooth wall of few large
  splats weighs as much as a detailed one of many small ones.
* There are three steps. Only a ball about what the cameras look at is considered. Planes that the
  object stands on or hangs at (table, bed, wall) are found by RANSAC and removed with everything
  behind them. Of the rest the heaviest cluster is taken; the nearer to their centre the photos show
  a splat, the more it counts. The box stands on the plane, turned to fit, and holds nearly all of
  the cluster.
* It is a proposal: ``crop`` draws it, and people correct it.
* Random numbers come from the seed alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gscomplete.errors import UserError
from gscomplete.splats import Splats, usable_rows
from gscomplete.util.arrays import BoolArray, Float64Array
from gscomplete.views import Cameras
from splatcomplete_data.cuts.boxes import CropBox

_LEVEL_DEG = 12.0
"""Tables and beds are level to this angle, as far as the up direction is known."""
_FEWEST = 20
"""Fewer splats are nothing to enclose."""
_CLIP_QUANTILE = 0.95
"""Splats with a larger area count as if their area were that at this quantile."""
_MIN_OPACITY = 0.2
"""Fainter splats do not count."""
_BALL = 1.3
"""Radius within which the cluster is looked for."""
_PLANE_BALL = 1.4
"""Radius within which planes are looked for."""
_PLANE_SAMPLES = 1500
"""RANSAC's tries for every plane."""
_PLANE_SLACK = 0.03
"""Half thickness of a plane."""
_PLANE_REACH = 0.06
"""A plane's upper side is looked for up to this height, because walls have reliefs and beds have
wrinkles."""
_PLANE_SHARE = 0.12
"""Least share of the weight in a plane."""
_LEVEL_SHARE = 0.07
"""The same for a level plane."""
_FRONT_SHARE = 0.6
"""Least share of the other weight that lies in front of a plane that bears the object."""
_BEYOND_SHARE, _BEYOND_QUANTILE = 0.25, 0.02
"""A plane that is not level bears the object only if this share of it is beside what is before it,
without so many of those places at either end."""
_CELL_SHARE = 0.02
"""Cells lighter than this share of the 99th percentile of cells are empty."""
_QUANTILE = 0.004
"""Share of the cluster left out at either end of every axis."""
_MARGIN = 0.03
"""Added to the half extents."""
_CELLS = 40
"""Cells of the clustering grid along the ball's diameter."""
_SEED = 0
"""Of RANSAC."""


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """The upper side of what the object stands on or hangs at."""

    normal: Float64Array  # [3] unit, towards the object
    top: float  # normal . x on the upper side

    def before(self, points: Float64Array) -> BoolArray:  # [N, 3] -> [N]
        """Mark the points on the object's side."""
        mask: BoolArray = points @ self.normal > self.top
        return mask


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A box, and how it was found."""

    box: CropBox
    planes: tuple[Plane, ...]  # in the file's frame
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Focus:
    """Where to look: a ball in the file's frame, and the cameras that look there."""

    center: Float64Array  # [3]
    radius: float
    up: Float64Array  # [3]; the box stands along it when there is no plane
    cameras: tuple[Cameras, ...] = ()  # none: not known

    def attention(self, points: Float64Array) -> Float64Array:  # [N, 3] -> [N]
        """Return how near to their centre the photos show points, 0 to 1; 1 without cameras."""
        if not self.cameras:
            return np.ones(len(points))
        total = np.zeros(len(points))
        for camera in self.cameras:
            pose = camera.camera_from_world[0].double().numpy()
            local = points @ pose[:3, :3].T + pose[:3, 3]
            pixel = local[:, :2] / np.maximum(local[:, 2:], 1e-9)
            pixel = pixel * camera.focal_px[0].double().numpy()
            pixel += camera.center_px[0].double().numpy() - (camera.width / 2, camera.height / 2)
            far = np.square(pixel / (0.35 * min(camera.width, camera.height))).sum(axis=1)
            total += np.where(local[:, 2] > 0, np.exp(-np.minimum(far, 50.0)), 0.0)
        return total / len(self.cameras)

    def toward_cameras(self) -> Float64Array | None:  # [3]
        """Return the mean direction to the cameras; None without any."""
        if not self.cameras:
            return None
        positions = np.stack([camera.positions[0].double().numpy() for camera in self.cameras])
        away = positions - self.center
        mean: Float64Array = (away / np.linalg.norm(away, axis=1, keepdims=True)).mean(axis=0)
        return mean


def focus_of_cameras(
    cameras: tuple[Cameras, ...],
    look_at: Float64Array,  # [3]
    up: Float64Array,  # [3]
) -> Focus:
    """Return the ball that a photo frames at the cameras' median distance."""
    positions = np.stack([camera.positions[0].double().numpy() for camera in cameras])
    distance = float(np.median(np.linalg.norm(positions - look_at, axis=1)))
    tangents = [0.5 * min(c.width, c.height) / float(c.focal_px[0].min()) for c in cameras]
    return Focus(look_at, max(0.9 * distance * float(np.median(tangents)), 1e-9), up, cameras)


def focus_of_splats(splats: Splats, up: Float64Array) -> Focus:
    """Return the ball about the densest place, when no cameras are known."""
    points, weight = _solid(splats, _MIN_OPACITY)
    center = _weighted_median(points, weight)
    for _ in range(10):  # mean shift: the ball holds half of the points
        distance = np.linalg.norm(points - center, axis=1)
        near = distance <= np.quantile(distance, 0.5)
        center = np.average(points[near], axis=0, weights=weight[near])
    distance = np.linalg.norm(points - center, axis=1)
    return Focus(center, max(float(np.quantile(distance, 0.6)), 1e-9), up)


def propose_box(splats: Splats, focus: Focus) -> Proposal:
    """Propose a box around the central cluster.

    Raises:
        UserError: there is nothing to be seen where the cameras look; callers name file and option.
    """
    points, weight = _solid(splats, _MIN_OPACITY)
    near = np.linalg.norm(points - focus.center, axis=1) <= 2.5 * focus.radius
    if near.sum() < _FEWEST:
        raise UserError(
            "expected splats where the cameras look, found none within "
            f"{focus.radius:.4g} of {focus.center.round(4).tolist()}"
        )
    local = (points[near] - focus.center) / focus.radius
    ball = np.linalg.norm(local, axis=1) <= _PLANE_BALL
    planes = _supporting_planes(local[ball], weight[near][ball], focus)
    weight = weight[near] * focus.attention(points[near])
    free = np.all([plane.before(local) for plane in planes], axis=0) if planes else weight >= 0
    middle = np.zeros(3)
    for _ in range(3):  # the object may lie well in front of a plane behind it
        inside = free & (np.linalg.norm(local - middle, axis=1) <= _BALL)
        if inside.sum() < _FEWEST:
            raise UserError("expected an object beside planes, found none")
        if planes:
            middle = np.average(local[inside], axis=0, weights=weight[inside])
    cluster = _central_cluster(local[inside] - middle, weight[inside])
    members = local[inside][cluster]
    axis = planes[0].normal if planes else focus.up / np.linalg.norm(focus.up)
    box = _fit(members, axis, planes)
    center = focus.center + focus.radius * np.array(box.center)
    half = focus.radius * np.array(box.half_extents)
    notes = [
        f"plane {index + 1} removed, normal {(plane.normal.round(2) + 0.0).tolist()}"
        for index, plane in enumerate(planes)
    ]
    notes.append(f"the central cluster has {len(members):,} of {len(splats):,} splats")
    in_file = [
        Plane(p.normal, float(p.normal @ focus.center + focus.radius * p.top)) for p in planes
    ]
    result = CropBox(_three(center), _three(half), box.quaternion)
    return Proposal(result, tuple(in_file), tuple(notes))


def _three(values: Float64Array) -> tuple[float, float, float]:
    """Return three rounded numbers, so that text and JSON give the same box."""
    x, y, z = (float(f"{value:.6g}") for value in values)
    return x, y, z


def shown_area(splats: Splats) -> Float64Array:  # [N]
    """Return how much splats show: area times opacity, the largest areas clipped."""
    sizes = np.sort(splats.scales.double().numpy(), axis=1)
    area = sizes[:, 1] * sizes[:, 2]
    clipped = np.minimum(area, np.quantile(area, _CLIP_QUANTILE))
    return clipped * splats.opacities.double().numpy()


def _solid(splats: Splats, min_opacity: float) -> tuple[Float64Array, Float64Array]:
    """Return points [N, 3] and weights [N] of the splats that count."""
    usable, _ = usable_rows(splats)
    chosen = splats.select(usable & (splats.opacities >= min_opacity))
    if len(chosen) < _FEWEST:
        raise UserError(f"expected splats to enclose, found {len(chosen)} solid ones")
    return chosen.means.double().numpy(), shown_area(chosen)


def _weighted_median(points: Float64Array, weight: Float64Array) -> Float64Array:  # [3]
    """Return the median along every axis."""
    result = np.empty(3)
    for axis in range(3):
        order = np.argsort(points[:, axis])
        total = np.cumsum(weight[order])
        result[axis] = points[order[np.searchsorted(total, 0.5 * total[-1])], axis]
    return result


def _supporting_planes(local: Float64Array, weight: Float64Array, focus: Focus) -> list[Plane]:
    """Find planes that bear the object: first a level one, for things stand on something."""
    planes: list[Plane] = []
    rng = np.random.default_rng(_SEED)
    free = np.ones(len(local), np.bool_)
    total = float(weight.sum())
    for upright in (focus.up / np.linalg.norm(focus.up), None):
        if free.sum() < _FEWEST:
            break
        found = _heaviest_plane(local[free], weight[free], upright, rng)
        if found is None:
            continue
        normal, offset, held = found
        height = local @ normal - offset
        before = float(weight[height > _PLANE_SLACK].sum())
        behind = float(weight[height < -_PLANE_SLACK].sum())
        if held < (_PLANE_SHARE if upright is None else _LEVEL_SHARE) * total:
            continue
        if upright is None and _is_turned(normal, before, behind, focus):
            normal, offset, height, before, behind = -normal, -offset, -height, behind, before
        if before < _FRONT_SHARE * (before + behind) or before <= 0:
            continue
        if upright is None and not _reaches_beyond(local, weight, normal, height):
            continue
        layer = free & (height > -_PLANE_SLACK)
        plane = Plane(normal, offset + _upper_side(height[layer], weight[layer]))
        planes.append(plane)
        free &= plane.before(local)
    return planes


def _is_turned(normal: Float64Array, before: float, behind: float, focus: Focus) -> bool:
    """Whether a plane's normal points away from the cameras, or from most of the weight."""
    toward = focus.toward_cameras()
    return before < behind if toward is None else float(normal @ toward) < 0


def _reaches_beyond(
    local: Float64Array,  # [N, 3]
    weight: Float64Array,  # [N]
    normal: Float64Array,  # [3]
    height: Float64Array,  # [N] over the plane
) -> bool:
    """Tell a wall from a flat side of the object: a wall goes on beside what stands before it."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    places = local @ np.stack([across, np.cross(normal, across)], axis=1)
    ends = np.quantile(
        places[height > _PLANE_SLACK], (_BEYOND_QUANTILE, 1 - _BEYOND_QUANTILE), axis=0
    )
    held = np.abs(height) <= _PLANE_SLACK
    beyond = ((places < ends[0]) | (places > ends[1])).any(axis=1)
    return float(weight[held & beyond].sum()) > _BEYOND_SHARE * float(weight[held].sum())


def _upper_side(height: Float64Array, weight: Float64Array) -> float:
    """Return the height at which the weight above a plane falls to a fifth of its own."""
    step = _PLANE_SLACK / 2
    edges = np.arange(0.0, _PLANE_REACH + step, step)
    layers, _ = np.histogram(height, edges, weights=weight)
    peak = 0.5 * float(weight[np.abs(height) <= step].sum())
    thin = np.flatnonzero(layers[1:] < 0.2 * peak) + 1
    top = float(edges[thin[0]]) if len(thin) else _PLANE_REACH
    return max(top, _PLANE_SLACK)


def _heaviest_plane(
    points: Float64Array,
    weight: Float64Array,
    upright: Float64Array | None,  # [3]
    rng: np.random.Generator,
) -> tuple[Float64Array, float, float] | None:
    """Return normal, offset and weight of the plane that holds most, None without any.

    With ``upright`` only planes that are nearly level count, their normals upwards.
    """
    chance = weight / weight.sum()
    picks = points[rng.choice(len(points), (_PLANE_SAMPLES, 3), p=chance)]
    normals = np.cross(picks[:, 1] - picks[:, 0], picks[:, 2] - picks[:, 0])
    length = np.linalg.norm(normals, axis=1)
    usable = length > 1e-3
    normals = normals / np.maximum(length, 1e-12)[:, None]
    if upright is not None:
        normals *= np.where(normals @ upright < 0, -1.0, 1.0)[:, None]
        usable &= normals @ upright > math.cos(math.radians(_LEVEL_DEG))
    if not usable.any():
        return None
    normals, picks = normals[usable], picks[usable]
    offsets = (normals * picks[:, 0]).sum(axis=1)
    sample = rng.choice(len(points), min(len(points), 4000), p=chance)
    close = np.abs(points[sample] @ normals.T - offsets) <= _PLANE_SLACK
    best = int(close.sum(axis=0).argmax())
    normal, offset = normals[best], float(offsets[best])
    for _ in range(3):  # refine by least squares over what the plane holds
        held = np.abs(points @ normal - offset) <= _PLANE_SLACK
        middle = np.average(points[held], axis=0, weights=weight[held])
        spread = (points[held] - middle) * np.sqrt(weight[held])[:, None]
        refined = np.linalg.svd(spread, full_matrices=False)[2][2]
        normal = refined if refined @ normal > 0 else -refined
        offset = float(normal @ middle)
    held = np.abs(points @ normal - offset) <= _PLANE_SLACK
    return normal, offset, float(weight[held].sum())


def _central_cluster(local: Float64Array, weight: Float64Array) -> BoolArray:
    """Mark the connected cells that weigh most, the nearer to the centre the more."""
    cells = _CELLS
    index = np.clip(((local / _BALL + 1) * (0.5 * cells)).astype(np.int64), 0, cells - 1)
    grid = np.zeros((cells, cells, cells))
    np.add.at(grid, tuple(index.T), weight)
    full = grid >= _CELL_SHARE * np.quantile(grid[grid > 0], 0.99)
    labels, count = ndimage.label(full, structure=np.ones((3, 3, 3)))
    own = labels[tuple(index.T)]
    pull = weight * np.exp(-4.0 * np.square(local).sum(axis=1))
    score = np.bincount(own, pull, minlength=count + 1)
    score[0] = 0.0
    mask: BoolArray = own == int(score.argmax())
    return mask


def _fit(
    members: Float64Array,
    axis: Float64Array,
    planes: list[Plane],
) -> CropBox:
    """Fit a box along ``axis``, turned about it to the smallest base, down to the plane."""
    helper = np.eye(3)[int(np.abs(axis).argmin())]
    first = helper - (helper @ axis) * axis
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    low_q, high_q = _QUANTILE, 1.0 - _QUANTILE
    best: tuple[float, Float64Array] | None = None
    for angle in np.deg2rad(np.arange(0.0, 90.0, 3.0)):
        u = np.cos(angle) * first + np.sin(angle) * second
        turn = np.stack([u, np.cross(axis, u), axis], axis=1)
        low, high = np.quantile(members @ turn, [low_q, high_q], axis=0)
        area = float(np.prod(high[:2] - low[:2]))
        if best is None or area < best[0] - 1e-9:
            best = area, turn
    assert best is not None
    turn = best[1]
    low, high = np.quantile(members @ turn, [low_q, high_q], axis=0)
    low, high = low - _MARGIN, high + _MARGIN
    if planes:
        low[2] = planes[0].top
        high[2] = max(high[2], low[2] + _MARGIN)
    half = np.maximum((high - low) / 2, 1e-6)
    center = turn @ ((low + high) / 2)
    w, x, y, z = _quaternion(turn)
    return CropBox(tuple(center), tuple(half), (w, x, y, z))


def _quaternion(rotation: Float64Array) -> tuple[float, float, float, float]:
    """Return the rounded unit quaternion wxyz of a rotation matrix."""
    import torch

    from gscomplete.splats.transform import quaternion_from_rotation

    w, x, y, z = quaternion_from_rotation(torch.from_numpy(rotation.copy())).tolist()
    return round(w, 9), round(x, 9), round(y, 9), round(z, 9)
