"""View distributions: where the partial object must keep its appearance, and views to show it from.

Conventions
-----------
* Angles in degrees in the object frame: azimuth 0 looks from +x, 90 from +y; positive elevation
  looks down (see ``cameras``). Azimuths returned here are not wrapped to a period.
* A distribution is uniform in azimuth and in elevation about the input view c.
* c is at most at ``MAX_ELEVATION_DEG``. Views beyond this elevation are reflected back by as much,
  so that no view crosses a pole and views do not pile up at one elevation.
* Random views are a function of (seed, step): a resumed run draws what the first would have drawn.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.errors import UserError
from gscomplete.util import jsonio
from gscomplete.views.cameras import Cameras, orbit_cameras

SCHEMA = "gscomplete.view_distribution"
"""Name of the JSON form, shared by object folders and run folders."""
SCHEMA_VERSION = 1
"""Version of the JSON form; other versions are refused."""
MAX_ELEVATION_DEG = 85.0
"""Largest absolute elevation that a distribution gives."""

AZIMUTH_RANGE_DEG = 50.0
"""V's reach in azimuth to either side of c (the paper's +/-50 degrees)."""
ELEVATION_RANGE_DEG = 15.0
"""V's reach in elevation above and below c: what a person walking round an object sees."""
RADIUS = 2.2
"""Distance of V's cameras from the object's centre, object sizes: 1.6 sizes are visible there."""
FOV_DEG = 40.0
"""Their vertical field of view."""

_PHILOX_STREAM = 0x5649455753
"""Second key word of the generator, so that views share no random numbers with other uses."""
_FIRST_MEASURED_VIEW = 20_000
"""Views of V's sequence are used for measuring from this index on."""
_ROOM = 0.75
"""Distance from the target up to which the usual cameras show everything, object sizes."""
_STRAYS = 0.001
"""Share of points at either end of an axis that pictures need not show."""
_LARGEST = 4.0
"""Pictures are taken from at most this many times V's distance."""
_SIDES = (0.0, -0.6, 0.6)
"""Azimuths of c and of views to both sides of it, in ranges of V about c."""
_MAX_SIDE_ELEVATION_DEG = 80.0
_PLASTIC = 1.3247179572447460
"""Real root of x^3 = x + 1, the base of the two-dimensional R2 sequence."""

Angles = tuple[NDArray[np.floating], NDArray[np.floating]]
"""Azimuths and elevations in degrees, [count] each."""


