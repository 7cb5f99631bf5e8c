"""Whether P is a scan from one view, and what lies outside its silhouette from there.

A scan consists of what one view sees. (Half an object does not: it shows its inside as well.) So if
one view shows nearly all of P, P was scanned from there or from nearby. In that view the
silhouettes of P and of the complete object are the same, and nothing lies beside P. Since the exact
view is unknown, a place counts as beside P only if it is outside P's silhouette in every view that
may have been the scanner's.

Conventions
-----------
* ``best_view_share`` uses orthographic views and lengths in units of P's largest side;
  ``beside_scan`` uses perspective views at V's distance and object sizes.
* Depth cameras miss dark surfaces: what lies beside P is unlikely, not impossible.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gscomplete.shape.outline.views import View, axes_of_views
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import BoolArray, Float32Array
from gscomplete.views import ViewDistribution

ONE_VIEW_SHARE = 0.97
"""A part of which one view shows at least this share is a scan, unless it ends in a plane."""
_SHARE_POINTS = 6000
_SHARE_STEP_DEG, _SHARE_ELEVATIONS_DEG = 20.0, (0.0, 15.0, 30.0, 45.0)
_SHARE_PX, _SHARE_DEPTH = 48, 0.06
"""Side of a picture for that share; a point is seen if it lies less than the second behind the
nearest one in its pixel, in units of P's largest side."""

_SCAN_POINTS = 2000
_SCAN_STEP_DEG = 10.0
_SCAN_ELEVATIONS_DEG = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0)
_SHOWN_PX, _SEEN_DEPTH = 77, 0.05
"""The same for finding the scanner's view, in object sizes."""
_LEAST_SHOWN = 0.965
"""Least share of P that the best view has to show for P to be a scan."""
_NEARLY_AS_MUCH = 0.02
"""Views that show at most this much less than the best may have been the scanner's as well."""
_MOST_VIEWS = 60
"""If more of the 288 views may have been the scanner's, P is flat and probably not a scan."""
_STEEP_SINE = 0.85
"""Nor is P taken for a scan if such a view's elevation has a larger sine: things such as plates
show all of themselves from above."""
_SILHOUETTE_PX, _GROWN_PX = 128, 5
"""Side of a picture of P's silhouette, and of the square that each of its pixels is grown to."""


def is_scan(shown_at_once: float, ends_in_plane: bool) -> bool:
    """Say whether P is a scan from one view, which always lacks a whole side.

    Args:
        shown_at_once: ``best_view_share`` of P's points.
        ends_in_plane: whether P was cut along a plane, as far as ``framing.cut_plane`` finds.
    """
    return not ends_in_plane and shown_at_once >= ONE_VIEW_SHARE


def best_view_share(points: NDArray[np.floating]) -> float:  # [N, 3] z up, in [0, 1]
    """Return the largest share of P that a single orthographic view shows; 1 for no points."""
    if not len(points):
        return 1.0
    chosen = every_nth(points, _SHARE_POINTS)
    side = max(float(np.ptp(points, axis=0).max()), 1e-12)
    best = 0.0
    for axes in axes_of_views(_SHARE_STEP_DEG, _SHARE_ELEVATIONS_DEG):
        x, y, near = (chosen @ axis for axis in axes)
        cell = max(float(np.ptp(x)), float(np.ptp(y)), 1e-12) / _SHARE_PX * (1 + 1e-9)
        column, row = ((v - v.min()) // cell for v in (x, y))
        pixel = (row * _SHARE_PX + column).astype(np.int64)
        nearest = np.full(_SHARE_PX**2, -np.inf)
        np.maximum.at(nearest, pixel, near)
        best = max(best, float((near > nearest[pixel] - _SHARE_DEPTH * side).mean()))
    return best


def beside_scan(
    points: Float32Array,  # [N, 3] P, object frame
    views: ViewDistribution,
    places: Float32Array,  # [M, 3]
) -> BoolArray:  # [M]
    """Mark places beside P in every view that may have been its scanner's; none if P is no scan.

    Args:
        points: centres of P's splats.
        views: V, whose distance and target are used.
        places: points to be marked or not, object frame.
    """
    target = np.array(views.target, np.float32)
    points, places = points - target, places - target
    few = every_nth(points, _SCAN_POINTS)
    every = axes_of_views(_SCAN_STEP_DEG, _SCAN_ELEVATIONS_DEG)
    found = (View(axes.astype(np.float32), views.radius) for axes in every)
    tried = [(_shown(view, few), view) for view in found]
    most = max(share for share, _ in tried)
    maybe = [view for share, view in tried if share >= most - _NEARLY_AS_MUCH]
    is_flat = len(maybe) > _MOST_VIEWS or any(view.toward[2] > _STEEP_SINE for view in maybe)
    beside = np.full(len(places), most >= _LEAST_SHOWN and not is_flat)
    for view in maybe:
        if not beside.any():
            break
        beside[beside] = view.beside(points, places[beside], _SILHOUETTE_PX, _GROWN_PX)
    return beside


def _shown(view: View, points: Float32Array) -> float:
    """Return the share of points [N, 3] that no other points hide."""
    pixel, depth = view.pixels(points, _SHOWN_PX)
    nearest = np.full(_SHOWN_PX**2, np.inf)
    np.minimum.at(nearest, pixel, depth)
    return float((depth < nearest[pixel] + _SEEN_DEPTH).mean())
