"""Bring another system's result to P by a similarity.

Conventions
-----------
* The result is a complete object in a frame of its own, of any rotation, scale and place; P shows
  from about a third to all of its surface. Found is ``target_from_result``, in which "target" is
  the frame that P is given in.
* Search: rotations evenly over SO(3), scales between P's diameter being 60 and 97 % of the
  result's, P's centroid at the result's or on either side of it along its principal axes; ICP from
  each on a few points. The best go on with more points, the last ones on exact surfaces
  (``refine``), where the share of the result that P shows is counted instead of taken as given.
* Geometry alone decides, except between candidates that are as good as the best: then it is the one
  whose colours agree, up to a common brightness. What is symmetric in shape and colour is found up
  to its symmetry.
* Random numbers depend on the seed alone; the order of points matters no more than their sampling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from gscomplete.errors import UserError
from gscomplete.evaluate.align.nearest_grid import FloatArray, nearest_grid
from gscomplete.evaluate.align.refine import Candidate, Surface, refine, surface_of
from gscomplete.evaluate.align.search import even_rotations, improve
from gscomplete.splats import Splats, usable_rows
from gscomplete.splats.filters import near_rows
from gscomplete.splats.transform import Similarity

_DENSE, _MIDDLE, _SPARSE = 4000, 500, 64
"""Points of either cloud in the last, the second and the first stage."""
_LOOKED_AT = 30_000
"""Points that an even choice is made from, themselves chosen at random where there are more."""
_FEWEST = 50
"""Points that an alignment needs."""
_SCALES = (0.6, 0.97)
"""P's diameter over the result's, at the ends of the search; ICP goes beyond both."""
_SCALE_RANGE = (0.4, 1.08)
_STARTS = 7
"""Candidates for a rotation: scales, each at another of seven places."""
_ASIDE = 0.24
"""Places beside the result's centroid, in shares of its extent along a principal axis."""
_SECOND, _THIRD = 120, 8
"""Candidates that go on to the second and the third stage."""
_APART_DEG, _APART_LOG_SCALE = 8.0, 0.05
"""Candidates nearer than this in both are one."""
_AS_GOOD = 1.7
"""Cost over the best one's up to which colours decide: samplings of the same surface differ so."""
_SOLID = 0.3
"""Opacity above which a splat counts as surface."""


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """Knobs of an alignment."""

    rotations: int = 1000
    """Rotations tried: 1,000 are 19 degrees apart."""
    covered: float = 0.5
    """Share of the result's surface that P is taken to show. Too large pulls the result towards P;
    too small lets P slide along surfaces that repeat."""
    seed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Where the result lies in P's frame, and with which confidence."""

    target_from_result: Similarity
    residual: float
    """Root mean squared distance of P's nearest 90 % to the result, in shares of its diameter."""
    runner_up: float | None
    """Cost of the best other pose over this one's; near 1 = symmetric, or a guess. None = none."""

    def warning(self) -> str:
        """Say what is doubtful; empty if nothing is."""
        if self.residual > 0.03:
            return (
                f"alignment is doubtful: P lies {100 * self.residual:.1f} % of its diameter from "
                "the result, in the root mean square"
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
    result: FloatArray,  # [n, 3]
    target: FloatArray,  # [m, 3]
    settings: AlignmentSettings | None = None,
    *,
    colors: FloatArray | None = None,  # [n, 3]
    target_colors: FloatArray | None = None,  # [m, 3]
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
    complete, complete_center, complete_size = _normalised(result[complete_rows])
    part, part_center, part_size = _normalised(target[part_rows])
    candidates = _searched(part, complete, chosen, rng)
    surfaces = surface_of(part), surface_of(complete)
    some = [s.subset(rng.permutation(len(s.points))[:1400]) for s in surfaces]
    found = [refine(c, some[0], some[1], chosen.covered, 8) for c in candidates]
    found.sort(key=lambda candidate: candidate.cost)
    found = _distinct(found)
    best = found[0]
    if colors is not None and target_colors is not None:
        best = min(
            (c for c in found if c.cost <= _AS_GOOD * found[0].cost),
            key=lambda c: _color_error(
                c, surfaces, colors[complete_rows], target_colors[part_rows]
            ),
        )
    others = [candidate.cost for candidate in found if candidate is not best]
    runner_up = min(others) / max(best.cost, 1e-30) if others else None
    last = refine(best, *surfaces, chosen.covered, 8)
    last = refine(last, *surfaces, covered_share(last, *surfaces), 8)
    distance = np.sort(surfaces[1].tree.query(last.apply(part))[0])
    kept = distance[: max(1, int(0.9 * len(distance)))]
    residual = float(np.sqrt((kept**2).mean())) / (last.scale * diameter(part))
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


def covered_share(at: Candidate, part: Surface, complete: Surface) -> float:
    """Return the share of the complete cloud's points that P covers, a tenth less for safety.

    Covered is what lies within three typical distances of P's points to the complete cloud.
    """
    there, _ = complete.tree.query(at.apply(part.points))
    back, _ = part.tree.query(at.undo(complete.points))
    near = float((at.scale * back < 3.0 * np.median(there) + 1e-9).mean())
    return float(np.clip(0.9 * near, 0.1, 1.0))


def evenly_spread(
    points: FloatArray,  # [n, 3]
    count: int,
    rng: np.random.Generator,
) -> np.ndarray:  # [<= count] rows
    """Choose rows so that the points chosen are about equally far apart, in random order.

    Raises:
        UserError: there are too few points, or they have no extent.
    """
    if len(points) < _FEWEST or not np.isfinite(points).all():
        raise UserError(
            f"alignment: expected at least {_FEWEST} finite points, found {len(points)}"
        )
    rows = rng.permutation(len(points))[:_LOOKED_AT]
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


def diameter(points: FloatArray) -> float:  # [n, 3]
    """Return nearly the largest distance between two points: from one to its farthest, thrice."""
    at, largest = points.mean(axis=0), 0.0
    for _ in range(4):
        distance = np.linalg.norm(points - at, axis=1)
        at, largest = points[int(distance.argmax())], max(largest, float(distance.max()))
    return largest


def _cell_keys(offsets: FloatArray, side: float) -> np.ndarray:
    cells = np.floor(offsets / side).astype(np.int64)
    return np.asarray(cells @ np.array([1, 1 << 20, 1 << 40]))


def _normalised(points: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Move the middle of the box to the origin, and make its largest side 1."""
    low, high = points.min(axis=0), points.max(axis=0)
    center, size = (low + high) / 2, float((high - low).max())
    return (points - center) / size, center, size


def _searched(
    part: FloatArray, complete: FloatArray, settings: AlignmentSettings, rng: np.random.Generator
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


def _color_error(
    at: Candidate,
    surfaces: tuple[Surface, Surface],
    colors: FloatArray,  # [n, 3] of the complete cloud's points
    target_colors: FloatArray,  # [m, 3] of the part's
) -> float:
    """Return how far the colours of nearest points differ, up to a common brightness."""
    part, complete = surfaces
    _, row = cKDTree(complete.points).query(at.apply(part.points))
    theirs = colors[row]
    gain = float((theirs * target_colors).sum() / max(float((theirs**2).sum()), 1e-12))
    return float(((gain * theirs - target_colors) ** 2).mean())
