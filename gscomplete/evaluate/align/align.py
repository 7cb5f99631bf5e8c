"""Bring another system's result to P by a similarity.

Conventions
-----------
* The result is a complete object in its own frame, with any rotation, scale and position; P covers
  from about a third to all of its surface. The answer is ``target_from_result``, where "target" is
  the frame that P is given in.
* The search starts from rotations spread evenly over SO(3), from scales at which P's diameter is 60
  to 97 % of the result's, and with P's centroid at the result's or on either side of it along the
  result's principal axes. ICP runs from each start on a few points. The best candidates continue
  with more points, and the last ones with exact nearest points, normals and colours up to a common
  brightness (``refine``). They are then refined again from positions and scales beside theirs,
  until this brings no improvement.
* Every point of P should lie on the result. Only the search also asks the result to lie on P. An
  object that is symmetric in shape and colour is aligned up to its symmetry.
* Random numbers depend on the seed alone; the order of points matters only through their sampling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from gscomplete.errors import UserError
from gscomplete.evaluate.align.nearest_grid import nearest_grid
from gscomplete.evaluate.align.refine import Candidate, Surface, Target, surface_of
from gscomplete.evaluate.align.search import even_rotations, improve
from gscomplete.splats import Splats, usable_rows
from gscomplete.splats.filters import near_rows
from gscomplete.splats.transform import Similarity
from gscomplete.util.arrays import Float64Array

_DENSE, _MIDDLE, _SPARSE = 4000, 500, 64
"""Points of each cloud: for exact nearest points, in the second stage of the search, in the
first."""
_TRIED, _COMPARED = 400, 1000
"""Points of P that are refined again beside a candidate, and that candidates are compared by."""
_LOOKED_AT = 30_000
"""Most points that an even choice is made from; of more, so many are drawn at random first."""
_FEWEST = 50
"""Fewest points of a cloud that can be aligned."""
_SCALES = (0.6, 0.97)
"""Range of starts: P's diameter over the result's."""
_SCALE_RANGE = (0.4, 1.08)
"""Range that ICP may move this ratio in."""
_STARTS = 7
"""Starts for each rotation: as many scales, each at another of seven positions."""
_ASIDE = 0.24
"""Distance of positions from the result's centroid over its extent along that principal axis."""
_SECOND, _THIRD, _FOURTH = 120, 24, 4
"""Candidates that continue to the second, the third and the last stage."""
_APART_DEG, _APART_LOG_SCALE = 8.0, 0.05
"""Candidates that differ by less than both in rotation and log scale count as one."""
_GROWTHS, _SHIFT = (0.92, 1.0, 1.08), 0.1
"""Factors on the scale, and shifts along P's principal axes (in shares of P's longest extent), from
which a candidate is refined again."""
_MOST_ROUNDS, _LEAST_GAIN = 4, 0.03
"""Most rounds of this; another one follows if a round lowers the cost by at least this share."""
_LAST_POINT_SHARE = 0.03
"""Weight of point-to-point residuals in the last steps; a larger one would keep surfaces from
sliding along each other."""
_GREY = 0.5
"""Root mean square that the colours of both clouds are scaled to before the search."""
_SOLID = 0.3
"""Opacity above which a splat counts as surface."""


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """Knobs of an alignment."""

    rotations: int = 1000
    """Rotations tried: 1,000 are 19 degrees apart."""
    covered: float = 0.5
    """Share of the result's surface that P is assumed to cover. Too large a value pulls the result
    towards P; too small a value lets P slide along repeating surfaces."""
    seed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Where the result lies in P's frame, and with which confidence."""

    target_from_result: Similarity
    residual: float
    """Root mean squared distance of P's nearest 90 % to the result, in shares of its diameter."""
    runner_up: float | None
    """Cost of the best other pose over this one's. A value near 1 means that the object is
    symmetric or the alignment is a guess; None = there is no other pose."""

    def warning(self) -> str:
        """Say what is doubtful; empty if nothing is."""
        if self.residual > 0.03:
            return (
                f"the alignment is doubtful: P lies {100 * self.residual:.1f} % of its diameter "
                "from the result (root mean square)"
            )
        return ""


def align_splats(
    result: Splats, partial: Splats, settings: AlignmentSettings | None = None
) -> Alignment:
    """Align splats of a complete object with those of a part of it.

    Args:
        result: splats of the complete object, in a frame of its own.
        partial: P, file frame.
        settings: knobs; None = defaults.

    Returns:
        The similarity from the result's frame to P's, and its confidence.

    Raises:
        UserError: either has too few solid splats.
    """
    clouds = []
    for name, splats in (("result", result), ("partial input", partial)):
        solid = splats.select(usable_rows(splats)[0] & (splats.opacities > _SOLID))
        if len(solid) >= _FEWEST:
            solid = solid.select(near_rows(solid)[0])
        if len(solid) < _FEWEST:
            raise UserError(
                f"alignment: expected at least {_FEWEST} solid splats in the {name}, found "
                f"{len(solid)}"
            )
        clouds.append((solid.means.double().numpy(), solid.base_colors.double().numpy()))
    (points, colors), (target, target_colors) = clouds
    return align_points(points, target, settings, colors=colors, target_colors=target_colors)


