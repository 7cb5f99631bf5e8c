"""Points about an axis: radius, azimuth and height, and which belong to what turns about it.

Conventions
-----------
* The axis is upright or nearly so, z up.
* In axis coordinates the axis is the z axis. A point has a radius, an azimuth and a height there,
  and its normal a radial, a tangential and an upward part.
* Lengths are in sides of P's box or, of P in the object frame, in object sizes: limits are the same
  numbers for both. Arithmetic is float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gscomplete.splats.rotations import turn_onto_z
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import BoolArray, Float64Array, IntArray

STEEP = 0.3
"""Only normals whose horizontal part is larger than this tell where the axis is."""
OFF, OFF_SINE = 0.015, 0.2
"""A normal meets the axis if its line passes within the first, or within the second of the point's
radius: normals of noisy surfaces are off by an angle."""
_CELL, SECTORS = 0.04, 36
"""Where P goes round the axis is counted in cells of radius and height and in sectors."""
_LEAST_ROUND = 0.35
"""What P shows in fewer sectors than this share of the median is no part of the body: a handle."""
_FEWEST_SECTORS = 4
_FEWEST_POINTS = 200
NEAR_AXIS = 0.03
"""Within this radius every point belongs to the body."""
_BODY_OFF = 1.3
"""Normals of the body may pass the axis by this factor more than ``OFF`` and ``OFF_SINE``."""


@dataclass(frozen=True, slots=True)
class Axis:
    """A line that points upward."""

    point: Float64Array  # [3] on the axis
    direction: Float64Array  # [3] unit
    rotation: Float64Array  # [3, 3] takes the direction to +z

    @classmethod
    def through(cls, point: Float64Array, direction: Float64Array) -> Axis:
        """Return the axis through a point along a direction."""
        unit = direction / np.linalg.norm(direction)
        return cls(point, unit, turn_onto_z(unit))

    def to_axis(self, points: Float64Array) -> Float64Array:  # [N, 3] -> [N, 3]
        """Return points in axis coordinates."""
        return (points - self.point) @ self.rotation.T

    def from_axis(self, points: Float64Array) -> Float64Array:  # [N, 3] -> [N, 3]
        """Return points of axis coordinates."""
        return points @ self.rotation + self.point


@dataclass(frozen=True, slots=True)
class Turning:
    """Oriented points in axis coordinates."""

    points: Float64Array  # [N, 3]
    normals: Float64Array  # [N, 3] of either sign
    radius: Float64Array  # [N]
    azimuth_rad: Float64Array  # [N]
    radial: Float64Array  # [N] part of the normal
    tangential: Float64Array  # [N] part of the normal

    @classmethod
    def about(cls, axis: Axis, points: Float64Array, normals: Float64Array) -> Turning:
        """Return points and normals, both [N, 3], in coordinates of the axis."""
        there, facing = axis.to_axis(points), normals @ axis.rotation.T
        radius = np.linalg.norm(there[:, :2], axis=1)
        azimuth = np.arctan2(there[:, 1], there[:, 0])
        cosine, sine = np.cos(azimuth), np.sin(azimuth)
        return cls(
            there,
            facing,
            radius,
            azimuth,
            facing[:, 0] * cosine + facing[:, 1] * sine,
            facing[:, 1] * cosine - facing[:, 0] * sine,
        )

    def select(self, mask: BoolArray) -> Turning:  # [N]
        """Return some of the points."""
        parts = (self.points, self.normals, self.radius, self.azimuth_rad)
        return Turning(*(part[mask] for part in (*parts, self.radial, self.tangential)))

    @property
    def horizontal(self) -> Float64Array:  # [N]
        """Lengths of the normals' horizontal parts."""
        return np.hypot(self.radial, self.tangential)

    def off_axis(self) -> Float64Array:  # [N]
        """Return how far normals pass the axis, over what is allowed."""
        distance = self.radius * np.abs(self.tangential) / self.horizontal.clip(1e-9)
        return distance / np.maximum(OFF, OFF_SINE * self.radius)

    def sectors(self) -> IntArray:  # [N]
        """Return the sector that each point is in."""
        turn = (self.azimuth_rad + math.pi) / (2 * math.pi)
        return (turn * SECTORS).astype(np.int64) % SECTORS

    def body(self) -> tuple[BoolArray, IntArray]:  # [N], [N]
        """Return which points belong to the body, and in how many sectors P has their like."""
        meets = (self.horizontal < STEEP) | (self.off_axis() < _BODY_OFF)
        profile = np.stack([self.radius, self.points[:, 2]], axis=1)
        cells = np.floor(profile / _CELL).astype(np.int64)
        _, cell = np.unique(cells, axis=0, return_inverse=True)
        cell = cell.reshape(-1)
        sector = self.sectors()
        shown = np.zeros((int(cell.max()) + 1, SECTORS), np.bool_)
        shown[cell[meets], sector[meets]] = True
        sectors = shown.sum(axis=1)[cell]
        if not meets.any():
            return meets, sectors
        fewest = max(_LEAST_ROUND * float(np.median(sectors[meets])), _FEWEST_SECTORS)
        return meets & ((sectors >= fewest) | (self.radius < NEAR_AXIS)), sectors


def turned(points: Float64Array, angle_rad: Float64Array) -> Float64Array:  # [N, 3], [N] -> [N, 3]
    """Turn every point about the z axis by its own angle."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = points.T
    return np.stack([x * cosine - y * sine, x * sine + y * cosine, z], axis=1)


def in_box_sides(
    points: Float64Array,  # [N, 3]
    axes: Float64Array | None,  # [N, 3]
    most: int,
) -> tuple[Float64Array, Float64Array | None, Float64Array, float] | None:  # [K, 3], [K, 3], [3]
    """Return at most so many points about the middle of their box, in its sides, and their axes.

    The box's middle and largest side come after them; None = too few points, or no extent.
    """
    chosen = every_nth(points, most)
    axes = None if axes is None else every_nth(axes, most)
    low, high = chosen.min(axis=0), chosen.max(axis=0)
    middle, side = (low + high) / 2, float((high - low).max())
    if len(chosen) < _FEWEST_POINTS or not side > 0:
        return None
    return (chosen - middle) / side, axes, middle, side


def off_plane(place: Float64Array, azimuth_rad: float, offset: float) -> float:  # [2] or [3]
    """Return how far a place is from the upright plane of that normal and offset."""
    normal = np.array([math.cos(azimuth_rad), math.sin(azimuth_rad)])
    return float(abs(place[:2] @ normal - offset))
