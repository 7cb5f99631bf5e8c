"""Find places between the bars of a lattice, such as a fence or a ladder, which must stay empty.

At the size of the network's cells a lattice is nearly a wall, and the network completes it to one.
P is taken for a lattice if, in the view near c in which its outline is largest, it has several
holes that make up much of the area that the outline encloses, and if c shows some holes too. Views
far from c do not count: from there, what no scanner saw looks like holes.

Many holes are narrower than cells. So the splats that cover the network's surface are left out
where most views near c see through P, if these show enough holes on average.

Conventions
-----------
* Views are orthographic; P is moved and scaled so that its box is centred and its largest side 1.
* Gaps up to the width of those between P's samples, where these are sparsest, are not holes.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label, maximum_filter, minimum_filter
from scipy.spatial import cKDTree

from gscomplete.shape.outline.views import Mask, axes_of_views
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import Float32Array, IntArray

_STEP_DEG, _ELEVATIONS_DEG = 15.0, tuple(range(-80, 81, 20))
_LEAST_COSINE = 0.75
"""Least cosine between the directions of a view and of c for the view to count as near c."""
_POINTS = 8000
"""About how many points are drawn to find the view with the largest outline."""
_PX_PER_SIDE, _PICTURE_PX = 133, 240
"""Pixels per side of P, and of a whole picture, which has room for a cube's diagonal."""
_LEAST_CLOSED_PX, _LEAST_CLOSED_THROUGH_PX, _MOST_CLOSED_PX = 5, 3, 41
"""Bounds of the width up to which gaps are closed; the second is that of ``seen_through``."""
_NEIGHBOUR, _SPARSE = 4, 0.98
"""That width is twice the distance to this neighbour, at this quantile over P's points."""
_ASKED = 2000
"""About how many points that quantile is taken over."""
_RIM_PX = 3
"""Width of the square by which a scan's outline is grown before places off it are marked."""
_SMALLEST_PX = 8
"""Least area of a hole, pixels."""
_FEWEST_HOLES, _LARGEST = 3, 0.5
"""A lattice has at least so many holes, and the largest of them has at most this share of their
area; the hole of a missing table top has more."""
_LEAST_SHARE, _LEAST_SHARE_FROM_C = 0.2, 0.1
"""Least share of holes in the area that a lattice's outline encloses, in the view with the largest
outline and in that from c. A scan of a plate reaches .18."""
_THROUGH_STEP_DEG, _THROUGH_ELEVATIONS_DEG = 15.0, tuple(range(-60, 61, 20))
_LEAST_MEAN_SHARE, _LEAST_VIEWS = 0.1, 0.5
"""Least share of holes, on average over the views near c, and least share of these views that see
through P at a place that is to stay empty."""
_FIRST_VIEWS = 5
"""If so many of the nearest views to c show no holes, the others are not looked at."""


def off_lattice(
    points: Float32Array,  # [N, 3] P, z up
    toward_c: Float32Array,  # [3] unit
    places: Float32Array,  # [M, 3] in the same frame
    *,
    is_scan: bool,
) -> Mask:  # [M]
    """Mark the places between P's bars if P is a lattice; mark none otherwise.

    Args:
        points: P's points.
        toward_c: direction from the object to the input view.
        places: points to be marked or not.
        is_scan: whether P is a scan from one view, not cut; then places outside P's outline are
            marked as well as those in its holes.
    """
    if not len(points):
        return np.zeros(len(places), np.bool_)
    points, places = _centered(points, points), _centered(places, points)
    views = axes_of_views(_STEP_DEG, _ELEVATIONS_DEG).astype(np.float32)
    closed_px = _gap_px(points, _LEAST_CLOSED_PX)
    from_c = _outline(_picture(points, views[(views[:, 2] @ toward_c).argmax()]), closed_px)
    axes = _broadest(points, _near(views, toward_c))
    outline = _outline(_picture(points, axes), closed_px)
    holes, share = _holes(outline)
    if share < _LEAST_SHARE or _holes(from_c)[1] < _LEAST_SHARE_FROM_C:
        return np.zeros(len(places), np.bool_)
    marked = ~maximum_filter(outline, _RIM_PX) if is_scan else holes
    found: Mask = marked[_pixels(places, axes)]
    return found


