"""What lies beside P as its scanner saw it: nothing of the object does.

A part that one view shows nearly all of was scanned from there, or from somewhere beside. From that
view the object's silhouette is P's. Which view it was is not known for sure, so a place counts as
beside P only where every view that may have been the scanner's finds it there. Parts that no view
shows have no such view: cut objects show their insides, too.

Conventions
-----------
* Views are at V's distance and look at its target; pictures are planes through the target.
* Depth cameras lose dark surfaces: what lies beside P is unlikely, not impossible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from gscomplete.shape.voxels import FloatArray
from gscomplete.views import ViewDistribution

_MOST_POINTS = 2000
_AZIMUTH_STEP_DEG = 10.0
_ELEVATIONS_DEG = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0)
_SHOWN_PX, _SEEN_DEPTH = 77, 0.05
"""Of a picture that tells how much of P a view shows; what is this near behind the nearest of a
pixel is seen, object sizes."""
_LEAST_SHOWN = 0.965
"""Share of P that the scanner's view shows ..."""
_NEARLY_AS_MUCH = 0.02
"""... and how much less another may show that may have been the scanner's as well."""
_MOST_VIEWS = 60
"""Of 288. Flat parts show all of themselves to more: most of them are no scans ..."""
_STEEP = 0.85
"""... and nor are those, such as plates, that show all of themselves from this height, a sine."""
_HALF_WIDTH = 0.9
"""Of a picture, object sizes."""
_SILHOUETTE_PX, _GROWN_PX = 128, 5
"""Side of a picture of P's silhouette, and of the square that each of its pixels grows to."""


@dataclass(frozen=True, slots=True)
class _View:
    """A view as axes: to the right, up, and towards the viewer."""

    axes: FloatArray  # [3, 3]
    distance: float

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return where points [N, 3] about the target are in the picture, and how far away."""
        right, up, toward = self.axes @ points.T
        depth = self.distance - toward
        scale = self.distance / np.maximum(depth, 1e-3)
        return right * scale, up * scale, depth

    def pixels(self, points: FloatArray, size_px: int) -> tuple[NDArray[np.intp], FloatArray]:
        """Return the pixels [N] of points, numbered row by row, and how far away they are."""
        x, y, depth = self.project(points)
        column, row = (
            ((v + _HALF_WIDTH) * (size_px / (2 * _HALF_WIDTH))).clip(0, size_px - 1).astype(np.intp)
            for v in (x, y)
        )
        return row * size_px + column, depth

    def shown(self, points: FloatArray) -> float:
        """Return the share of points [N, 3] that no others hide."""
        pixel, depth = self.pixels(points, _SHOWN_PX)
        nearest = np.full(_SHOWN_PX**2, np.inf)
        np.minimum.at(nearest, pixel, depth)
        return float((depth < nearest[pixel] + _SEEN_DEPTH).mean())

    def beside(self, points: FloatArray, places: FloatArray) -> NDArray[np.bool_]:
        """Return which of the places [M, 3] are beside the silhouette of points [N, 3]."""
        covered = np.zeros(_SILHOUETTE_PX**2, np.bool_)
        covered[self.pixels(points, _SILHOUETTE_PX)[0]] = True
        grown = maximum_filter(covered.reshape(_SILHOUETTE_PX, -1), _GROWN_PX)
        return ~grown.ravel()[self.pixels(places, _SILHOUETTE_PX)[0]]


def beside_scan(
    points: FloatArray,  # [N, 3] P, object frame
    views: ViewDistribution,
    places: FloatArray,  # [M, 3]
) -> NDArray[np.bool_]:  # [M]
    """Mark places beside P from every view that may have been its scanner's; none if none may.

    Args:
        points: P's splats.
        views: V, whose distance and target count.
        places: which are asked about.
    """
    target = np.array(views.target, np.float32)
    points, places = points - target, places - target
    few = points[:: max(1, -(-len(points) // _MOST_POINTS))]
    tried = [(view.shown(few), view) for view in _views_about(views.radius)]
    most = max(share for share, _ in tried)
    maybe = [view for share, view in tried if share >= most - _NEARLY_AS_MUCH]
    is_flat = len(maybe) > _MOST_VIEWS or any(view.axes[2, 2] > _STEEP for view in maybe)
    beside = np.full(len(places), most >= _LEAST_SHOWN and not is_flat)
    for view in maybe:
        if not beside.any():
            break
        beside[beside] = view.beside(points, places[beside])
    return beside


def _views_about(distance: float) -> list[_View]:
    """Return views from all sides and from above."""
    found = []
    for elevation in np.deg2rad(_ELEVATIONS_DEG):
        for azimuth in np.deg2rad(np.arange(0.0, 360.0, _AZIMUTH_STEP_DEG)):
            level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
            right = np.array([-level[1], level[0], 0.0])
            toward = np.cos(elevation) * level + [0.0, 0.0, np.sin(elevation)]
            axes = np.stack([right, np.cross(toward, right), toward]).astype(np.float32)
            found.append(_View(axes, distance))
    return found
