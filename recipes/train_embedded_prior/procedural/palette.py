"""Named colours and substances: what a colour word means, and what things are made of.

Conventions
-----------
* Colours are sRGB in [0, 1]. A named colour is a centre and a spread; samples are uniform within
  +/- spread per channel (plus a common brightness shift of the same size), clipped to [0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gscomplete.util.arrays import Float32Array


@dataclass(frozen=True, slots=True)
class NamedColor:
    """A colour word."""

    center: tuple[float, float, float]
    spread: float
    weight: float = 1.0
    """How often it is drawn when any colour will do."""


COLORS: dict[str, NamedColor] = {
    "red": NamedColor((0.78, 0.10, 0.10), 0.09, 2.0),
    "dark red": NamedColor((0.42, 0.06, 0.08), 0.05),
    "orange": NamedColor((0.93, 0.48, 0.10), 0.07, 1.5),
    "yellow": NamedColor((0.93, 0.80, 0.15), 0.07, 1.5),
    "cream": NamedColor((0.94, 0.88, 0.72), 0.04),
    "beige": NamedColor((0.82, 0.72, 0.56), 0.05),
    "light brown": NamedColor((0.68, 0.48, 0.28), 0.06, 0.8),
    "brown": NamedColor((0.45, 0.27, 0.14), 0.06, 1.5),
    "dark brown": NamedColor((0.24, 0.14, 0.08), 0.04, 0.8),
    "green": NamedColor((0.16, 0.56, 0.20), 0.09, 1.5),
    "light green": NamedColor((0.55, 0.80, 0.40), 0.07),
    "dark green": NamedColor((0.07, 0.28, 0.13), 0.05),
    "olive": NamedColor((0.42, 0.43, 0.16), 0.05, 0.6),
    "turquoise": NamedColor((0.15, 0.72, 0.70), 0.07),
    "teal": NamedColor((0.06, 0.45, 0.46), 0.05, 0.6),
    "blue": NamedColor((0.13, 0.28, 0.75), 0.09, 2.0),
    "light blue": NamedColor((0.50, 0.74, 0.92), 0.06),
    "dark blue": NamedColor((0.07, 0.12, 0.36), 0.05),
    "purple": NamedColor((0.45, 0.18, 0.60), 0.08),
    "pink": NamedColor((0.94, 0.55, 0.70), 0.07, 1.2),
    "magenta": NamedColor((0.80, 0.14, 0.52), 0.06, 0.6),
    "white": NamedColor((0.93, 0.93, 0.92), 0.05, 2.0),
    "light grey": NamedColor((0.74, 0.74, 0.74), 0.05, 0.8),
    "grey": NamedColor((0.50, 0.50, 0.51), 0.07, 1.5),
    "dark grey": NamedColor((0.26, 0.26, 0.27), 0.05),
    "black": NamedColor((0.07, 0.07, 0.075), 0.04, 2.0),
    "golden": NamedColor((0.80, 0.62, 0.22), 0.06, 0.7),
    "silver": NamedColor((0.75, 0.76, 0.78), 0.05, 0.7),
}

ANY = tuple(COLORS)

SUBSTANCES: dict[str, tuple[str, ...]] = {
    "plain": ANY,
    "plastic": ANY,
    "ceramic": ANY,
    "porcelain": ("white", "white", "cream", "light blue", "light grey", "pink"),
    "clay": ("brown", "light brown", "orange", "dark red", "beige", "grey"),
    "wooden": ("brown", "light brown", "dark brown", "beige", "light brown", "brown", "golden"),
    "painted": ANY,
    "metal": ("grey", "silver", "dark grey", "black", "golden", "light grey", "silver", "red"),
    "golden": ("golden",),
    "glass": ("light blue", "green", "light green", "turquoise", "brown", "light grey", "blue"),
    "stone": ("grey", "light grey", "beige", "dark grey", "cream", "brown"),
    "marble": ("white", "light grey", "beige", "dark green", "black"),
    "leather": ("brown", "black", "dark brown", "dark red", "light brown", "white"),
    "fabric": ANY,
    "paper": ANY,
    "cardboard": ("light brown", "beige", "brown"),
    "rubber": ("yellow", "black", "red", "orange", "green", "blue", "dark grey", "white"),
    "wax": ("white", "cream", "red", "yellow", "green", "purple", "pink", "blue"),
    "straw": ("beige", "golden", "light brown", "cream"),
    "plush": ("brown", "light brown", "white", "pink", "beige", "grey", "dark brown", "blue"),
    "leafy": ("green", "dark green", "light green", "green", "olive"),
}
"""Substance word -> colours that things made of it come in."""


def sample_color(name: str, rng: np.random.Generator) -> Float32Array:  # [3]
    """Draw a colour near a named one."""
    named = COLORS[name]
    shift = rng.uniform(-named.spread, named.spread, 4)
    color = np.asarray(named.center) + 0.5 * shift[:3] + 0.5 * shift[3]
    return np.clip(color, 0.01, 0.99).astype(np.float32)


def pick_color(
    rng: np.random.Generator, names: Sequence[str] = ANY, avoid: Sequence[str] = ()
) -> str:
    """Draw a colour word by weight, not one of ``avoid`` unless nothing else is left."""
    options = [name for name in names if name not in avoid] or list(names)
    weights = np.cumsum([COLORS[name].weight for name in options])
    return options[int(np.searchsorted(weights, rng.random() * weights[-1], side="right"))]


def contrast(first: Float32Array, second: Float32Array) -> float:
    """Return the distance of two colours, weighting lightness most."""
    luma = np.array([0.3, 0.59, 0.11], np.float32)
    return float(np.abs(first - second).mean() + abs((first - second) @ luma))
