"""How much of P one view shows: a scan has what one view shows, half an object its inside, too."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_MOST_POINTS = 6000
_ELEVATIONS_DEG = (0.0, 15.0, 30.0, 45.0)
_STEP_DEG, _SIZE_PX = 20.0, 48
_SEEN_DEPTH = 0.06
"""What is this near behind the nearest of a pixel is seen, in sides of P."""


def best_view_share(points: NDArray[np.floating]) -> float:  # [N, 3] z up, in [0, 1]
    """Return how much of P is seen from where most of it is, by parallel rays."""
    if not len(points):
        return 1.0
    chosen = points[:: max(1, -(-len(points) // _MOST_POINTS))]
    side = max(float(np.ptp(points, axis=0).max()), 1e-12)
    best = 0.0
    for elevation in np.deg2rad(_ELEVATIONS_DEG):
        for azimuth in np.deg2rad(np.arange(0.0, 360.0, _STEP_DEG)):
            right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
            level = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
            toward = level * math.cos(elevation) + (0.0, 0.0, math.sin(elevation))
            x, y, near = (chosen @ axis for axis in (right, np.cross(toward, right), toward))
            cell = max(float(np.ptp(x)), float(np.ptp(y)), 1e-12) / _SIZE_PX * (1 + 1e-9)
            column, row = ((v - v.min()) // cell for v in (x, y))
            pixel = (row * _SIZE_PX + column).astype(np.int64)
            nearest = np.full(_SIZE_PX**2, -np.inf)
            np.maximum.at(nearest, pixel, near)
            best = max(best, float((near > nearest[pixel] - _SEEN_DEPTH * side).mean()))
    return best