def align_points(
    result: Float64Array,  # [n, 3]
    target: Float64Array,  # [m, 3]
    settings: AlignmentSettings | None = None,
    *,
    colors: Float64Array | None = None,  # [n, 3]
    target_colors: Float64Array | None = None,  # [m, 3]
) -> Alignment:
    """Align points on the surface of a complete object with points on a part of it.

    Args:
        result: points of the complete object, in its own frame.
        target: points of the part.
        settings: knobs; None = defaults.
        colors: of ``result``; None = shape alone decides.
        target_colors: of ``target``.

    Returns:
        The similarity from the object's frame to the part's, and its confidence.

    Raises:
        UserError: there are too few points, or they have no extent.
    """
    chosen = settings or AlignmentSettings()
    rng = np.random.default_rng([chosen.seed, 0x616C])
    complete_rows = evenly_spread(result, _DENSE, rng)
    part_rows = evenly_spread(target, _DENSE, rng)
    _, complete_center, complete_size = _normalised(result[complete_rows])
    _, part_center, part_size = _normalised(target[part_rows])
    all_complete = (result - complete_center) / complete_size
    all_part = (target - part_center) / part_size
    candidates = _searched(all_part[part_rows], all_complete[complete_rows], chosen, rng)
    if colors is None or target_colors is None:
        colors = target_colors = None
    rows = rng.permutation(len(result))[:_LOOKED_AT]
    there = surface_of(all_complete[rows], None if colors is None else _evened(colors[rows]))
    rows = np.union1d(rng.permutation(len(target))[:_LOOKED_AT], part_rows)
    here = surface_of(
        all_part[rows], None if target_colors is None else _evened(target_colors[rows])
    )
    part = here.subset(np.searchsorted(rows, part_rows))
    all_points = Target.of(there)
    best, runner_up = _settled(candidates, part, all_points)
    last = all_points.refine(all_points.refine(best, part, 25), part, 25, _LAST_POINT_SHARE)
    distance = np.sort(cKDTree(there.points).query(last.apply(part.points))[0])
    kept = distance[: max(1, int(0.9 * len(distance)))]
    residual = float(np.sqrt((kept**2).mean())) / (last.scale * diameter(part.points))
    # complete = scale R part + t in normalised coordinates, each (x - center) / size
    scale = part_size / (last.scale * complete_size)
    rotation = last.rotation.T
    shift = (
        part_center
        - part_size / last.scale * rotation @ last.translation
        - scale * rotation @ complete_center
    )
    similarity = Similarity(scale, torch.from_numpy(rotation.copy()), torch.from_numpy(shift))
    return Alignment(similarity, residual, runner_up)


def _settled(
    candidates: list[Candidate], part: Surface, target: Target
) -> tuple[Candidate, float | None]:
    """Return the best candidate, and the cost of the next best over its own; None = only one.

    Args:
        candidates: of the search.
        part: evenly spread points in random order.
        target: the complete cloud.
    """
    tried, compared = (part.subset(np.arange(n)) for n in (_TRIED, _COMPARED))
    found = [target.refine(candidate, compared, 15) for candidate in candidates]
    found = _distinct(sorted(found, key=_cost))[:_FOURTH]
    found = [target.refine(_tried_beside(one, tried, target), compared, 8) for one in found]
    found = _distinct(sorted(found, key=_cost))
    others = [candidate.cost for candidate in found[1:]]
    return found[0], min(others) / max(found[0].cost, 1e-30) if others else None


def _tried_beside(start: Candidate, part: Surface, target: Target) -> Candidate:
    """Refine from scales and positions beside a candidate; repeat from the best while it helps."""
    middle = part.points.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov(part.points.T))
    shift = _SHIFT * np.ptp(part.points @ axes, axis=0).max() * axes.T
    offsets = np.concatenate([np.zeros((1, 3)), shift, -shift])
    best = target.refine(start, part, 6)
    for _ in range(_MOST_ROUNDS):
        beside = [best.beside(middle, offset, growth) for growth in _GROWTHS for offset in offsets]
        found = min((target.refine(one, part, 6) for one in beside), key=_cost)
        if found.cost > (1 - _LEAST_GAIN) * best.cost:
            break
        best = found
    return best


def _cost(candidate: Candidate) -> float:
    return candidate.cost


def _evened(colors: Float64Array) -> Float64Array:  # [n, 3]
    """Scale colours to a common brightness; black stays black."""
    return colors * (_GREY / max(float(np.sqrt((colors**2).mean())), 1e-6))