def seen_through(
    points: Float32Array,  # [N, 3] P, z up
    toward_c: Float32Array,  # [3] unit
    places: Float32Array,  # [M, 3] in the same frame
) -> Mask:  # [M]
    """Mark the places where most views near c see through P; none if these show few holes.

    Args:
        points: P's points.
        toward_c: direction from the object to the input view.
        places: points to be marked or not.
    """
    if not len(points) or not len(places):
        return np.zeros(len(places), np.bool_)
    points, places = _centered(points, points), _centered(places, points)
    views = axes_of_views(_THROUGH_STEP_DEG, _THROUGH_ELEVATIONS_DEG).astype(np.float32)
    closed_px = _gap_px(points, _LEAST_CLOSED_THROUGH_PX)
    shares, through = [], np.zeros(len(places), np.int64)
    for axes in _near(views, toward_c):
        holes, share = _holes(_outline(_picture(points, axes), closed_px))
        shares.append(share)
        if len(shares) == _FIRST_VIEWS and not any(shares):
            return np.zeros(len(places), np.bool_)
        through += holes[_pixels(places, axes)]
    found: Mask = through >= _LEAST_VIEWS * len(shares)
    return found & (np.mean(shares) >= _LEAST_MEAN_SHARE)


def _centered(
    places: Float32Array, points: Float32Array
) -> Float32Array:  # [M, 3], [N, 3] -> [M, 3]
    """Move and scale places so that the box of the points is centred and its largest side 1."""
    low, high = points.min(axis=0), points.max(axis=0)
    return (places - (low + high) / 2) / max(float((high - low).max()), 1e-12)


def _near(
    views: Float32Array, toward_c: Float32Array
) -> Float32Array:  # [V, 3, 3], [3] -> [W, 3, 3]
    """Return the views near c, the nearest first."""
    cosines = views[:, 2] @ toward_c
    return views[np.argsort(-cosines, kind="stable")][: (cosines >= _LEAST_COSINE).sum()]


def _broadest(
    points: Float32Array, views: Float32Array
) -> Float32Array:  # [N, 3], [V, 3, 3] -> [3, 3]
    """Return the axes of the view in which P covers the most pixels."""
    few = every_nth(points, _POINTS)
    best: Float32Array = max(views, key=lambda axes: int(_picture(few, axes).sum()))
    return best


def _picture(points: Float32Array, axes: Float32Array) -> Mask:  # [N, 3], [3, 3] -> [P, P]
    """Return where points are seen."""
    picture = np.zeros((_PICTURE_PX,) * 2, np.bool_)
    picture[_pixels(points, axes)] = True
    return picture


def _pixels(
    points: Float32Array,  # [N, 3]
    axes: Float32Array,  # [3, 3]
) -> tuple[IntArray, IntArray]:  # rows, columns [N]
    """Return the pixels of points; those outside the picture are put on its border."""
    right, up = (_PICTURE_PX / 2 + _PX_PER_SIDE * (axes[:2] @ points.T)).clip(0, _PICTURE_PX - 1)
    return up.astype(np.int64), right.astype(np.int64)


def _outline(picture: Mask, closed_px: int) -> Mask:  # [P, P]
    """Return where P is seen, without the gaps between its samples."""
    outline: Mask = minimum_filter(maximum_filter(picture, closed_px), closed_px)
    return outline


def _gap_px(points: Float32Array, least_px: int) -> int:  # [N, 3]
    """Return the width up to which gaps lie between samples rather than in P, in pixels."""
    asked = every_nth(points, _ASKED)
    distance, _ = cKDTree(points).query(asked, k=[min(_NEIGHBOUR + 1, len(points))])
    gap = 2.0 * _PX_PER_SIDE * float(np.quantile(distance, _SPARSE))
    return round(min(max(gap, least_px), _MOST_CLOSED_PX))


def _holes(outline: Mask) -> tuple[Mask, float]:  # [P, P]
    """Return the holes, and their share of the enclosed area; 0 if they are not a lattice's."""
    numbers, count = label(~outline)
    areas = np.bincount(numbers.ravel(), minlength=count + 1)
    areas[0] = areas[numbers[0, 0]] = 0  # the outline itself, and what is round it
    whole = outline.sum() + areas.sum()
    areas[areas < _SMALLEST_PX] = 0
    holes: Mask = areas[numbers] > 0
    is_lattice = (areas > 0).sum() >= _FEWEST_HOLES and areas.max() <= _LARGEST * areas.sum()
    return holes, float(areas.sum() / whole) if is_lattice else 0.0
