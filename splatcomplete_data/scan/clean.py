"""Clean scans: planes, outliers and clutter, each as a mask with counts and a switch.

Conventions
-----------
* Lengths are multiples of the cloud's spacing (median distance to the nearest neighbour) unless
  their name ends in ``_file``: the same settings fit metres and millimetres.
* A step returns what it keeps; ``clean`` strings them together and remembers for every point which
  step removed it. Nothing is changed in place.
* Planes: RANSAC, a function of the seed alone (Open3D's runs in parallel and is not). The plane
  with most points goes first; planes below a share of the cloud stay.
* Outliers: mean distance to k neighbours beyond mean + ratio x standard deviation over the cloud.
* Clutter: connected clusters (``clusters``), of which one, or the largest few, stay.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gscomplete.errors import UserError
from splatcomplete_data.objects import StepRecord
from splatcomplete_data.points import median_spacing
from splatcomplete_data.scan.clusters import cluster

BoolArray = NDArray[np.bool_]
Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CleanSettings:
    """Which steps run, and their knobs."""

    planes: int = 1
    """Most planes (floor, walls, table) to remove; 0 = none."""
    plane_thickness: float = 4.0
    """A point this close to a plane belongs to it, in spacings."""
    plane_share: float = 0.12
    """A plane with a smaller share of the remaining points is not removed."""
    plane_trials: int = 400
    """RANSAC trials per plane."""
    outlier_ratio: float | None = 2.5
    """Standard deviations from which a point is an outlier; None = keep all."""
    outlier_neighbours: int = 16
    """Neighbours whose mean distance is judged."""
    clusters: int = 1
    """Clusters to keep, largest first; 0 = do not cluster."""
    cluster_radius: float = 5.0
    """Points no farther apart than this are of one cluster, in spacings."""
    seed_point: tuple[float, float, float] | None = None
    """Keep the cluster nearest to this point instead of the largest, file frame."""
    seed: int = 0
    """Seed of RANSAC."""


@dataclass(frozen=True, slots=True, eq=False)
class Cleaned:
    """What cleaning keeps, and why the rest went."""

    keep: BoolArray  # [N]
    reason: NDArray[np.int8]  # [N] index into ``reasons`` of the removed, -1 for the kept
    reasons: tuple[str, ...]
    steps: tuple[StepRecord, ...]
    planes: tuple[NDArray[np.float64], ...] = field(default=())  # [4] a, b, c, d: ax + .. + d = 0


def clean(points: Points, settings: CleanSettings | None = None) -> Cleaned:
    """Run the steps in order: planes, outliers, clusters.

    Args:
        points: finite points [N, 3].
        settings: which steps, and knobs; None = defaults.

    Raises:
        UserError: nothing is left.
    """
    chosen = settings or CleanSettings()
    spacing = median_spacing(points, 20_000)
    keep = np.ones(len(points), np.bool_)
    reason = np.full(len(points), -1, np.int8)
    reasons: list[str] = []
    steps: list[StepRecord] = []
    planes: list[NDArray[np.float64]] = []

    def apply(name: str, kept: BoolArray, note: str) -> None:
        where = np.flatnonzero(keep)
        removed = where[~kept]
        before = len(where)
        if name not in reasons:
            reasons.append(name)
        reason[removed] = reasons.index(name)
        keep[removed] = False
        counts = {name: len(removed)} if len(removed) else {}
        steps.append(StepRecord(f"remove_{name}", before, before - len(removed), counts, note))
        if before == len(removed):
            raise UserError(f"scan: {name}: expected something to stay, all {before} points went")

    for number in range(chosen.planes):
        found = find_plane(points[keep], chosen.plane_thickness * spacing, chosen, number)
        if found is None:
            break
        plane, inside = found
        planes.append(plane)
        apply("planes", ~inside, f"normal {np.round(plane[:3], 3).tolist()}")
    if chosen.outlier_ratio is not None:
        kept = not_outliers(points[keep], chosen.outlier_neighbours, chosen.outlier_ratio)
        apply("outliers", kept, f"beyond {chosen.outlier_ratio:g} standard deviations")
    if chosen.clusters > 0:
        labels = cluster(points[keep], chosen.cluster_radius * spacing)
        kept = _chosen_clusters(points[keep], labels, chosen)
        note = f"{int(labels.max()) + 1} clusters at {chosen.cluster_radius * spacing:.4g}"
        apply("clutter", kept, note)
    return Cleaned(keep, reason, tuple(reasons), tuple(steps), tuple(planes))


def find_plane(
    points: Points, thickness: float, settings: CleanSettings, number: int = 0
) -> tuple[NDArray[np.float64], BoolArray] | None:
    """Find the plane with most points within ``thickness``; None when it has too few.

    Returns:
        The plane [4] (unit normal, offset) and which points lie in it [N].
    """
    if len(points) < 3:
        return None
    rng = np.random.default_rng((settings.seed, number))
    sample = points[rng.choice(len(points), min(len(points), 6000), replace=False)]
    corners = sample[rng.integers(len(sample), size=(settings.plane_trials, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    usable = lengths > 1e-12
    if not usable.any():
        return None
    normals = normals[usable] / lengths[usable, None]
    offsets = -np.einsum("tc,tc->t", normals, corners[usable, 0])
    scores = [
        int((np.abs(sample @ normal + offset) <= thickness).sum())
        for normal, offset in zip(normals, offsets, strict=True)
    ]
    best = int(np.argmax(scores))
    plane = np.append(normals[best], offsets[best])
    for _ in range(3):  # least squares on its own points
        inside = np.abs(points @ plane[:3] + plane[3]) <= thickness
        if inside.sum() < 3:
            return None
        center = points[inside].mean(axis=0)
        normal = np.linalg.eigh(np.cov((points[inside] - center).T))[1][:, 0]
        plane = np.append(normal, -normal @ center)
    inside = np.abs(points @ plane[:3] + plane[3]) <= thickness
    return (plane, inside) if inside.mean() >= settings.plane_share else None


def not_outliers(points: Points, neighbours: int, ratio: float) -> BoolArray:  # [N]
    """Keep points whose mean distance to their neighbours is not far above the cloud's."""
    count = min(neighbours, len(points) - 1)
    if count < 1:
        return np.ones(len(points), np.bool_)
    distances = cKDTree(points).query(points, k=count + 1)[0][:, 1:].mean(axis=1)
    kept: BoolArray = distances <= distances.mean() + ratio * distances.std() + 1e-300
    return kept