def evenly_spread(
    points: Float64Array,  # [n, 3]
    count: int,
    rng: np.random.Generator,
    looked_at: int = _LOOKED_AT,
) -> np.ndarray:  # [<= count] rows
    """Choose rows so that the points chosen are about equally far apart, in random order.

    Args:
        points: to choose from.
        count: most rows.
        rng: draws the order.
        looked_at: of more points than this, so many are drawn at random first.

    Raises:
        UserError: there are too few points, or they have no extent.
    """
    if len(points) < _FEWEST or not np.isfinite(points).all():
        raise UserError(
            f"alignment: expected at least {_FEWEST} finite points, found {len(points)}"
        )
    rows = rng.permutation(len(points))[:looked_at]
    offsets = points[rows] - points[rows].min(axis=0)
    side = float(offsets.max())
    if not side > 0:
        raise UserError("alignment: expected points with an extent, found them in one place")
    low, high = side / 2000, side
    for _ in range(18):
        middle = float(np.sqrt(low * high))
        if len(np.unique(_cell_keys(offsets, middle))) > count:
            low = middle
        else:
            high = middle
    _, first = np.unique(_cell_keys(offsets, low), return_index=True)
    return rows[rng.permutation(first)[:count]]


def diameter(points: Float64Array) -> float:  # [n, 3]
    """Return about the largest distance between two points, by three hops to the farthest point."""
    at, largest = points.mean(axis=0), 0.0
    for _ in range(4):
        distance = np.linalg.norm(points - at, axis=1)
        at, largest = points[int(distance.argmax())], max(largest, float(distance.max()))
    return largest


def _cell_keys(offsets: Float64Array, side: float) -> np.ndarray:
    cells = np.floor(offsets / side).astype(np.int64)
    return np.asarray(cells @ np.array([1, 1 << 20, 1 << 40]))


def _normalised(points: Float64Array) -> tuple[Float64Array, Float64Array, float]:
    """Move the middle of the box to the origin, and make its largest side 1."""
    low, high = points.min(axis=0), points.max(axis=0)
    center, size = (low + high) / 2, float((high - low).max())
    return (points - center) / size, center, size


def _searched(
    part: Float64Array,
    complete: Float64Array,
    settings: AlignmentSettings,
    rng: np.random.Generator,
) -> list[Candidate]:
    """Return the best candidates of the first two stages."""
    ratio = diameter(complete) / diameter(part)
    reach = (_SCALE_RANGE[0] * ratio, _SCALE_RANGE[1] * ratio)
    grids = nearest_grid(part), nearest_grid(complete)
    few = [cloud[evenly_spread(cloud, _SPARSE, rng)] for cloud in (part, complete)]
    more = [cloud[evenly_spread(cloud, _MIDDLE, rng)] for cloud in (part, complete)]
    rotations = np.repeat(even_rotations(settings.rotations), _STARTS, axis=0)
    number = np.arange(len(rotations))
    scales = ratio * np.linspace(_SCALES[0], _SCALES[1], _STARTS)[number % _STARTS]
    _, axes = np.linalg.eigh(np.cov(complete.T))
    beside = _ASIDE * np.ptp(complete @ axes, axis=0)[:, None] * axes.T
    places = few[1].mean(axis=0) + np.concatenate([np.zeros((1, 3)), beside, -beside])
    shifts = places[number * 5 % len(places)] - scales[:, None] * (rotations @ few[0].mean(axis=0))
    costs = improve(
        few[0], few[1], grids[0], grids[1], rotations, scales, shifts,
        covered=settings.covered, iterations=8, scale_range=reach,
    )  # fmt: skip
    chosen = np.argsort(costs)[:_SECOND]
    rotations, scales, shifts = (x[chosen].copy() for x in (rotations, scales, shifts))
    costs = improve(
        more[0], more[1], grids[0], grids[1], rotations, scales, shifts,
        covered=settings.covered, iterations=12, scale_range=reach,
    )  # fmt: skip
    found = [
        Candidate(float(scales[k]), rotations[k], shifts[k], float(costs[k]))
        for k in np.argsort(costs)
        if np.isfinite(costs[k])
    ]
    if not found:
        raise UserError("alignment: expected surfaces that can meet, found points without extent")
    return _distinct(found)[:_THIRD]


def _distinct(candidates: list[Candidate]) -> list[Candidate]:
    """Drop candidates that are nearly the same as a better one."""
    kept: list[Candidate] = []
    for one in candidates:
        if all(_are_apart(one, other) for other in kept):
            kept.append(one)
    return kept


def _are_apart(a: Candidate, b: Candidate) -> bool:
    cosine = (np.trace(a.rotation.T @ b.rotation) - 1) / 2
    turned = np.degrees(np.arccos(np.clip(cosine, -1, 1))) > _APART_DEG
    return bool(turned or abs(np.log(a.scale / b.scale)) > _APART_LOG_SCALE)
