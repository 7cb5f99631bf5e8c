"""Clean scans: planes, outliers and clutter, each as a mask with counts and a switch.

Conventions
-----------
* Lengths are multiples of the cloud's spacing (median distance to the nearest neighbour) unless
  their name ends in ``_file``: the same settings fit metres and millimetres.
* Planes are looked for in the complete scene (``support``); all other steps see only the points
  that boxes keep. The points below a plane are removed with it, unless they are the larger part.
* A step returns a mask of what it keeps; ``clean`` runs the steps in order and records for every
  point which step removed it. Nothing is changed in place.
* Outliers are points whose mean distance to k neighbours exceeds mean + ratio x standard deviation
  over the cloud, and also exceeds what is normal at a corner of the object.
* Neighbours are objects most of which lie outside the boxes (``segments``). They are removed only
  if there are boxes, and a plane that the objects stand on.
* Clutter is all but the largest, or the largest few, connected clusters (``clusters``). With a seed
  point it is all but the object at that point (``segments``), even where the object touches others.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gscomplete.errors import UserError
from gscomplete.util.arrays import BoolArray, Float64Array
from splatcomplete_data.objects import StepRecord
from splatcomplete_data.points import median_spacing
from splatcomplete_data.scan.cloud import PointCloud
from splatcomplete_data.scan.clusters import cluster
from splatcomplete_data.scan.segments import beyond_boxes, object_at
from splatcomplete_data.scan.support import PlaneSettings, SupportPlane, find_support_planes

Points = Float64Array

_SEED_REACH = 0.1
"""A seed point farther than this from every point is a mistake, in diagonals of the points' box."""
DOUBTFUL_SHARE = 0.5
"""Users are warned if cleaning keeps a smaller share of the points than this."""

_VICINITY = 0.5
"""Neighbours are looked for within this distance of the points in the boxes, in diagonals of their
common box."""
_OUTLIER_NEIGHBOURS = 16
"""How many neighbours the mean distance is taken over."""
_CORNER = 2.0
"""A point is no outlier if its mean distance is at most this many times the median one: at the
corner of a surface only a quarter of the surroundings has points, so neighbours are twice as
far."""


@dataclass(frozen=True, slots=True)
class CleanSettings:
    """Which steps run, and their knobs."""

    planes: int = 1
    """Most planes (floor, walls, table) to remove; 0 = none."""
    plane: PlaneSettings = field(default_factory=PlaneSettings)
    """How planes are found."""
    outlier_ratio: float | None = 2.5
    """Standard deviations above the mean from which a point is an outlier; None = keep all."""
    clusters: int = 1
    """Clusters to keep, largest first; 0 = do not cluster."""
    cluster_radius: float = 5.0
    """Points no farther apart than this are of one cluster, in spacings."""
    seed_point: tuple[float, float, float] | None = None
    """Keep the object that this point lies on instead of the largest clusters, file frame."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What is known about the scene besides the points to be cleaned, file frame."""

    viewpoint: tuple[float, float, float] | None = None
    """Position of the scanner; None = unknown."""
    up: tuple[float, float, float] | None = None
    """Direction that is up; None = unknown."""
    scene: Float64Array | None = None  # [M, 3]
    """All points scanned, if those to be cleaned are a selection of them; None = they are not."""
    is_picture_up: bool = False
    """Whether ``up`` is only the up direction of a picture, whose camera may look down."""


@dataclass(frozen=True, slots=True, eq=False)
class Cleaned:
    """Which points cleaning keeps, and why the others were removed."""

    keep: BoolArray  # [N]
    reason: NDArray[np.int8]  # [N] index into ``reasons`` of removed points, -1 for kept ones
    reasons: tuple[str, ...]
    steps: tuple[StepRecord, ...]
    planes: tuple[SupportPlane, ...] = ()
    warnings: tuple[str, ...] = ()
    """What makes the result doubtful, with numbers."""


