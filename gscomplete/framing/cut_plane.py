"""Find the upright plane that P was cut along, if it was, and whether P is symmetric about it.

A smooth surface that is symmetric about a plane meets the plane at a right angle. So if P's surface
meets the plane of its cut squarely all along, the plane is probably one of symmetry (or the object
is a prism across it), and P's mirror image is what was cut away. At the rims that a scan ends in,
and at those of sheets, the surface runs along the plane instead.

Conventions
-----------
* A point is on the rim of a surface if its neighbours lie to one side of it. Normals are those that
  flat splats tell, as places tell them badly at a rim (``splats.geometry.neighbourhood``).
* Lengths and places are those of the points given, z up; tolerances are in sides of their box.
* The plane's normal is horizontal, at an azimuth in degrees, and points to the side cut away.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gscomplete.splats.geometry.neighbourhood import ON_RIM, normals_at, one_sidedness
from gscomplete.splats.geometry.upright_plane import UprightPlane, fitted_to_edge
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import Float64Array

_MOST_POINTS = 6000
_TESTED = 1500
_NEIGHBOURS = 24
_FEWEST_RIM = 8
_LEAST_RIM_SHARE = 0.01
_STEP_DEG = 2.0
_TOLERANCE = 0.012
"""Rim points may lie this far off the plane."""
_MOST_BEYOND = 0.02
"""Share of P beyond the plane: floaters."""
_SQUARE = 0.3
"""A surface meets the plane squarely where the cosine between their normals is smaller."""
_LEAST_SHARE = 0.5
"""A plane is that of a cut if at least this share of the rim lies in it, ..."""
_LEAST_SQUARE_SHARE = 0.15
_LEAST_SQUARENESS = 0.5
_FEWEST_SQUARE = 16
"""... or if at least the first share lies in it, and of that rim at least the second share and so
many points meet the plane squarely. Of the scans and the complete objects of 30 unseen objects,
next to none has such a rim."""
_LEAST_MET = 0.08
"""Least squareness for P's surface to run into the plane: 94 % of 223 cuts that leave half an
object of the train split reach it, and 47 % of the rims of 85 scans."""
_SYMMETRIC_SQUARENESS = 0.78
_SYMMETRIC_SHARE = 0.35
_SYMMETRIC_COSINE = 0.2
"""P is taken to be symmetric about its cut if squareness and share of the rim reach the first two
and the mean cosine does not exceed the third. The third rules out a round cup cut beside its axis,
whose wall meets the plane nearly squarely but leans to one side."""
_WALL, _WALL_REACH, _FEWEST_OF_WALLS = 0.5, 0.1, 16
"""Surface is a wall where the horizontal part of its normal is larger. Walls count that are nearer
to the plane than this share of P's depth behind it, ``_MOST_REACH`` at most, if they have so many
points."""
_MOST_REACH = 0.03
_SYMMETRIC_WALL_COSINE = 0.2
"""Nor is P symmetric if its walls meet the plane more slantingly than this: level surfaces meet any
upright plane squarely. Of a keyboard cut aslant they are nearly all."""
_SQUARER, _SQUARER_SHARE, _SQUARER_COSINE = 0.9, 0.25, 0.1
_LEAST_BREADTH, _LEAST_HEIGHT = 0.6, 0.1
"""Or the first two are reached, neither cosine exceeds the third, that rim is broad, as the edge of
what a scanner saw is not, and P is not flat: the outline of flat things is their rim. Things of
sheets and boards have many rims of their own."""
_OWN_SYMMETRY, _OWN_TOLERANCE, _OWN_SHIFTS = 0.95, 0.02, (-0.01, 0.0, 0.01)
"""Nor is P symmetric about its cut if more of it than this has its mirror image on P itself, about
a parallel plane through P's middle, within the tolerance, in sides of P's box: it then lacks
nothing that way. The plane is also tried beside the middle."""


@dataclass(frozen=True, slots=True)
class CutPlane(UprightPlane):
    """An upright plane that P's rim lies in."""

    rim_share: float
    """Share of P's rim that lies in the plane."""
    squareness: float
    """Share of that rim where P's surface meets the plane at nearly a right angle."""
    mean_cosine: float
    """Between the plane's normal and the surface normals along that rim."""
    wall_cosine: float = 0.0
    """Median between the plane's normal and the horizontal parts of the normals of walls near it;
    0 if there are hardly any."""
    breadth: float = 1.0
    """Of that rim along the plane, as a share of P's."""
    height: float = 1.0
    """Of P, in sides of its box."""
    own_symmetry: float = 0.0
    """Share of P whose mirror image about a parallel plane through P's middle is on P."""

    @property
    def is_square(self) -> bool:
        """Whether P's surface meets the plane as that of one half of a symmetric object does."""
        cosine = max(self.mean_cosine, self.wall_cosine)
        return (
            self.squareness >= _SYMMETRIC_SQUARENESS
            and self.rim_share >= _SYMMETRIC_SHARE
            and self.mean_cosine <= _SYMMETRIC_COSINE
            and self.wall_cosine <= _SYMMETRIC_WALL_COSINE
        ) or (
            self.squareness >= _SQUARER
            and self.rim_share >= _SQUARER_SHARE
            and cosine <= _SQUARER_COSINE
            and self.breadth >= _LEAST_BREADTH
            and self.height >= _LEAST_HEIGHT
        )

    @property
    def is_symmetric(self) -> bool:
        """Whether what was cut away is likely the mirror image of P."""
        return self.is_square and self.own_symmetry <= _OWN_SYMMETRY

    @property
    def meets_surface(self) -> bool:
        """Whether P's surface runs into the plane somewhere, as it does where it was cut."""
        return self.squareness >= _LEAST_MET


