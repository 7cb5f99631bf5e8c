"""Leaves and pots, of which several plants are made.

Conventions
-----------
* Those of ``assembly`` and ``quads``.
"""

from __future__ import annotations

import math

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import Assembly, Look
from recipes.train_embedded_prior.procedural.primitives import cylinder
from recipes.train_embedded_prior.procedural.quads import Quads, grid
from recipes.train_embedded_prior.procedural.sweeps import revolve, shell_profile


def leaf(length: float, width: float, droop: float) -> Quads:
    """Return a curved leaf that starts at the origin along +x, folded a little in the middle."""
    t = np.linspace(0, 1, 9, dtype=np.float32)
    half = 0.5 * width * np.sin(math.pi * t**0.8)
    side = np.array([-1.0, 0.0, 1.0], np.float32)
    vertices = np.empty((3, 9, 3), np.float32)
    vertices[..., 0] = length * t
    vertices[..., 1] = side[:, None] * half
    vertices[..., 2] = (0.35 * t - droop * t * t) * length + np.abs(side)[:, None] * 0.2 * half
    return grid(vertices, vertices[..., :2].copy(), 0.25 * width)


def plant_pot(a: Assembly) -> tuple[Look, float]:
    """Add a pot with soil; return its look and height."""
    look = a.look(
        "clay",
        "ceramic",
        "plastic",
        "metal",
        "wooden",
        patterns=("bands", "rim", "zigzag", "dots"),
        pattern_chance=0.2,
    )
    height, top = a.uniform(0.25, 0.42), a.uniform(0.18, 0.28)
    line = [(top * a.uniform(0.6, 0.95), 0), (top, height)]
    if a.chance(0.5):
        line += [(top, height - 0.06), (top * 1.12, height - 0.06), (top * 1.12, height)]
        line = [line[0], line[2], line[3], line[4]]
    a.add(revolve(shell_profile(line, 0.03), a.choose([24, 24, 4, 6])), look)
    soil = a.look(colors=("dark brown",))
    a.add(cylinder(top * 0.88, 0.02), soil, (0, 0, height - 0.06))
    return look, height - 0.05