@dataclass(frozen=True, slots=True)
class ViewDistribution:
    """The viewpoints V about the input view c (paper, sections 3.2 and 4, "Comparison")."""

    azimuth_deg: float
    """Azimuth of the input view c."""
    elevation_deg: float
    """Elevation of the input view c."""
    azimuth_range_deg: float = AZIMUTH_RANGE_DEG
    """Views reach this far to either side of c (the paper's +/-50 degrees)."""
    elevation_range_deg: float = ELEVATION_RANGE_DEG
    """Views reach this far above and below c. The paper names no range; 15 degrees is what a
    person walking round an object sees, and 0 gives the ring at c's elevation."""
    radius: float = RADIUS
    """Distance of the cameras from the target in object sizes."""
    fov_deg: float = FOV_DEG
    """Vertical field of view."""
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Point in the object frame that every view looks at."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: a value lies outside its range; the message names the field.
        """
        for name, value, low, high in (
            ("azimuth_deg", self.azimuth_deg, -1e6, 1e6),
            ("elevation_deg", self.elevation_deg, -90.0, 90.0),
            ("azimuth_range_deg", self.azimuth_range_deg, 0.0, 180.0),
            ("elevation_range_deg", self.elevation_range_deg, 0.0, 90.0),
            ("radius", self.radius, 1e-6, 1e6),
            ("fov_deg", self.fov_deg, 0.1, 170.0),
        ):
            if not low <= value <= high:
                raise ValueError(f"{name}: expected a number in [{low:g}, {high:g}], found {value}")
        if len(self.target) != 3 or not all(math.isfinite(t) for t in self.target):
            raise ValueError(f"target: expected three finite numbers, found {self.target}")

    def sample(self, seed: int, step: int, count: int) -> Angles:
        """Draw ``count`` views, a pure function of (seed, step).

        The first views of a larger draw are the views of a smaller one.
        """
        words = np.array([seed % 2**64, _PHILOX_STREAM], dtype=np.uint64)
        counter = np.array([0, 0, step % 2**64, 0], dtype=np.uint64)
        generator = np.random.Generator(np.random.Philox(key=words, counter=counter))
        return self._place(generator.random((count, 2)))

    def low_discrepancy(self, count: int, first: int = 0) -> Angles:
        """Return ``count`` evenly spread views of V, from place ``first`` of a sequence.

        The R2 sequence (additive recurrence on the plastic number) started at the middle, so that
        place 0 is c itself: every stretch covers the ranges evenly, so scores over 8 and over 32
        views are comparable.
        """
        index = first + np.arange(count)[:, None]
        steps = np.array([1.0 / _PLASTIC, 1.0 / _PLASTIC**2])
        return self._place((0.5 + index * steps) % 1.0)

    def measured(self, count: int) -> Angles:
        """Return ``count`` evenly spread views of V for measuring, to which nothing is fitted.

        Fitting and checking use indices of the sequence far below these.
        """
        return self.low_discrepancy(count, _FIRST_MEASURED_VIEW)

    def cameras(self, angles: Angles, size_px: int) -> Cameras:
        """Place square cameras at the given views with this distribution's radius and lens."""
        azimuths, elevations = (torch.from_numpy(np.asarray(a, dtype=np.float64)) for a in angles)
        return orbit_cameras(
            azimuths,
            elevations,
            radius=self.radius,
            fov_deg=self.fov_deg,
            size_px=size_px,
            target=torch.tensor(self.target, dtype=torch.float64, device="cpu"),
        )

    def input_camera(self, size_px: int) -> Cameras:
        """Place one camera at the input view c."""
        return self.cameras(self.low_discrepancy(1), size_px)

    def direction(self) -> np.ndarray:  # [3]
        """Return the unit vector from the target towards c."""
        azimuth = math.radians(self.azimuth_deg)
        elevation = math.radians(_off_the_poles(self.elevation_deg))
        level = math.cos(elevation)
        return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])

    def eye(self) -> np.ndarray:  # [3]
        """Return the place of the camera at c."""
        return np.array(self.target) + self.radius * self.direction()

    def to_show(
        self,
        points: NDArray[np.floating],  # [N, 3]
    ) -> ViewDistribution:
        """Return views from the same directions, far enough away to show the points, for pictures.

        The views are returned as they are if they have room. Strays do not count, and the distance
        grows at most fourfold.
        """
        if not len(points):
            return self
        low, high = np.quantile(points.astype(float), (_STRAYS, 1 - _STRAYS), axis=0)
        room = _ROOM * self.radius / RADIUS
        if np.abs(np.stack([low, high]) - self.target).max() <= room:
            return self
        middle, half = (low + high) / 2, float((high - low).max()) / 2
        largest = _LARGEST * self.radius
        if not (np.abs(middle).max() <= largest and half <= largest):
            return self
        x, y, z = middle.tolist()
        radius = min(max(self.radius, 2 * half * RADIUS), largest)
        return dataclasses.replace(self, target=(x, y, z), radius=radius)

    def sides(self, size_px: int) -> Cameras:
        """Place cameras at c and to both sides of it, well within V."""
        azimuths = self.azimuth_deg + np.array(_SIDES) * self.azimuth_range_deg
        limit = _MAX_SIDE_ELEVATION_DEG
        elevations = np.full(len(_SIDES), np.clip(self.elevation_deg, -limit, limit))
        return self.cameras((azimuths, elevations), size_px)

    def ring(self, count: int, size_px: int) -> Cameras:
        """Place cameras evenly round the object at c's elevation, c first, azimuth rising."""
        azimuths = self.azimuth_deg + 360.0 / count * np.arange(count)
        elevations = np.full(count, _off_the_poles(self.elevation_deg))
        return self.cameras((azimuths, elevations), size_px)

    def preview_cameras(self, size_px: int) -> Cameras:
        """Place the six cameras of a run's preview, 60 degrees apart, c first."""
        return self.ring(6, size_px)

    def to_json(self) -> dict[str, Any]:
        """Return the distribution as plain JSON values with schema name and version."""
        return {"schema": SCHEMA, "version": SCHEMA_VERSION, **jsonio.to_json(self)}

    @classmethod
    def from_json(cls, data: Any, source: str) -> ViewDistribution:
        """Read the distribution from plain JSON values; ``source`` names the file in errors.

        Raises:
            UserError: another schema or version, or a field missing, unknown or out of range.
        """
        if not isinstance(data, dict):
            raise UserError(f"{source}: view distribution: expected an object")
        for field, expected in (("schema", SCHEMA), ("version", SCHEMA_VERSION)):
            if field not in data:
                raise UserError(f"{source}: view distribution: missing field {field!r}")
            if data[field] != expected:
                raise UserError(f"{source}: {field}: expected {expected!r}, found {data[field]!r}")
        values = {key: value for key, value in data.items() if key not in ("schema", "version")}
        return jsonio.from_json(cls, values, source)

    def _place(self, unit: NDArray[np.floating]) -> Angles:  # [count, 2] in [0, 1)
        """Map points of the unit square to views."""
        offset = 2.0 * unit - 1.0
        azimuths = self.azimuth_deg + self.azimuth_range_deg * offset[:, 0]
        center = _off_the_poles(self.elevation_deg)
        return azimuths, _turned_back(center + self.elevation_range_deg * offset[:, 1])


def _off_the_poles(elevation_deg: float) -> float:
    """Return the nearest elevation that c may have."""
    return min(max(elevation_deg, -MAX_ELEVATION_DEG), MAX_ELEVATION_DEG)


def _turned_back(elevations_deg: NDArray[np.floating]) -> NDArray[np.floating]:
    """Mirror elevations beyond the largest back into the range."""
    largest = np.copysign(MAX_ELEVATION_DEG, elevations_deg)
    beyond = np.abs(elevations_deg) > MAX_ELEVATION_DEG
    return np.where(beyond, 2 * largest - elevations_deg, elevations_deg)