def find_cut(
    points: Float64Array,  # [N, 3] z up
    axes: Float64Array | None = None,  # [N, 3]
) -> CutPlane | None:
    """Return the upright plane that P was cut along, P on one side of it; None = there is none.

    Args:
        points: centres of P's splats, in any unit.
        axes: of these splats (``neighbourhood.flat_axes``); None = unknown.
    """
    chosen = every_nth(points, _MOST_POINTS)
    axes = None if axes is None else every_nth(axes, _MOST_POINTS)
    if len(chosen) <= _NEIGHBOURS:
        return None
    middle, side = chosen.mean(axis=0), max(float(np.ptp(chosen, axis=0).max()), 1e-12)
    chosen = (chosen - middle) / side
    tree = cKDTree(chosen)
    rim = _rim(chosen, tree)
    if len(rim) < _FEWEST_RIM:
        return None
    found = _best_plane(chosen, rim)
    if found is None:
        return None
    normal, in_plane = found
    cosines = np.abs(normals_at(in_plane, chosen, tree, axes) @ normal)
    squareness = float((cosines < _SQUARE).mean())
    share = len(in_plane) / len(rim)
    is_met = squareness >= _LEAST_SQUARENESS and len(in_plane) >= _FEWEST_SQUARE
    if share < (_LEAST_SQUARE_SHARE if is_met else _LEAST_SHARE):
        return None
    azimuth_deg = math.degrees(math.atan2(normal[1], normal[0])) % 360.0
    # Rim points may lie up to a spacing inside the plane that P ends at.
    offset = float(np.quantile(in_plane @ normal, 0.9))
    plane = CutPlane(
        azimuth_deg,
        offset * side + float(middle @ normal),
        share,
        squareness,
        float(cosines.mean()),
        _wall_cosine(chosen, tree, axes, normal, offset),
        _breadth(in_plane, normal, 0.05) / max(_breadth(chosen, normal, 0.005), 1e-12),
        float(np.ptp(chosen[:, 2])),
    )
    if plane.is_square:
        plane = dataclasses.replace(plane, own_symmetry=_own_symmetry(chosen, tree, normal))
    edge = fitted_to_edge(points, plane)
    return dataclasses.replace(plane, azimuth_deg=edge.azimuth_deg, offset=edge.offset)


