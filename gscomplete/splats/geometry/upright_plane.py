"""Upright planes: mirroring through them, and their fit to the edge where points end.

Conventions
-----------
* z is up, so that normals are horizontal; an azimuth in degrees says where they point.
* Lengths are in the unit of the points given; limits are in sides of their box.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gscomplete.util.arrays import Float64Array

_NEAR, _FEWEST_NEAR = 0.012, 16
"""Points this near to a plane are at its edge; so many are needed to tell where it is."""
_STRIPS, _FEWEST_STRIPS, _LEAST_EDGE = 40, 8, 0.1
"""The edge is divided into so many strips. At least so many have to hold points, and it has to be
so long."""
_FITS, _REWEIGHTINGS = 4, 8
_MOST_TURNED_DEG = 6.0
"""A plane that its edge turns further is left as it is."""


@dataclass(frozen=True, slots=True)
class UprightPlane:
    """The points x with ``normal . x = offset``."""

    azimuth_deg: float
    """Azimuth of its normal, which points to the side that was cut away."""
    offset: float

    @property
    def normal(self) -> Float64Array:  # [3]
        """Unit normal, which is horizontal."""
        angle = math.radians(self.azimuth_deg)
        return np.array([math.cos(angle), math.sin(angle), 0.0])

    def mirrored(self, points: Float64Array) -> Float64Array:  # [N, 3] -> [N, 3]
        """Mirror points through the plane."""
        return points + 2 * (self.offset - points @ self.normal)[:, None] * self.normal


def fitted_to_edge(points: Float64Array, plane: UprightPlane) -> UprightPlane:  # [N, 3]
    """Fit the plane that P was cut along to the outermost points along it.

    They lie up to a spacing inside the cut, so a mirror image overlaps P a little and leaves no
    slit along it.

    Args:
        points: centres of P's splats, z up, in any unit.
        plane: the plane, roughly.

    Returns:
        The plane where P ends; ``plane`` itself if too little of P is near it to tell.
    """
    side = max(float(np.ptp(points, axis=0).max()), 1e-12)
    found = plane
    for _ in range(_FITS):
        normal = found.normal
        along, across = points @ normal, points @ np.array([-normal[1], normal[0], 0.0])
        near = np.abs(along - found.offset) < _NEAR * side
        if near.sum() < _FEWEST_NEAR:
            return plane
        low, reach = across[near].min(), float(np.ptp(across[near]))
        if reach < _LEAST_EDGE * side:
            return plane
        strip = np.minimum(((across[near] - low) / reach * _STRIPS).astype(int), _STRIPS - 1)
        order = np.lexsort((along[near], strip))
        strip, depth, place = strip[order], along[near][order], across[near][order]
        last = np.append(np.flatnonzero(np.diff(strip)), len(strip) - 1)
        if len(last) < _FEWEST_STRIPS:
            return plane
        slope, offset = _robust_line(place[last], depth[last], 1e-4 * side)
        turn = math.atan(slope)
        found = UprightPlane(found.azimuth_deg - math.degrees(turn), offset * math.cos(turn))
    turned_deg = (found.azimuth_deg - plane.azimuth_deg + 180.0) % 360.0 - 180.0
    if abs(turned_deg) > _MOST_TURNED_DEG:
        return plane
    return UprightPlane(found.azimuth_deg % 360.0, found.offset)


def _robust_line(x: Float64Array, y: Float64Array, least: float) -> tuple[float, float]:
    """Return slope and value at 0 of the line through most points [K].

    Args:
        x: places.
        y: values.
        least: deviations up to this one count as none.
    """
    weight = np.ones(len(x))
    for _ in range(_REWEIGHTINGS):
        columns = np.stack([x, np.ones(len(x))], axis=1) * weight[:, None]
        (slope, value), *_ = np.linalg.lstsq(columns, y * weight)
        off = np.abs(y - (slope * x + value))
        weight = 1 / np.sqrt(1 + (off / (2 * max(float(np.median(off)), least))) ** 2)
    return float(slope), float(value)
