"""Find the planes that an object stands on or in front of, in the complete scene.

Conventions
-----------
* Planes are [a, b, c, d] with a unit normal that points to the upper side: ax + by + cz + d is a
  point's height over the plane.
* The upper side is the scanner's side; if its position is unknown, the side of most other points.
* Planes are found by RANSAC whose result depends on the seed alone (Open3D's runs in parallel and
  does not have this property). The largest plane is found first; its points are left out of the
  search for the next.
* A plane is removed if it bears the object, but not if it is a face of it. With boxes, a face lies
  mostly within them, while a plane that bears the object extends beyond. Without boxes, many of the
  other points stand over a plane that bears them, while those of an object stand over the border of
  its face. "Other points" are those in no larger plane or those in no plane at all, whichever gives
  the larger share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscomplete.util.arrays import BoolArray, Float64Array

_LEAST_SHARE = 0.12
"""Least share of a plane in the points that are in no plane found before."""
_SEARCH_POINTS = 6000
"""Points that RANSAC counts for every trial."""
_FURTHER_CANDIDATES = 3
"""Planes tried beyond the number wanted, because faces and walls may be larger than the table."""
_LEVEL_COSINE = 0.5
"""Least cosine between a plane's normal and up for the plane to count as level. It allows 60
degrees, because a camera may look down on a table that steeply when its own up axis is all that is
known."""
_NOISE_WIDTHS = 3.2
"""Half thickness of a plane in standard deviations of its points' distances."""
_LEAST_SHARE_OVER = 0.38
"""Least share of the other points that stand over a plane which bears them. It is at least .47 for
the tables and desks of twelve scenes, and at most .30 for the faces of what stands there."""
_EXTENT_CELLS = 24
"""Cells along the longer side of a plane's extent."""
_TRIALS = 400
"""RANSAC trials per plane."""


@dataclass(frozen=True, slots=True)
class PlaneSettings:
    """How planes are found; lengths in spacings of the cloud."""

    thickness: float = 4.0
    """Largest half thickness; planes with less noise get 3.2 standard deviations."""
    seed: int = 0
    """Seed of RANSAC."""


@dataclass(frozen=True, slots=True, eq=False)
class SupportPlane:
    """A plane, and the evidence for and against removing it."""

    plane: Float64Array  # [4] normal to the upper side, offset
    inside: BoolArray  # [N] points of the cloud within its thickness
    thickness: float
    """Half thickness, file units."""
    angle_deg: float | None
    """Angle between its normal and up; None = up is unknown."""
    share_over: float
    """Share of the other points, of those to be kept, whose foot lies within the plane's extent."""
    refusal: str | None
    """Why the plane is not removed; None = it is."""

    @property
    def foot(self) -> Float64Array:  # [3]
        """Return the plane's point nearest to the origin."""
        foot: Float64Array = -self.plane[3] * self.plane[:3]
        return foot

    def heights(self, points: Float64Array) -> Float64Array:  # [N, 3] -> [N]
        """Return signed distances, positive on the upper side."""
        distances: Float64Array = points @ self.plane[:3] + self.plane[3]
        return distances


def find_support_planes(
    points: Float64Array,  # [N, 3] the complete scene
    wanted: BoolArray,  # [N] the points that boxes keep
    count: int,
    spacing: float,
    settings: PlaneSettings,
    *,
    up: Float64Array | None = None,  # [3] unit
    viewpoint: Float64Array | None = None,  # [3]
) -> tuple[list[SupportPlane], list[SupportPlane]]:
    """Find up to ``count`` planes to remove, the most level first.

    Args:
        points: all finite points, before any box.
        wanted: mask of the points that the boxes keep; all points if there are no boxes.
        count: most planes to remove.
        spacing: the cloud's spacing, file units.
        settings: knobs.
        up: the up direction; None = unknown.
        viewpoint: position of the scanner; None = unknown.

    Returns:
        The planes to remove, and those that were found but are kept, with reasons.
    """
    free = np.ones(len(points), np.bool_)
    fits: list[tuple[Float64Array, BoolArray, float, BoolArray]] = []
    for number in range(count + _FURTHER_CANDIDATES if count else 0):
        rest = np.flatnonzero(free)
        fitted = find_plane(points[rest], settings.thickness * spacing, settings, number)
        if fitted is None:
            break
        plane, near = fitted
        members = points[rest[near]]
        noise = 1.4826 * float(np.median(np.abs(members @ plane[:3] + plane[3])))
        thickness = min(max(_NOISE_WIDTHS * noise, spacing), settings.thickness * spacing)
        inside = free & (np.abs(points @ plane[:3] + plane[3]) <= thickness)
        free[rest[near]] = False
        fits.append((plane, inside, thickness, wanted & free))
    found = []
    for plane, inside, thickness, smaller in fits:
        # Points in no plane tell more beside a wall, points in no larger plane on a bare table.
        over = max(
            _share_over(points[inside], points[m], plane[:3]) for m in (smaller, wanted & free)
        )
        refusal = _refusal(inside, wanted, over)
        oriented = _to_upper_side(plane, points, wanted, thickness, viewpoint)
        angle = None
        if up is not None:
            angle = float(np.degrees(np.arccos(np.clip(oriented[:3] @ up, -1, 1))))
        found.append(SupportPlane(oriented, inside, thickness, angle, over, refusal))
    accepted = [plane for plane in found if plane.refusal is None]
    accepted.sort(key=lambda plane: not _is_level(plane))  # stable: the largest stay first
    return accepted[:count], [plane for plane in found if plane.refusal is not None]