def _breadth(points: Float64Array, normal: Float64Array, left_out: float) -> float:  # [N, 3], [3]
    """Return how far points reach along a plane, without a share of them at both ends."""
    along = points @ np.array([-normal[1], normal[0], 0.0])
    return float(np.ptp(np.quantile(along, (left_out, 1.0 - left_out))))


def _own_symmetry(
    points: Float64Array,  # [N, 3]
    tree: cKDTree,
    normal: Float64Array,  # [3]
) -> float:
    """Return how much of P is symmetric (``CutPlane.own_symmetry``)."""
    low, high = np.quantile(points @ normal, (0.005, 0.995))
    tested = every_nth(points, _TESTED)
    shares = []
    for shift in _OWN_SHIFTS:
        along = tested @ normal - ((low + high) / 2 + shift)
        distance, _ = tree.query(tested - 2 * along[:, None] * normal)
        shares.append(float((distance < _OWN_TOLERANCE).mean()))
    return max(shares)


def _wall_cosine(
    points: Float64Array,  # [N, 3]
    tree: cKDTree,
    axes: Float64Array | None,  # [N, 3]
    normal: Float64Array,  # [3]
    offset: float,
) -> float:
    """Return how slantingly walls meet an upright plane (``CutPlane.wall_cosine``)."""
    depths = offset - points @ normal
    reach = min(_WALL_REACH * float(depths.max()), _MOST_REACH)
    near = points[np.abs(depths) < reach]
    normals = normals_at(near, points, tree, axes)
    level = np.hypot(normals[:, 0], normals[:, 1])
    walls = level > _WALL
    if walls.sum() < _FEWEST_OF_WALLS:
        return 0.0
    return float(np.median(np.abs(normals[walls] @ normal) / level[walls]))


def _best_plane(
    points: Float64Array,  # [N, 3]
    rim: Float64Array,  # [R, 3]
) -> tuple[Float64Array, Float64Array] | None:  # [3], [K, 3]
    """Return the normal of the plane with most of the rim, and the rim's points in it."""
    best: tuple[Float64Array, Float64Array] | None = None
    most = max(_FEWEST_RIM, int(_LEAST_SQUARE_SHARE * len(rim))) - 1
    for azimuth_deg in np.arange(0.0, 360.0, _STEP_DEG):
        angle = math.radians(float(azimuth_deg))
        normal = np.array([math.cos(angle), math.sin(angle), 0.0])
        along = rim @ normal
        ordered = np.sort(along)
        counts = np.searchsorted(ordered, ordered + 2 * _TOLERANCE, side="right")
        counts -= np.arange(len(ordered))
        first = int(counts.argmax())
        if counts[first] <= most:
            continue
        low, high = ordered[first], ordered[first] + 2 * _TOLERANCE
        offset = float(np.median(ordered[first : first + counts[first]]))
        if (points @ normal > offset + 2 * _TOLERANCE).mean() <= _MOST_BEYOND:
            most = int(counts[first])
            best = normal, rim[(along >= low) & (along <= high)]
    return None if best is None else (_refined(*best), best[1])


def _refined(normal: Float64Array, in_plane: Float64Array) -> Float64Array:  # [3], [K, 3] -> [3]
    """Return the horizontal direction along which points of a plane vary least."""
    flat = in_plane[:, :2] - in_plane[:, :2].mean(axis=0)
    values, vectors = np.linalg.eigh(flat.T @ flat)
    if values[0] > 0.1 * values[1]:
        return normal  # so narrow a rim does not determine the plane's azimuth
    x, y = vectors[:, 0]
    sign = math.copysign(1.0, x * normal[0] + y * normal[1])
    return np.array([sign * x, sign * y, 0.0])


def _rim(points: Float64Array, tree: cKDTree) -> Float64Array:  # [N, 3] -> [R, 3]
    """Return the rim points of a surface; none if hardly any of its points are on a rim."""
    tested = every_nth(points, _TESTED)
    _, index = tree.query(tested, k=_NEIGHBOURS + 1)
    on_rim = one_sidedness(points[index[:, 1:]] - tested[:, None]) > ON_RIM
    if on_rim.mean() < _LEAST_RIM_SHARE:
        return tested[:0]
    return tested[on_rim]