def _chosen_clusters(
    points: Points, labels: NDArray[np.int64], settings: CleanSettings
) -> BoolArray:
    """Keep the largest clusters, or the one nearest to the seed point."""
    if settings.seed_point is None:
        return labels < settings.clusters
    distance = np.linalg.norm(points - np.asarray(settings.seed_point), axis=1)
    kept: BoolArray = labels == labels[int(distance.argmin())]
    return kept


def level_rotation(
    plane: NDArray[np.float64],  # [4]
    toward: NDArray[np.float64],  # [3] or [N, 3]
    right: tuple[float, float, float] = (1.0, 0.0, 0.0),
) -> NDArray[np.float64]:  # [3, 3]
    """Return the rotation that makes a plane horizontal: z up, ``right`` as near +x as it can.

    Args:
        plane: a, b, c, d of ax + by + cz + d = 0.
        toward: a point on the plane's upper side, or points most of which are.
        right: what is to point along +x.
    """
    normal = plane[:3] / np.linalg.norm(plane[:3])
    up = normal if np.median(toward @ normal + plane[3]) > 0 else -normal
    hint = np.asarray(right, np.float64)
    if abs(hint @ up) > 0.99:
        hint = np.array([0.0, 0.0, 1.0])
    x = hint - (hint @ up) * up
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])