def clean(
    cloud: PointCloud,
    settings: CleanSettings | None = None,
    *,
    wanted: BoolArray | None = None,  # [M]
    around: Surroundings | None = None,
) -> Cleaned:
    """Run the steps in order: planes, outliers, clusters.

    Args:
        cloud: the complete scene, M finite points.
        settings: which steps, and knobs; None = defaults.
        wanted: mask of the N points that boxes keep; None = all.
        around: viewpoint and up direction, as far as they are known.

    Returns:
        Masks over the N points in the boxes, with steps and counts.

    Raises:
        UserError: a step keeps no point, or the seed point is far from all points.
    """
    chosen, known = settings or CleanSettings(), around or Surroundings()
    up = None if known.up is None else np.asarray(known.up, np.float64)
    eye = None if known.viewpoint is None else np.asarray(known.viewpoint, np.float64)
    inside = np.ones(len(cloud), np.bool_) if wanted is None else wanted
    spacing = median_spacing(cloud.points, 20_000)
    planes, refused = find_support_planes(
        cloud.points, inside, chosen.planes, spacing, chosen.plane, up=up, viewpoint=eye
    )
    points, colors = cloud.points[inside], cloud.colors[inside]
    log = _Log(len(points))
    for plane in planes:
        heights = plane.heights(points[log.keep])
        log.apply("planes", ~plane.inside[inside][log.keep], _plane_note(plane))
        rest = heights[log.last_kept]
        is_over = rest > 0
        if 0 < (~is_over).sum() <= (1.0 - DOUBTFUL_SHARE) * len(rest):
            log.apply("below_planes", is_over, "points on the other side of the plane")
    if planes and not inside.all():
        other = _neighbours(cloud, inside, planes, spacing, eye, up)
        log.apply(
            "neighbours", ~other[log.keep], "parts of objects that lie mostly outside the boxes"
        )
    if chosen.outlier_ratio is not None:
        kept = not_outliers(points[log.keep], _OUTLIER_NEIGHBOURS, chosen.outlier_ratio)
        log.apply("outliers", kept, f"farther than {chosen.outlier_ratio:g} standard deviations")
    if chosen.seed_point is not None:
        seed = np.asarray(chosen.seed_point, np.float64)
        _require_near(seed, points[log.keep])
        kept = object_at(points[log.keep], colors[log.keep], seed, spacing, viewpoint=eye, up=up)
        log.apply("clutter", kept, "kept the object at the seed point")
    elif chosen.clusters > 0:
        labels = cluster(points[log.keep], chosen.cluster_radius * spacing)
        note = f"{int(labels.max()) + 1} clusters at {chosen.cluster_radius * spacing:.4g}"
        log.apply("clutter", labels < chosen.clusters, note)
    missing = () if len(planes) == chosen.planes else (*map(_refusal, refused),)
    if chosen.planes and not planes:
        missing = (*missing, "no plane was found that the object stands on, so none is removed")
    warnings = (*missing, *(() if inside.all() else log.warnings()))
    reasons = tuple(log.reasons)
    return Cleaned(log.keep, log.reason, reasons, tuple(log.steps), tuple(planes), warnings)


def _require_near(
    seed: Float64Array,  # [3]
    points: NDArray[np.floating],  # [N, 3]
) -> None:
    """Refuse a seed point that is far from every point.

    Raises:
        UserError: the nearest point is far away.
    """
    away = float(np.linalg.norm(points - seed, axis=1).min())
    low, high = points.min(axis=0), points.max(axis=0)
    if not away <= _SEED_REACH * float(np.linalg.norm(high - low)):
        box = " to ".join(",".join(f"{value:.4g}" for value in corner) for corner in (low, high))
        raise UserError(
            f"--seed-point: expected a point on an object, found the nearest one {away:.4g} "
            f"away; points lie in {box} (--propose lists objects)"
        )


