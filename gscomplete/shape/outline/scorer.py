"""From which views P's outline is that of the whole object, by a small network.

From where P was scanned, and from views between several such places, P's outline is the complete
object's: nothing lies beside it. From where something was cut away it is not. What tells the two
apart is how P ends along the outline, especially over neighbouring views: at a true outline the
surface turns away from the viewer, at a cut it ends in a rim. The scorer has learned this from
parts of meshes whose truth is known (``recipes/train_embedded_prior``). Splats that were trained
from photos have fuzzy outlines and a scorer of their own, which has learned from such splats. It
takes the outlines of a capture that is cut for whole, so P has to be known not to be.

Conventions
-----------
* Points of P are thinned and relative to V's target, z up, object sizes.
* A point is seen if nothing of P lies much nearer in its pixel; it is seen from behind if nothing
  lies much farther.
* Depth cameras miss dark surfaces: what lies beside an outline is unlikely, not impossible.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter
from scipy.spatial import cKDTree

from gscomplete.networks.packaged import PACKAGED_WEIGHTS
from gscomplete.networks.perceptron import Perceptron
from gscomplete.shape.outline.views import (
    AZIMUTHS,
    ELEVATIONS_DEG,
    SIDE_PX,
    Mask,
    View,
    outline,
    views_at,
)
from gscomplete.splats.geometry.neighbourhood import ON_RIM, normals_of, one_sidedness
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import Float32Array, IntArray
from gscomplete.views import ViewDistribution

OUTLINE_SCORER_FILE = "outlines.safetensors"
CAPTURE_OUTLINE_SCORER_FILE = "capture_outlines.safetensors"
OF_VIEW = (
    "seen",  # share of P
    "seen_behind",
    "seen_through",  # from both sides: nothing else of P lies there
    "edge_cosine",  # mean of normals to the way to the viewer, along the outline
    "edge_facing",  # share of what is seen along the outline that faces the viewer
    "edge_rim",  # share of it that is on a rim of P's surface
    "edge_rim_facing",
    "edge_rim_grazing",
    "cosine",  # of all that is seen
    "rim",
    "area",  # of the outline, over the largest
)
"""Features of one view. They are given for the view itself, for views beside it and opposite, and
for the best view, the one that sees most of P."""
OF_PLACE = (
    "sine_elevation",
    "cosine_to_c",
    "cosine_to_best",
    "seen_mean",
    "rim_of_all",
    "thickness",
    "seen_within_45",  # degrees of azimuth to either side, by any view
    "seen_within_90",
    "width",
    "depth",
    "ends_in_plane",
)
_STEPS = (1, 2, 4, 6)
"""Of the two views this many steps to either side, the lesser and the greater value are
features."""
_BESIDE = tuple(f"{which}_{step}" for step in _STEPS for which in ("lesser", "greater"))
_AROUND = (*_BESIDE, "opposite", "at_best", "least", "most", "mean")
FEATURES = (*OF_VIEW, *OF_PLACE, *(f"{name}_{where}" for where in _AROUND for name in OF_VIEW))
MOST_LOGITS = 6.0
"""Most logits that a place loses for lying beside a whole outline; only cells that the shape
network is very sure of stay filled after that."""
DOUBTED_FROM, _LOGITS_PER_SCORE = 2.0, 3.0
"""The loss starts where the scorer's log odds that an outline is whole reach the first, and grows
by the second with each unit above it."""
_BESIDE_PX = 7
"""Side of the square that points are grown to before places beside them are marked; it is large
because P is sparse where its surface turns away."""
_POINTS, _NEIGHBOURS, _NORMAL_NEIGHBOURS = 4000, 24, 16
_SEEN_DEPTH = 0.05
_FACING = 0.6
"""A surface faces the viewer if the cosine between its normal and the view is larger."""
_EDGE_PX = 9
"""A point is along the outline if the square of this side about its pixel reaches beyond it."""
_UNIONS = (3, 6)
"""Steps to either side for the features ``seen_within``: 45 and 90 degrees of azimuth."""


@functools.cache
def packaged_outline_scorer(*, of_captures: bool = False) -> Perceptron:
    """Return the network that ships with the package."""
    file = CAPTURE_OUTLINE_SCORER_FILE if of_captures else OUTLINE_SCORER_FILE
    return Perceptron.load(PACKAGED_WEIGHTS / file, len(FEATURES))


def doubts_beside_outlines(
    points: Float32Array,  # [N, 3] P, object frame
    views: ViewDistribution,
    places: Float32Array,  # [M, 3] object frame
    *,
    ends_in_plane: bool,
    captured: bool = False,
) -> Float32Array:  # [M] logits
    """Return the logits that places lose for lying beside whole outlines of P.

    Of the views in which a place lies beside P, the one that takes the most counts.

    Args:
        points: centres of P's splats.
        views: V, whose distance, target and c are used.
        places: points of the object frame.
        ends_in_plane: whether P was cut along a plane, as far as found.
        captured: whether P was trained from photos and nothing was cut off it.
    """
    features = outline_features(points, views, ends_in_plane=ends_in_plane)
    above = packaged_outline_scorer(of_captures=captured)(features) - DOUBTED_FROM
    lost = (_LOGITS_PER_SCORE * above).clip(0.0, MOST_LOGITS)
    target = np.array(views.target, np.float32)
    points, places = (np.asarray(x - target, np.float32) for x in (points, places))
    doubts = np.zeros(len(places), np.float32)
    for view, logits in zip(views_at(views.radius), lost, strict=True):
        if logits > 0:
            doubts = np.maximum(doubts, logits * view.beside(points, places, SIDE_PX, _BESIDE_PX))
    return doubts


def outline_features(
    points: Float32Array,  # [N, 3] P, object frame
    views: ViewDistribution,
    *,
    ends_in_plane: bool,
) -> Float32Array:  # [V, F]
    """Return what the scorer reads of each view of the grid; columns as ``FEATURES``."""
    chosen = every_nth(points, _POINTS) - np.array(views.target)
    grid = views_at(views.radius)
    if len(chosen) <= _NEIGHBOURS:
        return np.zeros((len(grid), len(FEATURES)), np.float32)
    surface = _Surface(chosen.astype(np.float32))
    rows = [surface.seen_from(view) for view in grid]
    local, seen = np.array([row for row, _ in rows], np.float32), np.stack([s for _, s in rows])
    local[:, -1] /= local[:, -1].max()
    best = int(local[:, 0].argmax())
    place = _of_place(surface, grid, views, seen, best, ends_in_plane)
    return np.concatenate([local, place, *_around(local, best)], axis=1)


class _Surface:
    """P's points, which way their surface faces, and which are on a rim."""

    def __init__(self, points: Float32Array) -> None:  # [N, 3]
        self.points = points
        _, index = cKDTree(points).query(points, k=_NEIGHBOURS + 1)
        around = points[index[:, : _NORMAL_NEIGHBOURS + 1]].astype(np.float64)
        self.normals = normals_of(around).astype(np.float32)
        self.on_rim: Mask = one_sidedness(points[index[:, 1:]] - points[:, None]) > ON_RIM

    def seen_from(self, view: View) -> tuple[list[float], Mask]:  # [len(OF_VIEW)], [N]
        """Return the features of one view, with the area in pixels, and which points are seen."""
        pixel, depth = view.pixels(self.points)
        seen = depth < _nearest(pixel, depth)[pixel] + _SEEN_DEPTH
        behind = -depth < _nearest(pixel, -depth)[pixel] + _SEEN_DEPTH
        covered = outline(pixel)
        edge = seen & ~minimum_filter(covered, _EDGE_PX).ravel()[pixel]
        cosine = np.abs(self.normals @ view.toward)
        facing, rim = cosine > _FACING, self.on_rim
        row = [
            seen.mean(),
            behind.mean(),
            (seen & behind).mean(),
            _share(cosine, edge),
            _share(facing, edge),
            _share(rim, edge),
            _share(rim & facing, edge),
            _share(rim & ~facing, edge),
            _share(cosine, seen),
            _share(rim, seen),
            covered.sum(),
        ]
        return [float(value) for value in row], seen


