"""How far the complete object reaches beyond P: not at all if P's surface is closed.

The inside of a closed surface cannot be seen from anywhere. The back of a scan, or the inside
behind a cut, can be seen: there a surface element is exposed on both sides.

Conventions
-----------
* Only views from the sides and from above count: a hole that shows only from below, such as a
  missing base, does not make a surface open.
* Points are thinned; their spacing is the side of the square of surface that each stands for.
  Surfaces nearer to each other than about one spacing are not told apart.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numba
import numpy as np
from scipy.spatial import cKDTree

from gscomplete.framing.cut_plane import CutPlane
from gscomplete.splats.geometry.neighbourhood import normals_of
from gscomplete.util.arrays import BoolArray, Float64Array

CLOSED_BELOW, CLOSED_BELOW_FINELY = 0.008, 0.005
"""P's surface is closed if a smaller share of it is exposed on both sides: less than the first
measured with few points or, if that is exceeded only a little, less than the second measured with
many. Of 90 objects of the train split 59 are found closed, of 450 parts of them (five kinds) 6."""
_CONTRADICTED_FROM = 0.012
"""If the share measured with many points is larger, P is open whatever few points say. No object of
160 closed ones is."""
_OPEN_FROM, _CUT_OPEN_FROM = 0.04, 0.06
"""If the share measured with few points reaches this (without a cut, with a cut), P is open and
many points are not tried."""
_THIN = 0.15
"""The same goes for a P without a cut whose thickness over its largest side is less: halves of
plates and pallets show no inside, so many points would find them closed."""
_EDGE_SQUARENESS, _EDGE_WALL = 0.75, 0.6
"""A "cut" with less squareness than the first may be a mere edge of a closed thing if the walls
next to it run along its plane: if their cosine is at least the second. Of 280 objects of the train
split 205 complete ones are found closed, of parts of them that end in a plane 2 of 223 halves, 1 of
241 halves through the middle and 3 of 39 that lack a box."""
_FLAT = 0.015
"""If P has a cut and is thinner than this, it is open: its two sides cannot be told apart."""
_LITTLE_EXPOSED = (0.0008, 0.01)
"""Parts of objects with double walls expose a share between these, measured with few points. Closed
objects expose less; blades and rods that pass for closed expose more."""
_MOST_OPENNESS = 0.3
"""A P in that range is open if it is more one-sided than this. On the 241 objects that this was
chosen on it opens 13 halves and boxes (their IoU rises from .653 to .782) and three complete
objects (1.000 to .994); on 233 others 8 (.679 to .775) and three (1.000 to .902)."""
_FEW_POINTS, _MOST_POINTS = 8000, 24_000
_NEIGHBOURS = 10
_AZIMUTHS = 12
_ELEVATIONS_DEG = (-5.0, 25.0, 55.0)
_STEEP = 0.35
"""Least cosine between a direction and a normal for that side to count as seen."""
_TOLERANCE_SPACINGS = 0.9
_REACH_SPACINGS = 1.6
"""Half the side of the square that a point covers in a depth image, spacings."""
_PX_PER_SPACING = 2.0


class Exposure:
    """Share of P's surface that is exposed on both sides, computed when it is first asked for."""

    def __init__(self, points: Float64Array) -> None:  # [N, 3] z up
        """Take P's points."""
        self._points = points

    @functools.cached_property
    def with_few(self) -> float:
        """The share, measured with few points."""
        return share_exposed_twice(self._points, _FEW_POINTS)

    @functools.cached_property
    def with_many(self) -> float:
        """The share, measured with many points."""
        return share_exposed_twice(self._points)


def is_closed(
    points: Float64Array,  # [N, 3] z up
    cut: CutPlane | None,
    openness: Callable[[], float],
    exposure: Exposure | None = None,
) -> bool:
    """Say whether P's surface is closed as far as it can be seen from the sides and from above.

    The share that is exposed on both sides does not suffice. Half a cup with a double wall shows
    the space between its walls only through the cut. So a P that ends squarely in a plane is open,
    and so is one of which a small share is exposed while it is open to one side. On the other hand,
    edges may pass for cuts that are met at a slant, beside walls along them. Such a cut is ignored
    if hardly any of P is exposed.

    Args:
        points: P's points.
        cut: the cut that ``find_cut`` finds in them.
        openness: how one-sided P is (``guess.ViewScores.openness``); called only if it matters.
        exposure: of P; None = it is computed here.
    """
    little, much = _LITTLE_EXPOSED
    exposure = exposure or Exposure(points)
    if not _hides_its_inside(points, cut, exposure):
        return False
    return not (little <= exposure.with_few < much and openness() > _MOST_OPENNESS)


def thickness_of(points: Float64Array) -> float:  # [N, 3]
    """Return the smallest side of P's box over its largest."""
    sides = np.ptp(points, axis=0)
    return float(sides.min() / max(sides.max(), 1e-12))


def _hides_its_inside(
    points: Float64Array,  # [N, 3]
    cut: CutPlane | None,
    exposure: Exposure,
) -> bool:
    """Say whether hardly any of P is exposed on both sides, and no cut shows that P is open."""
    thickness = thickness_of(points)
    is_thin = thickness < _THIN
    if cut is not None:
        may_be_edge = cut.squareness < _EDGE_SQUARENESS and cut.wall_cosine >= _EDGE_WALL
        if cut.is_symmetric or thickness < _FLAT or not may_be_edge:
            return False
        if exposure.with_few >= _CUT_OPEN_FROM:
            return False
        return exposure.with_many < CLOSED_BELOW_FINELY
    share = exposure.with_few
    if share < CLOSED_BELOW:
        return exposure.with_many < _CONTRADICTED_FROM
    if share >= _OPEN_FROM or is_thin:
        return False
    return exposure.with_many < CLOSED_BELOW_FINELY