def find_level_plane(
    points: Float64Array,  # [N, 3] the complete scene
    spacing: float,
    settings: PlaneSettings,
    *,
    up: Float64Array | None,  # [3] unit
    viewpoint: Float64Array | None,  # [3]
) -> SupportPlane | None:
    """Find the largest level plane that bears things (a floor, a table); None = there is none."""
    everything = np.ones(len(points), np.bool_)
    planes, _ = find_support_planes(
        points, everything, 1, spacing, settings, up=up, viewpoint=viewpoint
    )
    return planes[0] if planes and _is_level(planes[0]) else None


def find_plane(
    points: Float64Array,  # [N, 3]
    thickness: float,
    settings: PlaneSettings,
    number: int = 0,
) -> tuple[Float64Array, BoolArray] | None:
    """Find the plane with most points within ``thickness``; None when it has too few.

    Returns:
        The plane [4] (unit normal, offset) and which points lie in it [N].
    """
    if len(points) < 3:
        return None
    rng = np.random.default_rng((settings.seed, number))
    sample = points[rng.choice(len(points), min(len(points), _SEARCH_POINTS), replace=False)]
    corners = sample[rng.integers(len(sample), size=(_TRIALS, 3))]
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
    return (plane, inside) if inside.mean() >= _LEAST_SHARE else None


def _is_level(plane: SupportPlane) -> bool:
    """Tell whether a plane is about level; where up is unknown, all are."""
    return plane.angle_deg is None or np.cos(np.radians(plane.angle_deg)) >= _LEVEL_COSINE


def _refusal(inside: BoolArray, wanted: BoolArray, over: float) -> str | None:
    """Say why a plane is a face of the object and does not bear it; None = it bears it."""
    within, total = int((inside & wanted).sum()), int(inside.sum())
    if not wanted.all():
        is_face = 2 * within > total
        return f"{within:,} of its {total:,} points lie within the boxes" if is_face else None
    return (
        f"only {100 * over:.0f} % of the other points are above it"
        if over < _LEAST_SHARE_OVER
        else None
    )


def _to_upper_side(
    plane: Float64Array,  # [4]
    points: Float64Array,
    wanted: BoolArray,
    thickness: float,
    viewpoint: Float64Array | None,
) -> Float64Array:  # [4]
    """Orient a plane's normal towards the scanner or, if that is unknown, towards most points."""
    if viewpoint is not None:
        return plane if float(viewpoint @ plane[:3] + plane[3]) > 0 else -plane
    heights = points[wanted] @ plane[:3] + plane[3]
    heights = heights[np.abs(heights) > thickness]
    return plane if len(heights) == 0 or (heights > 0).mean() > 0.5 else -plane


def _share_over(
    members: Float64Array,  # [M, 3] points of the plane
    others: Float64Array,  # [K, 3]
    normal: Float64Array,  # [3]
) -> float:
    """Return the share of other points whose foot in the plane has plane points on all four sides.

    A table has no points where the object hides it, so a foot counts if there are plane points
    before and behind it in its row and in its column. The feet of the points of an object's other
    faces lie on the border of a face, and do not count.
    """
    if len(members) == 0 or len(others) == 0:
        return 0.0
    helper = np.eye(3)[int(np.abs(normal).argmin())]
    first = np.cross(normal, helper)
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(normal, first)], axis=1)
    flat, feet = members @ axes, others @ axes
    low = np.quantile(flat, 0.002, axis=0)
    side = float((np.quantile(flat, 0.998, axis=0) - low).max()) / _EXTENT_CELLS
    if not side > 0:
        return 0.0
    shape = (_EXTENT_CELLS + 2, _EXTENT_CELLS + 2)
    full = np.zeros(shape, np.bool_)
    cells = np.clip(np.floor((flat - low) / side), -1, _EXTENT_CELLS).astype(np.int64) + 1
    full[cells[:, 0], cells[:, 1]] = True
    beside = np.ones(shape, np.bool_)
    for axis in (0, 1):
        before = np.logical_or.accumulate(full, axis=axis)
        after = np.flip(np.logical_or.accumulate(np.flip(full, axis), axis=axis), axis)
        # a cell counts where there is plane before it and behind it, itself not counted
        beside &= _shifted(before, 1, axis) & _shifted(after, -1, axis)
    place = np.floor((feet - low) / side)
    is_in = ((place >= -1) & (place <= _EXTENT_CELLS)).all(axis=1)
    index = np.clip(place, -1, _EXTENT_CELLS).astype(np.int64) + 1
    return float((is_in & beside[index[:, 0], index[:, 1]]).mean())


def _shifted(mask: BoolArray, by: int, axis: int) -> BoolArray:
    """Shift a mask along an axis by one cell and fill with False."""
    rolled = np.roll(mask, by, axis=axis)
    edge: list[slice | int] = [slice(None), slice(None)]
    edge[axis] = 0 if by > 0 else -1
    rolled[tuple(edge)] = False
    return rolled
