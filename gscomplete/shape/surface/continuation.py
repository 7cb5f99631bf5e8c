"""Find where P's surface, continued along arcs, crosses the way into a predicted surface.

Much of what P lacks continues what P has: a wall, a table top, the side of a bottle. There P's
splats show where the true surface is, more exactly than the network's cells do.

Conventions
-----------
* Depths are in cells, measured inward along the normal of a point of the predicted surface.
* Two points of a circle have normals that make equal angles with their chord. So from one of P's
  splats, a circle (or a line) reaches that place on the way in from which the chord to the splat is
  square to the sum of both normals. On planes, balls and cylinders this is the exact place.
* Normals of splats are of either sign; that which faces like the predicted surface counts.
* Arithmetic is float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gscomplete.shape.voxels import CELL_SIDE, FloatArray
from gscomplete.splats.geometry.neighbourhood import normals_at
from gscomplete.util.kernels import KERNEL, run_kernel

_FIRST, _STEP = -2.0, 0.5
CROSSING_DEPTHS = tuple(_FIRST + _STEP * k for k in range(13))
"""Depths between which crossings are shared out in proportion."""
_REACH = 0.14
"""Splats count by the cosine between the normals, and by a Gaussian of their distance of this
standard deviation, object sizes."""
_FARTHEST = 0.45
"""Splats farther away do not count; the distance of the nearest one if none counts."""
_SPLATS = 800
"""Most splats of P that are continued."""
_FEW = 1e-2
"""Counts are told by their logarithms, and this is added to them."""
_GRAIN = 500
"""Fewest points for which handing work to another thread saves time."""
_MOST_DEPTH = len(CROSSING_DEPTHS)
_MOST, _NEAREST_DEPTH, _NEAREST_DISTANCE, _NEAREST_COSINE = (_MOST_DEPTH + k for k in range(1, 5))
CROSSINGS = (
    *(f"at_{depth}" for depth in CROSSING_DEPTHS),
    "most_depth",
    "most",
    "nearest_depth",
    "nearest_distance",
    "nearest_cosine",
)
"""Columns of ``crossings``: how many splats are continued to each depth, to which depth most are,
how many to there, and of the nearest splat its depth, distance and cosine. Splats that are
continued beyond ``CROSSING_DEPTHS`` do not count."""


@dataclass(frozen=True, slots=True)
class OrientedPoints:
    """Some of P's splats."""

    points: NDArray[np.float64]  # [M, 3]
    normals: NDArray[np.float64]  # [M, 3] unit, of either sign

    @classmethod
    def of(cls, points: FloatArray) -> OrientedPoints:  # [N, 3]
        """Draw some of P's splats at random."""
        places = points.astype(np.float64)
        drawn = np.random.default_rng(0).permutation(len(places))[:_SPLATS]
        chosen = places[np.sort(drawn)]
        return cls(chosen, normals_at(chosen, places, cKDTree(places)))


def crossings(
    points: FloatArray,  # [N, 3]
    normals: FloatArray,  # [N, 3] outward
    splats: OrientedPoints,
) -> FloatArray:  # [N, C]
    """Return where P's surface crosses the way inside points of a surface, as ``CROSSINGS``."""
    found = np.zeros((len(points), len(CROSSINGS)))
    arrays = (points, normals, splats.points, splats.normals)
    given = (np.ascontiguousarray(array, np.float64) for array in arrays)
    run_kernel(count_crossings, len(points), _GRAIN, *given, found)
    return found.astype(np.float32)


@numba.njit(**KERNEL)
def count_crossings(
    first: int,
    last: int,
    points: NDArray[np.float64],  # [N, 3]
    normals: NDArray[np.float64],  # [N, 3]
    places: NDArray[np.float64],  # [M, 3]
    facing: NDArray[np.float64],  # [M, 3]
    found: NDArray[np.float64],  # [N, C] zeros
) -> None:
    """Fill the rows of the points from ``first`` up to ``last``."""
    depths = len(CROSSING_DEPTHS)
    squares, reached, cosines = np.empty((3, len(places)))
    for i in range(first, last):
        row = found[i]
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        u, v, w = normals[i, 0], normals[i, 1], normals[i, 2]
        for j in range(len(places)):  # without branches, so that it is vectorised
            a, b, c = facing[j, 0], facing[j, 1], facing[j, 2]
            dx, dy, dz = x - places[j, 0], y - places[j, 1], z - places[j, 2]
            cosine = u * a + v * b + w * c
            along = math.copysign(1.0, cosine) * (dx * a + dy * b + dz * c)
            along += dx * u + dy * v + dz * w
            cosines[j] = abs(cosine)
            reached[j] = (along / ((1.0 + abs(cosine)) * CELL_SIDE) - _FIRST) / _STEP
            squares[j] = dx * dx + dy * dy + dz * dz
        nearest = _FARTHEST * _FARTHEST
        for j in range(len(places)):
            place, squared = reached[j], squares[j]
            if squared > _FARTHEST * _FARTHEST or not 0.0 <= place <= depths - 1.0:
                continue
            weight = cosines[j] * math.exp(-0.5 * squared / (_REACH * _REACH))
            low = min(int(place), depths - 2)
            row[low] += (1.0 - place + low) * weight
            row[low + 1] += (place - low) * weight
            if squared < nearest:
                nearest = squared
                row[_NEAREST_DEPTH] = _FIRST + _STEP * place
                row[_NEAREST_COSINE] = cosines[j]
        row[_NEAREST_DISTANCE] = math.sqrt(nearest)
        most = 0
        for k in range(depths):
            if row[k] > row[most]:
                most = k
        total, moment = 0.0, 0.0
        for k in range(max(most - 1, 0), min(most + 2, depths)):
            total += row[k]
            moment += row[k] * (_FIRST + _STEP * k)
        row[_MOST_DEPTH] = moment / total if total > 0.0 else 0.0
        row[_MOST] = math.log(_FEW + total)
        for k in range(depths):
            row[k] = math.log(_FEW + row[k])