def extended_box(
    points: Float64Array,  # [N, 3]
    toward_deg: float,
) -> tuple[Float64Array, float, str]:
    """Grow the box of P towards its open side to where the complete object probably ends.

    Along the open direction the complete object is taken to be as deep as it is wide, but at most
    twice as deep as P: a cut or a scan that keeps less than half is rare.

    Args:
        points: P's points.
        toward_deg: azimuth of the open side.

    Returns:
        The centre [3]; the largest side of the box of P and of P's reflection through that centre;
        and the reason in words.
    """
    angle = math.radians(toward_deg)
    along = np.array([math.cos(angle), math.sin(angle), 0.0])
    across = np.array([-along[1], along[0], 0.0])
    depths, widths = points @ along, points @ across
    depth, width = float(np.ptp(depths)), float(np.ptp(widths))
    extra = max(min(width, 2.0 * depth) - depth, 0.0)
    if extra <= 0.1 * depth:
        low, high = points.min(axis=0), points.max(axis=0)
        reason = "P is open but as deep as it is wide: centre and size are those of its box"
        return (low + high) / 2, float((high - low).max()), reason
    center = (depths.min() + depths.max() + extra) / 2 * along
    center = center + (widths.min() + widths.max()) / 2 * across
    center[2] = (points[:, 2].min() + points[:, 2].max()) / 2
    size = 2.0 * float(np.abs(points - center).max())
    share = 100.0 * extra / depth
    return center, size, f"P is open to one side: its box is extended by {share:.0f} % to there"


def share_exposed_twice(
    points: Float64Array,  # [N, 3] z up
    most_points: int = _MOST_POINTS,
) -> float:
    """Return the share of surface points that are exposed on both sides of their surface."""
    step = max(1, -(-len(points) // most_points))
    chosen = np.ascontiguousarray(points[::step])
    if len(chosen) <= _NEIGHBOURS:
        return 1.0
    tree = cKDTree(chosen)
    distance, index = tree.query(chosen, k=_NEIGHBOURS + 1)
    # A disc that reaches to the k-th neighbour holds k points, each of which stands for the square
    # of one spacing.
    spacing = float(np.median(distance[:, -1])) * math.sqrt(math.pi / _NEIGHBOURS)
    if not spacing > 0:
        return 1.0
    normals = normals_of(chosen[index])
    front = np.zeros(len(chosen), np.bool_)
    back = np.zeros(len(chosen), np.bool_)
    for direction in _directions():
        seen = _seen_from(chosen, direction, spacing)
        along = normals @ direction
        front |= seen & (along > _STEEP)
        back |= seen & (along < -_STEEP)
    return float((front & back).mean())


def _directions() -> Float64Array:  # [D, 3] unit, from the object to the viewer
    """Return directions about the object and from straight above."""
    azimuths = np.linspace(0, 2 * np.pi, _AZIMUTHS, endpoint=False)
    found = [[0.0, 0.0, 1.0]]
    for row, elevation in enumerate(np.radians(_ELEVATIONS_DEG)):
        flat, up = np.cos(elevation), np.sin(elevation)
        turned = azimuths + row * np.pi / _AZIMUTHS
        found += [[flat * np.cos(a), flat * np.sin(a), up] for a in turned]
    return np.array(found)


def _seen_from(
    points: Float64Array,  # [N, 3]
    direction: Float64Array,  # [3] to the viewer
    spacing: float,
) -> BoolArray:  # [N]
    """Mark the points that lie on the surface nearest to a distant viewer."""
    helper = np.array([0.0, 0.0, 1.0]) if abs(direction[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    right = np.cross(helper, direction)
    right /= np.linalg.norm(right)
    local = points @ np.stack([right, np.cross(direction, right), -direction], axis=1)
    pixel = spacing / _PX_PER_SPACING
    place = (local[:, :2] - local[:, :2].min(axis=0)) / pixel
    size = np.ceil(place.max(axis=0)).astype(np.int64) + 1
    shrink = max(1.0, float(size.max()) / 1024)
    reach = _REACH_SPACINGS * _PX_PER_SPACING / shrink
    size = np.ceil(size / shrink).astype(np.int64) + 1
    return _on_nearest_surface(
        place / shrink, local[:, 2], size[0], size[1], reach, _TOLERANCE_SPACINGS * spacing
    )


@numba.njit(cache=True)
def _on_nearest_surface(
    place: Float64Array,  # [N, 2] px
    depth: Float64Array,  # [N]
    width_px: int,
    height_px: int,
    reach_px: float,
    tolerance: float,
) -> BoolArray:  # [N]
    """Draw squares into a depth image, then compare each point with it."""
    nearest = np.full((height_px, width_px), np.inf)
    for n in range(len(depth)):
        low_y, high_y = max(int(place[n, 1] - reach_px), 0), int(place[n, 1] + reach_px)
        low_x, high_x = max(int(place[n, 0] - reach_px), 0), int(place[n, 0] + reach_px)
        for y in range(low_y, min(high_y, height_px - 1) + 1):
            for x in range(low_x, min(high_x, width_px - 1) + 1):
                nearest[y, x] = min(nearest[y, x], depth[n])
    seen = np.empty(len(depth), np.bool_)
    for n in range(len(depth)):
        seen[n] = depth[n] <= nearest[int(place[n, 1]), int(place[n, 0])] + tolerance
    return seen
