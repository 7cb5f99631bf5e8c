"""Find the patch of table or floor that a part of an object still stands on.

A capture that was cut out of a scene often keeps some of what is below the object: one level layer
at its lowest place, which reaches beyond what stands on it and ends where it was cut.

Conventions
-----------
* Points are z-up, in any unit. Lengths are shares of the largest side of the points' box, outlying
  points left out.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from gscomplete.util.arrays import BoolArray, Float64Array

_FEWEST = 300
"""Of fewer points no table is told apart."""
_BOX_QUANTILES, _LOWEST_QUANTILE = (0.005, 0.995), 0.002
_LOWEST = 0.03
"""The layer is the densest one within this height above the lowest points."""
_LAYER, _AROUND = 0.006, 0.03
"""Heights of the layer, and of what is compared with it, the layer in its middle."""
_CONCENTRATED = 0.6
"""Least share of the latter's points that lie in the layer, nearly: feet and walls are spread."""
_TABLE = 0.024
"""Height of the slab about the layer that is table."""
_NEXT = 0.024
"""Height of the slab above it; ..."""
_TIMES_NEXT = 2.0
"""... the table has at least so many times its points."""
_ABOVE, _FEWEST_ABOVE = 0.03, 50
"""Points this far above the layer stand on it."""
_BEYOND = 0.03
"""A point of the table reaches beyond what stands on it if it is outside its convex outline from
above, and this far from all of it."""
_FEWEST_BEYOND = 0.01
"""Least share of all points that reach beyond."""


def table_rows(points: Float64Array) -> BoolArray:  # [N, 3] -> [N]
    """Mark the points of the table that an object stands on; none if there is no such table."""
    nothing = np.zeros(len(points), np.bool_)
    if len(points) < _FEWEST:
        return nothing
    low, high = np.quantile(points, _BOX_QUANTILES, axis=0)
    size = float((high - low).max())
    if not size > 0:
        return nothing
    heights = (points[:, 2] - np.quantile(points[:, 2], _LOWEST_QUANTILE)) / size
    height = _densest(np.sort(heights[heights < _LOWEST]))
    off = heights - height
    table = np.abs(off) < _TABLE / 2
    beside = np.count_nonzero(np.abs(off) < _AROUND / 2)
    layer = np.count_nonzero(np.abs(off) < 0.8 * _LAYER)
    follows = np.count_nonzero((off > _TABLE / 2) & (off < _TABLE / 2 + _NEXT))
    if layer < _CONCENTRATED * beside or table.sum() < _TIMES_NEXT * follows:
        return nothing
    standing = points[off > _ABOVE, :2] / size
    if len(standing) < _FEWEST_ABOVE:
        return nothing
    reaching = _beyond(points[table, :2] / size, standing)
    return table if reaching.sum() >= _FEWEST_BEYOND * len(points) else nothing


def _densest(heights: Float64Array) -> float:  # [M] increasing
    """Return the middle of the densest layer."""
    counts = np.searchsorted(heights, heights + _LAYER) - np.arange(len(heights))
    start = int(counts.argmax())
    return float(np.median(heights[start : start + counts[start]]))


def _beyond(places: Float64Array, standing: Float64Array) -> BoolArray:  # [M, 2], [K, 2] -> [M]
    """Mark places outside the convex outline of others and far from all of them."""
    away, _ = cKDTree(standing).query(places, distance_upper_bound=_BEYOND)
    is_far = ~np.isfinite(away)
    try:
        sides = ConvexHull(standing).equations  # [S, 3] outward normal and offset
    except QhullError:  # all on one line
        return is_far
    outside = np.einsum("mi,si->ms", places, sides[:, :2]) + sides[:, 2]
    return np.asarray(is_far & (outside.max(axis=1) > 0))
