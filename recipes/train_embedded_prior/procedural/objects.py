"""Make the object number ``index`` of the stream ``seed``: splats, caption, family.

Conventions
-----------
* Everything is a pure function of (seed, index) and, for ``make_object_of``, the family; making
  an object of the family that ``make_object`` drew gives the same object.
* Output is in the object frame: z up, box centred at the origin, largest side 1, random yaw.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gscomplete.splats.record import Splats
from gscomplete.util.arrays import Float32Array
from recipes.train_embedded_prior.procedural.assembly import Assembly, Description
from recipes.train_embedded_prior.procedural.captions import caption
from recipes.train_embedded_prior.procedural.home import (
    cooking,
    craft,
    furniture,
    household,
    kitchen,
    storage,
    wear,
)
from recipes.train_embedded_prior.procedural.materials import bake, paint, sample_light
from recipes.train_embedded_prior.procedural.quads import turn_about
from recipes.train_embedded_prior.procedural.sampling import SurfaceSamples, sample_quads
from recipes.train_embedded_prior.procedural.warps import draw_warp, warped
from recipes.train_embedded_prior.procedural.world import (
    abstract,
    buildings,
    creatures,
    figures,
    nature,
    play,
    prizes,
    things,
    vehicles,
)
from splatcomplete_data.mesh.discs import discs_at

Family = Callable[[Assembly], Description]
ABSTRACT_SHARE = 0.3
"""Share of abstract shapes in the stream, which teach surfaces rather than templates."""
_TILTED_SHARE = 0.08
"""Share of objects that are tilted a little."""
_LYING_SHARE = 0.03
"""Share of objects that lie on their side."""
_WARPED_SHARE = 0.6
"""Share of objects that are deformed all over."""
_COLOR_NOISE = 0.02
"""Largest standard deviation of the colour noise per splat (drawn per object)."""
_SPLATS = (7000, 11000)
"""Fewest and most splats of an object."""


@dataclass(frozen=True, slots=True)
class ProceduralObject:
    """One generated object."""

    splats: Splats  # float32, SH degree 0
    caption: str
    family: str


def _named(*groups: tuple[Family, ...]) -> dict[str, Family]:
    """Return families by the name of their function."""
    return {family.__name__: family for group in groups for family in group}


CONCRETE = _named(
    kitchen.FAMILIES,
    cooking.FAMILIES,
    furniture.FAMILIES,
    storage.FAMILIES,
    household.FAMILIES,
    things.FAMILIES,
    buildings.FAMILIES,
    vehicles.FAMILIES,
    craft.FAMILIES,
    nature.FAMILIES,
    creatures.FAMILIES,
    figures.FAMILIES,
    play.FAMILIES,
    prizes.FAMILIES,
    wear.FAMILIES,
)
ABSTRACT = _named(abstract.FAMILIES)
FAMILIES = {**CONCRETE, **ABSTRACT}


def family_of(seed: int, index: int) -> str:
    """Return the family that ``make_object`` draws."""
    rng = np.random.default_rng((seed, index, 1))
    names = list(ABSTRACT if rng.random() < ABSTRACT_SHARE else CONCRETE)
    return names[int(rng.integers(len(names)))]


def make_object(seed: int, index: int) -> ProceduralObject:
    """Make an object of a random family."""
    return make_object_of(family_of(seed, index), seed, index)


def make_object_of(family: str, seed: int, index: int) -> ProceduralObject:
    """Make an object of a given family.

    Raises:
        KeyError: the family is unknown.
    """
    rng = np.random.default_rng((seed, index, 0))
    assembly = Assembly(rng)
    description = FAMILIES[family](assembly)
    count = int(rng.integers(_SPLATS[0], _SPLATS[1] + 1))
    samples = sample_quads(assembly.quads, count, rng)
    shaping = np.random.default_rng((seed, index, 3))
    if shaping.random() < _WARPED_SHARE:
        samples = warped(samples, draw_warp(shaping))
    colors = bake(sample_light(rng), samples, _colors(assembly, samples))
    noise = rng.uniform(0, _COLOR_NOISE)
    colors += noise * rng.standard_normal(colors.shape, dtype=np.float32)
    turn = _pose(rng)
    points, scale = into_unit_box(samples.points @ turn.T)
    opacity = float(rng.uniform(0.95, 0.99))
    spacing = samples.spacing * np.float32(scale)
    splats = discs_at(points, samples.normals @ turn.T, colors.clip(0, 1), spacing, opacity)
    words = caption(description, np.random.default_rng((seed, index, 2)))
    return ProceduralObject(splats, words, family)


def into_unit_box(points: Float32Array) -> tuple[Float32Array, float]:  # [N, 3]
    """Centre points on their box and scale its largest side to 1; return them and the scale."""
    low, high = points.min(axis=0), points.max(axis=0)
    scale = 1.0 / float((high - low).max())
    return (points - 0.5 * (low + high)) * np.float32(scale), scale


def _colors(assembly: Assembly, samples: SurfaceSamples) -> Float32Array:  # [N, 3]
    """Paint every material once, over all the parts that carry it."""
    kinds: dict[int, int] = {}
    kind_of_part = [kinds.setdefault(id(m), len(kinds)) for m in assembly.materials]
    kind = np.array(kind_of_part)[samples.part]
    materials = list({id(m): m for m in assembly.materials}.values())
    if len(materials) == 1:
        return paint(materials[0], samples)
    colors = np.empty((len(samples.points), 3), np.float32)
    for k, material in enumerate(materials):
        index = np.flatnonzero(kind == k)
        if len(index):
            colors[index] = paint(material, samples.select(index))
    return colors


def _pose(rng: np.random.Generator) -> Float32Array:  # [3, 3]
    """Draw a yaw over the full circle, and rarely a tilt or a fall to the side."""
    yaw, tilt_axis, tilt = (float(value) for value in rng.uniform(0, 360, 3))
    turn = turn_about("z", yaw)
    kind = rng.random()
    if kind < _LYING_SHARE:
        return turn @ turn_about("x", 90.0 if tilt < 180 else -90.0)
    if kind < _LYING_SHARE + _TILTED_SHARE:
        lean = turn_about("z", tilt_axis) @ turn_about("x", tilt / 18.0)
        return lean @ turn
    return turn
