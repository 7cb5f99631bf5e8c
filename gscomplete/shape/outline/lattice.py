"""Places off the bars of a lattice: what shows through a fence or a ladder is nothing of it.

At the size of the network's cells a lattice is nearly a wall, and the network makes one of it.
Where, of the views about c, the one with P's largest outline has several holes, these are much of
what the outline encloses, and c has some, too, the holes are the object's own. From elsewhere what
no scanner saw looks like holes.

Conventions
-----------
* Views are along parallel rays; P is given about the middle of its box, whose largest side is 1.
* Gaps no wider than those between P's samples, where these are sparsest, are no holes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, label, maximum_filter, minimum_filter
from scipy.spatial import cKDTree

from gscomplete.shape.outline.views import Mask, axes_of_views
from gscomplete.shape.voxels import FloatArray

_STEP_DEG, _ELEVATIONS_DEG = 15.0, tuple(range(-80, 81, 20))
_LEAST_COSINE = 0.75
"""Between a view and c."""
_POINTS = 8000
"""Drawn to find the view."""
_PX_PER_SIDE, _PICTURE_PX = 133, 240
"""A picture has room for a cube's diagonal."""
_LEAST_CLOSED_PX, _MOST_CLOSED_PX = 5, 41
_NEIGHBOUR, _SPARSE = 4, 0.98
"""A gap between samples is as wide as twice the distance to this neighbour, nearly everywhere."""
_ASKED = 2000
"""Points whose neighbours are looked for."""
_RIM_PX = 3
"""Side of the square that an outline's pixels grow to."""
_SMALLEST_PX = 8
"""Area of a hole."""
_FEWEST_HOLES, _LARGEST = 3, 0.5
"""Of a lattice, and the share of them that one may be: a table's top that is missing is more."""
_LEAST_SHARE, _LEAST_SHARE_FROM_C = 0.2, 0.1
"""Of holes in what a lattice's outline encloses: a scan of a plate has up to .18."""


def off_lattice(
    points: FloatArray,  # [N, 3] P, z up
    toward_c: FloatArray,  # [3] unit
    places: FloatArray,  # [M, 3] in the same frame
    *,
    is_scan: bool,
) -> Mask:  # [M]
    """Mark places off P's bars if it is a lattice; none if it is not.

    Args:
        points: P.
        toward_c: from the object to the input view.
        places: which are asked about.
        is_scan: one view shows P, which was not cut: what lies beside its outline is marked, too.
    """
    if not len(points):
        return np.zeros(len(places), np.bool_)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, side = (low + high) / 2, max(float((high - low).max()), 1e-12)
    points, places = (points - middle) / side, (places - middle) / side
    views = axes_of_views(_STEP_DEG, _ELEVATIONS_DEG).astype(np.float32)
    cosines = views[:, 2] @ toward_c
    closed_px = _gap_px(points)
    from_c = _outline(_picture(points, views[cosines.argmax()]), closed_px)
    axes = _broadest(points, views[cosines >= _LEAST_COSINE])
    outline = _outline(_picture(points, axes), closed_px)
    holes, share = _holes(outline)
    if share < _LEAST_SHARE or _holes(from_c)[1] < _LEAST_SHARE_FROM_C:
        return np.zeros(len(places), np.bool_)
    marked = ~maximum_filter(outline, _RIM_PX) if is_scan else holes
    found: Mask = marked[_pixels(places, axes)]
    return found


def _broadest(points: FloatArray, views: FloatArray) -> FloatArray:  # [N, 3], [V, 3, 3] -> [3, 3]
    """Return the axes of the view in which P covers most."""
    few = points[:: max(1, -(-len(points) // _POINTS))]
    best: FloatArray = max(views, key=lambda axes: int(_picture(few, axes).sum()))
    return best


def _picture(points: FloatArray, axes: FloatArray) -> Mask:  # [N, 3], [3, 3] -> [P, P]
    """Return where points are seen."""
    picture = np.zeros((_PICTURE_PX,) * 2, np.bool_)
    picture[_pixels(points, axes)] = True
    return picture


def _pixels(
    points: FloatArray,  # [N, 3]
    axes: FloatArray,  # [3, 3]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:  # rows, columns [N]; outside: on the border
    """Return the pixels of points."""
    right, up = (_PICTURE_PX / 2 + _PX_PER_SIDE * (axes[:2] @ points.T)).clip(0, _PICTURE_PX - 1)
    return up.astype(np.int64), right.astype(np.int64)


def _outline(picture: Mask, closed_px: int) -> Mask:  # [P, P]
    """Return where P is seen, without the gaps between its samples."""
    outline: Mask = minimum_filter(maximum_filter(picture, closed_px), closed_px)
    return outline


def _gap_px(points: FloatArray) -> int:  # [N, 3]
    """Return how wide gaps between samples are, in pixels."""
    asked = points[:: max(1, -(-len(points) // _ASKED))]
    distance, _ = cKDTree(points).query(asked, k=[min(_NEIGHBOUR + 1, len(points))])
    gap = 2.0 * _PX_PER_SIDE * float(np.quantile(distance, _SPARSE))
    return round(min(max(gap, _LEAST_CLOSED_PX), _MOST_CLOSED_PX))


def _holes(outline: Mask) -> tuple[Mask, float]:  # [P, P]
    """Return holes, and their share of what the outline encloses; 0 where they are no lattice's."""
    whole = binary_fill_holes(outline)
    numbers, count = label(whole & ~outline)
    areas = np.bincount(numbers.ravel(), minlength=count + 1)
    areas[0] = 0
    areas[areas < _SMALLEST_PX] = 0
    holes: Mask = areas[numbers] > 0
    is_lattice = (areas > 0).sum() >= _FEWEST_HOLES and areas.max() <= _LARGEST * areas.sum()
    return holes, float(areas.sum() / whole.sum()) if is_lattice else 0.0
