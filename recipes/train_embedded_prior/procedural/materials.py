"""Procedural surface colours: patterns, painted marks, and baked light.

Conventions
-----------
* Patterns are functions of surface coordinates uv (units of length; objects are about 1 tall) or
  of points in the object frame (z up). ``frequency`` counts periods per unit length and is a
  multiple of 1 / SEAM_UNIT where a pattern runs around closed sections.
* A mark is painted along a direction onto all points in front of its plane: eyes, dials, labels.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from gscomplete.util.arrays import BoolArray, Float32Array
from recipes.train_embedded_prior.procedural.sampling import SurfaceSamples

Pattern = Literal[
    "solid",
    "stripes",
    "bands",
    "diagonal",
    "checks",
    "dots",
    "gradient",
    "two_tone",
    "marble",
    "wood",
    "speckles",
    "bricks",
    "tiles",
    "planks",
    "patches",
    "rim",
    "windows",
    "zigzag",
]

MarkShape = Literal["disc", "ring", "rectangle", "label", "star", "ball"]


@dataclass(frozen=True, slots=True)
class Mark:
    """A shape painted onto a surface."""

    center: tuple[float, float, float]
    facing: tuple[float, float, float]
    """Direction from the surface to who looks at the mark; need not be unit."""
    size: tuple[float, float]
    """Half width and half height; for discs and stars the radius and its vertical counterpart."""
    color: Float32Array
    shape: MarkShape = "disc"
    reach: float = 1e9
    """How far from its centre, along ``facing``, the surface may lie."""


@dataclass(frozen=True, eq=False)
class Material:
    """How one or several parts are coloured."""

    color: Float32Array
    accent: Float32Array | None = None
    pattern: Pattern = "solid"
    frequency: float = 8.0
    duty: float = 0.5
    """Share of a period that the accent takes; for bands, gradients, two-tone: the height."""
    phase: float = 0.0
    marks: tuple[Mark, ...] = field(default=())


def paint(material: Material, samples: SurfaceSamples) -> Float32Array:  # [N, 3]
    """Return the colours of samples that all carry one material."""
    colors = np.broadcast_to(material.color, (len(samples.points), 3)).copy()
    if material.accent is not None and material.pattern != "solid":
        amount = _pattern_amount(material, samples)[:, None]
        colors += amount * (material.accent - material.color)
    for mark in material.marks:
        _paint_mark(mark, samples, colors)
    return colors


def _pattern_amount(material: Material, samples: SurfaceSamples) -> Float32Array:  # [N] in [0, 1]
    """Return how much of the accent every sample shows."""
    if material.pattern in ("stripes", "diagonal", "checks", "dots", "bricks", "tiles", "planks"):
        return _uv_pattern(material, samples.uv)
    if material.pattern in ("windows", "zigzag"):
        return _uv_pattern(material, samples.uv)
    if material.pattern in ("marble", "wood", "speckles", "patches"):
        return _solid_pattern(material, samples.points)
    return _height_pattern(material, samples.points[:, 2])


def _uv_pattern(material: Material, uv: Float32Array) -> Float32Array:
    """Patterns in surface coordinates: every one has a period of 1 in x = u * frequency."""
    x = uv[:, 0] * material.frequency + material.phase
    y = uv[:, 1] * material.frequency + material.phase
    duty = material.duty
    if material.pattern == "stripes":
        inside = x % 1.0 < duty
    elif material.pattern == "diagonal":
        inside = (x + y) % 1.0 < duty
    elif material.pattern == "zigzag":
        inside = (y + np.abs(x % 1.0 - 0.5)) % 1.0 < duty
    elif material.pattern == "checks":
        inside = (np.floor(2 * x) + np.floor(2 * y)) % 2 == 0
    elif material.pattern == "dots":
        dx, dy = x % 1.0 - 0.5, y % 1.0 - 0.5
        inside = dx * dx + dy * dy < 0.2 * duty
    elif material.pattern == "windows":
        dx, dy = np.abs(x % 1.0 - 0.5), np.abs(y % 1.0 - 0.5)
        inside = (dx < 0.5 * duty) & (dy < 0.6 * duty)
    elif material.pattern == "planks":
        return ((x % 1.0 < 0.12) + 0.6 * _hash(np.floor(x))).clip(0, 1)
    else:
        row = np.floor(2 * y)
        shifted = (x + 0.5 * row) % 1.0
        mortar = (shifted < 0.12) | ((2 * y) % 1.0 < (0.2 if material.pattern == "bricks" else 0.3))
        shade = 0.35 * _hash(row * 17.0 + np.floor(x + 0.5 * row))
        return np.where(mortar, np.float32(1.0), shade.astype(np.float32))
    return inside.astype(np.float32)


def _solid_pattern(material: Material, points: Float32Array) -> Float32Array:
    """Patterns carved from a solid: smooth sums of waves with random-looking directions."""
    p = points * np.float32(material.frequency)
    phase = material.phase
    if material.pattern == "wood":
        bend = 0.6 * np.sin(0.7 * p[:, 2] + 9 * phase) + 0.4 * np.sin(0.9 * p[:, 1])
        ring = np.sin(2.2 * p[:, 0] + 1.7 * p[:, 1] + 0.25 * p[:, 2] + 3 * bend + phase)
        return 0.5 + 0.5 * ring
    warp = np.sin(1.3 * p[:, 1] + 1.1 * p[:, 2] + 7 * phase)
    first = np.sin(1.7 * p[:, 0] + 0.9 * p[:, 1] + 1.5 * warp + 11 * phase)
    second = np.sin(1.2 * p[:, 2] - 1.5 * p[:, 0] + 1.5 * first + 5 * phase)
    if material.pattern == "marble":
        return np.abs(0.5 * (first + second)) ** 2
    if material.pattern == "speckles":
        return (_hash(np.arange(len(p)) + 31 * phase) < 0.4 * material.duty).astype(np.float32)
    return (0.5 * (first + second) > 0.6 - 0.8 * material.duty).astype(np.float32)


def _height_pattern(material: Material, z: Float32Array) -> Float32Array:
    """Patterns along the height of the painted parts."""
    low, high = float(z.min()), float(z.max())
    height = (z - low) / max(high - low, 1e-6)
    if material.pattern == "gradient":
        return height
    if material.pattern == "two_tone":
        return (height > material.duty).astype(np.float32)
    if material.pattern == "rim":
        return (height > 0.93).astype(np.float32)
    wave = height * material.frequency + material.phase
    return (wave % 1.0 < material.duty).astype(np.float32)


def _hash(values: Float32Array) -> Float32Array:
    """Return noise in [0, 1) as a function of a number."""
    return np.abs(np.sin(values * 12.9898 + 4.1) * 43758.547) % 1.0


def _paint_mark(mark: Mark, samples: SurfaceSamples, colors: Float32Array) -> None:
    """Paint one mark into ``colors`` [N, 3]."""
    offset = samples.points - np.asarray(mark.center, np.float32)
    if mark.shape == "ball":
        inside = np.einsum("ij,ij->i", offset, offset) < mark.size[0] ** 2
        colors[inside] = mark.color
        return
    facing = np.asarray(mark.facing, np.float32)
    facing = facing / np.linalg.norm(facing)
    up = np.array([0, 0, 1], np.float32) if abs(facing[2]) < 0.9 else np.array([1, 0, 0])
    right = np.cross(up, facing)
    right /= np.linalg.norm(right)
    x = offset @ (right / np.float32(mark.size[0])).astype(np.float32)
    y = offset @ (np.cross(facing, right) / mark.size[1]).astype(np.float32)
    if mark.shape in ("rectangle", "label"):
        inside = (np.abs(x) < 1) & (np.abs(y) < 1)
    else:
        square = x * x + y * y
        inside = square < 1
        if mark.shape == "ring":
            inside &= square > 0.6
        elif mark.shape == "star":
            inside &= square < (0.62 + 0.38 * np.cos(5 * np.arctan2(x, y))) ** 2
    inside &= samples.normals @ facing > 0.15
    if mark.reach < 1e9:
        inside &= np.abs(offset @ facing) < mark.reach
    if mark.shape == "label":
        _paint_label(mark, inside, x, y, colors)
    else:
        colors[inside] = mark.color


def _paint_label(
    mark: Mark, inside: BoolArray, x: Float32Array, y: Float32Array, colors: Float32Array
) -> None:
    """Paint a pale or dark label with a picture block and lines of letter-like dashes."""
    tone = mark.color
    ink = np.where(tone.mean() > 0.5, tone * 0.25, 0.3 * tone + 0.7).astype(np.float32)
    row, column = np.floor(y[inside] * 5), np.floor(x[inside] * 7)
    seed = float(tone @ np.array([3.0, 7.0, 11.0], np.float32))
    written = (_hash(row * 13.0 + column + seed) < 0.6) & (np.abs(y[inside] * 5 - row - 0.5) < 0.3)
    written &= (np.abs(x[inside]) < 0.85) & (np.abs(y[inside]) < 0.85)
    colors[inside] = np.where(written[:, None], ink, tone)


@dataclass(frozen=True, slots=True)
class BakedLight:
    """Soft light multiplied into the colours, as in textures with baked shading."""

    direction: Float32Array  # [3] unit, towards the light
    strength: float
    """0 = none, 0.5 = sides away from the light at half brightness."""
    occlusion: float
    """Darkening at the foot of the object, 0 = none."""
    gloss: float
    """Strength of a highlight, 0 = none."""


def sample_light(rng: np.random.Generator) -> BakedLight:
    """Draw a light from above; a quarter of all objects carry none."""
    direction = rng.normal(size=3)
    direction[2] = abs(direction[2]) + 0.7
    draws = rng.random(5)
    lit = draws[0] > 0.25
    return BakedLight(
        (direction / np.linalg.norm(direction)).astype(np.float32),
        float(0.5 * draws[1]) if lit else 0.0,
        float(0.35 * draws[2]) if lit else 0.0,
        float(0.35 * draws[3]) if lit and draws[4] < 0.35 else 0.0,
    )


def bake(
    light: BakedLight, samples: SurfaceSamples, colors: Float32Array
) -> Float32Array:  # [N, 3]
    """Return the colours [N, 3] with the light's shading multiplied in."""
    if light.strength == 0.0 and light.occlusion == 0.0 and light.gloss == 0.0:
        return colors
    facing = samples.normals @ light.direction
    z = samples.points[:, 2]
    height = (z - z.min()) / max(float(np.ptp(z)), 1e-6)
    shade = 1.0 - light.strength * (0.5 - 0.5 * facing)
    shade *= 1.0 - light.occlusion * (1.0 - height) ** 2 * (1.0 - 0.5 * samples.normals[:, 2])
    lit = colors * shade[:, None]
    if light.gloss:
        highlight = light.gloss * np.maximum(facing, 0.0) ** 24
        lit += highlight[:, None] * (1.0 - lit)
    return lit