class _Log:
    """Records which points are still kept, and which step removed each of the others."""

    def __init__(self, count: int) -> None:
        self.keep = np.ones(count, np.bool_)
        self.reason = np.full(count, -1, np.int8)
        self.reasons: list[str] = []
        self.steps: list[StepRecord] = []
        self.last_kept = self.keep

    def apply(self, name: str, kept: BoolArray, note: str) -> None:
        """Remove, of the points that are left, those that a step does not keep.

        Raises:
            UserError: the step keeps none of them.
        """
        where = np.flatnonzero(self.keep)
        removed, before = where[~kept], len(where)
        if name not in self.reasons:
            self.reasons.append(name)
        self.reason[removed] = self.reasons.index(name)
        self.keep[removed] = False
        self.last_kept = kept
        counts = {name: len(removed)} if len(removed) else {}
        self.steps.append(StepRecord(f"remove_{name}", before, before - len(removed), counts, note))
        if before == len(removed):
            raise UserError(
                f"scan: {name}: expected points to remain, but all {before} were removed"
            )

    def warnings(self) -> tuple[str, ...]:
        """Warn, with counts, if less than ``DOUBTFUL_SHARE`` of the points is left."""
        kept, count = int(self.keep.sum()), len(self.keep)
        if kept >= DOUBTFUL_SHARE * count:
            return ()
        gone = [f"{int((self.reason == i).sum()):,} {n}" for i, n in enumerate(self.reasons)]
        share = 100.0 * kept / count
        return (
            f"doubtful: {kept:,} of {count:,} points ({share:.0f} %) remain; removed: "
            f"{', '.join(gone)}; see removed.png",
        )


def _neighbours(
    cloud: PointCloud,
    inside: BoolArray,  # [M]
    planes: list[SupportPlane],
    spacing: float,
    viewpoint: Points | None,
    up: Points | None,
) -> BoolArray:  # [N] of the points inside
    """Mark the points of objects most of which lie outside the boxes."""
    low, high = cloud.points[inside].min(axis=0), cloud.points[inside].max(axis=0)
    reach = _VICINITY * float(np.linalg.norm(high - low))
    standing = ((cloud.points > low - reach) & (cloud.points < high + reach)).all(axis=1)
    for plane in planes:
        standing &= plane.heights(cloud.points) > plane.thickness
    beyond = np.zeros(len(cloud), np.bool_)
    if (standing & inside).any():
        beyond[standing] = beyond_boxes(
            cloud.points[standing],
            cloud.colors[standing],
            inside[standing],
            spacing,
            viewpoint=viewpoint,
            up=up,
        )
    return beyond[inside]


def _refusal(plane: SupportPlane) -> str:
    """Say why a plane is not removed."""
    return f"a plane of {int(plane.inside.sum()):,} points is not removed: {plane.refusal}"


def _plane_note(plane: SupportPlane) -> str:
    """Describe a removed plane."""
    tilt = "" if plane.angle_deg is None else f", {plane.angle_deg:.0f} degrees from level"
    return (
        f"normal {np.round(plane.plane[:3], 3).tolist()}{tilt}, "
        f"{int(plane.inside.sum()):,} points of the scene within {plane.thickness:.3g}; "
        f"{100 * plane.share_over:.0f} % of the others are above it"
    )


def not_outliers(points: Points, neighbours: int, ratio: float) -> BoolArray:  # [N]
    """Keep points whose mean distance to their neighbours is not far above the cloud's."""
    count = min(neighbours, len(points) - 1)
    if count < 1:
        return np.ones(len(points), np.bool_)
    distances = cKDTree(points).query(points, k=count + 1)[0][:, 1:].mean(axis=1)
    limit = max(distances.mean() + ratio * distances.std(), _CORNER * float(np.median(distances)))
    kept: BoolArray = distances <= limit + 1e-300
    return kept


def level_rotation(
    plane: Float64Array,  # [4]
    toward: Float64Array,  # [3] or [N, 3]
) -> Float64Array:  # [3, 3]
    """Return the rotation that makes a plane horizontal: z up, x as near the source's as possible.

    Args:
        plane: a, b, c, d of ax + by + cz + d = 0.
        toward: a point on the plane's upper side, or points most of which are on that side.
    """
    normal = plane[:3] / np.linalg.norm(plane[:3])
    up = normal if np.median(toward @ normal + plane[3]) > 0 else -normal
    hint = np.array([1.0, 0.0, 0.0])
    if abs(hint @ up) > 0.99:
        hint = np.array([0.0, 0.0, 1.0])
    x = hint - (hint @ up) * up
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])
