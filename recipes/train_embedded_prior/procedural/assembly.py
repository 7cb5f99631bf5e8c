"""What a family builds an object with: it collects parts with their appearance.

Conventions
-----------
* Families build in the generator frame: z up, standing on z = 0 (not required), the front towards
  +x, about one unit tall. ``objects`` normalises afterwards.
* A ``Look`` is a material together with the words that describe it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from recipes.train_embedded_prior.procedural.materials import Mark, Material, Pattern
from recipes.train_embedded_prior.procedural.palette import (
    ANY,
    SUBSTANCES,
    contrast,
    pick_color,
    sample_color,
)
from recipes.train_embedded_prior.procedural.quads import Quads, turn_about

T = TypeVar("T")

PATTERN_WORDS: dict[Pattern, tuple[str, ...]] = {
    "stripes": ("stripes", "vertical stripes"),
    "bands": ("bands", "horizontal stripes", "rings"),
    "diagonal": ("diagonal stripes", "spiral stripes"),
    "checks": ("checks", "squares", "a checkered pattern"),
    "dots": ("dots", "polka dots", "spots"),
    "gradient": ("a gradient",),
    "two_tone": ("a top",),
    "rim": ("a rim",),
    "zigzag": ("a zigzag pattern",),
    "patches": ("spots", "patches"),
    "speckles": ("speckles",),
}
"""What a caption may say of a pattern; patterns not listed belong to a substance."""

DECORATIONS: tuple[Pattern, ...] = (
    "stripes",
    "bands",
    "diagonal",
    "checks",
    "dots",
    "gradient",
    "two_tone",
    "rim",
    "zigzag",
    "patches",
)


@dataclass(frozen=True, eq=False)
class Look:
    """A material and its words."""

    material: Material
    color: str
    substance: str
    accent: str | None = None

    def marked(self, *marks: Mark) -> Look:
        """Return the look with marks painted on."""
        material = dataclasses.replace(self.material, marks=(*self.material.marks, *marks))
        return dataclasses.replace(self, material=material)


@dataclass(frozen=True, slots=True)
class Description:
    """What a family says about the object it built; ``captions`` makes a sentence of it."""

    nouns: tuple[str, ...]
    """Names of the object, any of which will do."""
    look: Look
    """The main look: its colour leads the caption."""
    details: tuple[str, ...] = ()
    """Phrases that may follow "with", such as "a brown lid"."""
    adjectives: tuple[str, ...] = ()
    """Words such as "tall" that may lead."""


class Assembly:
    """Collects the parts of one object."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Start empty; ``rng`` is the only source of chance for the family."""
        self.rng = rng
        self.quads: list[Quads] = []
        self.materials: list[Material] = []

    def add(
        self,
        quads: Quads,
        look: Look,
        at: Sequence[float] = (0.0, 0.0, 0.0),
        turn: ArrayLike | None = None,  # [3, 3]
    ) -> None:
        """Add a part, turned and then shifted."""
        self.quads.append(quads.moved(turn, at))
        self.materials.append(look.material)

    def add_mirrored(
        self,
        quads: Quads,
        look: Look,
        at: Sequence[float],
        turn: ArrayLike | None = None,  # [3, 3]
    ) -> None:
        """Add a part and its mirror image in the plane y = 0."""
        part = quads.moved(turn, at)
        self.add(part, look)
        corners = part.corners[:, ::-1] * np.array([1, -1, 1], np.float32)
        self.add(Quads(corners, part.uv[:, ::-1], part.feature), look)

    def add_around(
        self,
        quads: Quads,
        look: Look,
        count: int,
        at: Sequence[float],
        start_deg: float = 0.0,
    ) -> None:
        """Add ``count`` copies of a part shifted to ``at`` and turned evenly about the z axis."""
        for k in range(count):
            turn = turn_about("z", start_deg + 360.0 * k / count)
            self.add(quads.moved(None, at), look, turn=turn)

    def uniform(self, low: float, high: float) -> float:
        """Draw a number between two bounds."""
        return float(self.rng.uniform(low, high))

    def chance(self, probability: float) -> bool:
        """Return True with a probability."""
        return bool(self.rng.random() < probability)

    def integer(self, low: int, high: int) -> int:
        """Draw an integer between two bounds, both included."""
        return int(self.rng.integers(low, high + 1))

    def choose(self, options: Sequence[T]) -> T:
        """Draw one of several options."""
        return options[int(self.rng.integers(len(options)))]

    def look(
        self,
        *substances: str,
        colors: Sequence[str] | None = None,
        avoid: Look | None = None,
        patterns: Sequence[Pattern] = (),
        pattern_chance: float = 0.3,
    ) -> Look:
        """Draw a look.

        Args:
            substances: what it may be made of (keys of ``SUBSTANCES``), none = "plain".
            colors: colour words to choose from, None = those of the substance.
            avoid: a look whose colours should be told apart from this one.
            patterns: decorations it may carry.
            pattern_chance: probability of a decoration.
        """
        substance = self.choose(substances) if substances else "plain"
        options = SUBSTANCES[substance] if colors is None else colors
        taken = () if avoid is None else (avoid.color,)
        name = pick_color(self.rng, options, taken)
        color = sample_color(name, self.rng)
        if avoid is not None and contrast(color, avoid.material.color) < 0.15:
            name = pick_color(self.rng, options, (*taken, name))
            color = sample_color(name, self.rng)
        if patterns and self.chance(pattern_chance):
            return self._decorated(name, color, substance, patterns)
        return Look(self._grained(color, substance), name, substance)

    def _decorated(
        self, name: str, color: np.ndarray, substance: str, patterns: Sequence[Pattern]
    ) -> Look:
        """Return a look with an accent colour in a pattern."""
        second, accent = name, color
        for _ in range(4):
            second = pick_color(self.rng, ANY, (name,))
            accent = sample_color(second, self.rng)
            if contrast(color, accent) > 0.3:
                break
        pattern = self.choose(patterns)
        bands = pattern == "bands"
        frequency = self.integer(1, 6) if bands else 4.0 * self.integer(1, 3)
        duty = self.uniform(0.25, 0.75)
        material = Material(color, accent, pattern, float(frequency), duty, self.uniform(0, 1))
        return Look(material, name, substance, second)

    def _grained(self, color: np.ndarray, substance: str) -> Material:
        """Return a material with the texture that comes with its substance, if any."""
        phase = self.uniform(0, 6)
        frequency = self.uniform(4, 14)
        if substance == "wooden" and self.chance(0.75):
            tone = color * np.float32(self.uniform(0.62, 0.9))
            if self.chance(0.25):
                return Material(color, tone, "planks", 4.0 * self.integer(1, 3), 0.5, phase)
            return Material(color, tone, "wood", frequency, 0.5, phase)
        if substance in ("stone", "marble", "clay") and self.chance(0.8):
            tone = (color * self.uniform(0.6, 1.3)).clip(0, 1).astype(np.float32)
            return Material(color, tone, "marble", frequency, 0.5, phase)
        if substance in ("plush", "leafy", "straw") and self.chance(0.7):
            tone = color * np.float32(self.uniform(0.6, 0.85))
            return Material(color, tone, "speckles", frequency, 0.9, phase)
        if substance == "metal" and self.chance(0.4):
            tone = (color * self.uniform(0.7, 1.2)).clip(0, 1).astype(np.float32)
            return Material(color, tone, "gradient", frequency, 0.5, phase)
        return Material(color)
