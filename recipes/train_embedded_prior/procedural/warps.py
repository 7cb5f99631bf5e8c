"""Smooth deformations of whole objects, so that a family is more shapes than its parts allow.

Conventions
-----------
* Objects are in the generator frame: z up, the front towards +x, mirror plane y = 0, about one
  unit tall. Warps keep that symmetry, and radial ones every symmetry about the z axis: what is
  symmetric stays so, which is what the shape network is to learn to see and use.
* A warp turns nothing inside out: every amplitude is bounded well below that.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gscomplete.util.arrays import Float32Array
from recipes.train_embedded_prior.procedural.sampling import SurfaceSamples

_STEP = 1e-3
"""Half the distance over which a warp's stretch is measured, as a share of the object's size."""
_LARGEST_STRETCH = 3.0


@dataclass(frozen=True, slots=True)
class Wave:
    """One smooth displacement along x, y or z."""

    along: Literal[0, 1, 2]
    amplitude: float
    rate_x: float
    rate_y: float
    rate_z: float
    phase: float

    def __call__(self, points: Float32Array) -> Float32Array:  # [N, 3] -> [N]
        """Return the displacement: odd in y if it is along y, else even."""
        across = self.rate_y * points[:, 1]
        sideways = np.sin(across) if self.along == 1 else np.cos(across)
        upward = np.sin(self.rate_x * points[:, 0] + self.rate_z * points[:, 2] + self.phase)
        return np.float32(self.amplitude) * sideways * upward


@dataclass(frozen=True, slots=True)
class Warp:
    """A deformation of an object whose box is centred, with largest side 1."""

    stretch: tuple[float, float, float]
    taper: float
    """Relative change of the width over one unit of height."""
    swell: float
    """Amplitude of the profile's wave along z, relative to the radius."""
    swell_rate: float
    swell_phase: float
    bend: float
    """Displacement along x at one unit from the middle, growing with the square of the height."""
    waves: tuple[Wave, ...]

    def __call__(self, points: Float32Array) -> Float32Array:  # [N, 3]
        """Return the deformed points."""
        out = points * np.array(self.stretch, np.float32)
        height = points[:, 2]
        widen = 1 + self.taper * height
        widen = widen * (1 + self.swell * np.sin(self.swell_rate * height + self.swell_phase))
        out[:, :2] *= widen[:, None].astype(np.float32)
        for wave in self.waves:
            out[:, wave.along] += wave(points)
        out[:, 0] += np.float32(self.bend) * height * height
        return out


def draw_warp(rng: np.random.Generator) -> Warp:
    """Draw a radial warp or a bilateral one."""
    side, depth, tall = np.exp(rng.uniform(-0.3, 0.3, 3)).tolist()
    swell = float(rng.uniform(0, 0.2)) if rng.random() < 0.5 else 0.0
    rate, phase = float(rng.uniform(3, 9)), float(rng.uniform(0, 2 * math.pi))
    taper = float(rng.uniform(-0.5, 0.5)) if rng.random() < 0.5 else 0.0
    if rng.random() < 0.4:
        return Warp((side, side, tall), taper, swell, rate, phase, 0.0, ())
    bend = float(rng.uniform(-0.5, 0.5)) if rng.random() < 0.4 else 0.0
    waves = tuple(_draw_wave(rng) for _ in range(int(rng.integers(0, 3))))
    return Warp((side, depth, tall), taper, swell, rate, phase, bend, waves)


def _draw_wave(rng: np.random.Generator) -> Wave:
    along: Literal[0, 1, 2] = (0, 1, 2)[int(rng.integers(3))]
    rates = rng.uniform(-7, 7, 3)
    # At most two waves of slope 0.2 on widths shrunk to 0.44 at most: nothing folds over.
    amplitude = rng.uniform(0.05, 0.2) / max(float(np.abs(rates).max()), 2.0)
    phase = float(rng.uniform(0, 2 * math.pi))
    return Wave(along, float(amplitude), *(float(rate) for rate in rates), phase)


def warped(samples: SurfaceSamples, warp: Warp) -> SurfaceSamples:
    """Deform surface samples: points, normals, and the spacing by how much the surface grew."""
    low, high = samples.points.min(axis=0), samples.points.max(axis=0)
    size = np.float32(max(float((high - low).max()), 1e-6))
    points = (samples.points - 0.5 * (low + high)) / size
    first, second = _tangents(samples.normals)
    sides = [
        (warp(points + _STEP * t) - warp(points - _STEP * t)) / (2 * _STEP) for t in (first, second)
    ]
    normals = np.cross(sides[0], sides[1])
    growth = np.linalg.norm(normals, axis=1).clip(1e-6)
    stretch = np.sqrt(growth).clip(1 / _LARGEST_STRETCH, _LARGEST_STRETCH)
    return dataclasses.replace(
        samples,
        points=(warp(points) * size).astype(np.float32),
        normals=(normals / growth[:, None]).astype(np.float32),
        spacing=(samples.spacing * stretch).astype(np.float32),
    )


def _tangents(normals: Float32Array) -> tuple[Float32Array, Float32Array]:  # [N, 3]
    """Return two unit vectors per normal that make a right-handed frame with it."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True).clip(1e-12)
    return first.astype(np.float32), np.cross(normals, first).astype(np.float32)