def _nearest(pixel: IntArray, depth: Float32Array) -> Float32Array:  # [N], [N] -> [P]
    """Return the least depth over every pixel and its eight neighbours."""
    nearest = np.full(SIDE_PX**2, np.inf, np.float32)
    np.minimum.at(nearest, pixel, depth)
    return minimum_filter(nearest.reshape(SIDE_PX, SIDE_PX), 3).ravel()


def _share(values: NDArray[np.generic], among: Mask) -> float:  # [N], [N]
    """Return the mean of values among some; 0 among none."""
    return float(values[among].mean()) if among.any() else 0.0


def _of_place(
    surface: _Surface,
    grid: list[View],
    views: ViewDistribution,
    seen: Mask,  # [V, N]
    best: int,
    ends_in_plane: bool,
) -> Float32Array:  # [V, len(OF_PLACE)]
    """Return features of where views are and of P as a whole; columns as ``OF_PLACE``."""
    toward = np.stack([view.toward for view in grid])
    c = math.radians(views.azimuth_deg)
    sides = np.ptp(surface.points, axis=0)
    right, _, along = (axes @ surface.points.T for axes in np.stack([v.axes for v in grid], axis=1))
    columns = (
        toward[:, 2],
        toward[:, 0] * math.cos(c) + toward[:, 1] * math.sin(c),
        toward @ toward[best],
        seen.mean(),
        surface.on_rim.mean(),
        sides.min() / max(float(sides.max()), 1e-12),
        *(_seen_within(seen, reach) for reach in _UNIONS),
        np.ptp(right, axis=1),
        np.ptp(along, axis=1),
        ends_in_plane,
    )
    shape = len(grid)
    return np.stack([np.broadcast_to(np.float32(x), shape) for x in columns], axis=1)


def _seen_within(seen: Mask, reach: int) -> Float32Array:  # [V, N] -> [V]
    """Return the share of points seen from each view or from one at most ``reach`` steps aside."""
    rings = seen.reshape(len(ELEVATIONS_DEG), AZIMUTHS, -1)
    union = rings.copy()
    for step in range(1, reach + 1):
        union |= np.roll(rings, step, axis=1) | np.roll(rings, -step, axis=1)
    return union.mean(axis=2).ravel()


def _around(local: Float32Array, best: int) -> list[Float32Array]:  # [V, L] -> each [V, L]
    """Return the features of other views that go with each view, in the order of ``_AROUND``."""
    rings = local.reshape(len(ELEVATIONS_DEG), AZIMUTHS, -1)
    found = []
    for step in _STEPS:
        one, other = np.roll(rings, step, axis=1), np.roll(rings, -step, axis=1)
        found += [np.minimum(one, other), np.maximum(one, other)]
    found.append(np.roll(rings, AZIMUTHS // 2, axis=1))
    flat = [ring.reshape(local.shape) for ring in found]
    for row in (local[best], local.min(axis=0), local.max(axis=0), local.mean(axis=0)):
        flat.append(np.broadcast_to(row, local.shape))
    return flat
