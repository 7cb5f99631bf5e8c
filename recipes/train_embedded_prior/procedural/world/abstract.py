"""Abstract families: shapes without a name, which teach surfaces, symmetry and closure."""

from __future__ import annotations

import math

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    DECORATIONS,
    Assembly,
    Description,
    Look,
)
from recipes.train_embedded_prior.procedural.primitives import (
    box,
    cylinder,
    ellipsoid,
    prism,
    regular_polygon,
)
from recipes.train_embedded_prior.procedural.quads import Quads, turn_about
from recipes.train_embedded_prior.procedural.sweeps import (
    revolve,
    shell_profile,
    smooth_profile,
    torus,
    tube,
)

SUBSTANCES_OF_SHAPES = ("plastic", "stone", "wooden", "metal", "ceramic", "plain", "plain")
NOUNS = ("abstract shape", "shape", "sculpture", "object", "abstract sculpture", "thing")


def any_look(a: Assembly, avoid: Look | None = None) -> Look:
    """Draw any look at all."""
    return a.look(*SUBSTANCES_OF_SHAPES, avoid=avoid, patterns=DECORATIONS)


def any_turn(a: Assembly) -> np.ndarray:
    """Draw a rotation: none, about one axis, or any."""
    if a.chance(0.3):
        return np.eye(3, dtype=np.float32)
    turn = turn_about("z", a.uniform(0, 360)) @ turn_about("x", a.uniform(0, 360))
    return turn @ turn_about("y", a.uniform(0, 360))


def any_part(a: Assembly, size: float) -> Quads:
    """Draw a primitive of about a given half size, centred near the origin."""
    x, y, z = (size * a.uniform(0.4, 1.2) for _ in range(3))
    kind = a.integer(0, 6)
    if kind == 0:
        return box((2 * x, 2 * y, 2 * z), taper=(a.uniform(0.3, 1), a.uniform(0.3, 1)))
    if kind == 1:
        return cylinder(x, 2 * z, x * a.choose([1.0, 0.5, 0.0]), segments=a.choose([24, 24, 6, 3]))
    if kind == 2:
        return torus(x, 0.35 * min(x, z))
    if kind == 3:
        outline = regular_polygon(a.integer(3, 7), x, star=a.choose([1.0, 1.0, 0.5]))
        return prism(outline, 2 * z, top_scale=a.choose([1.0, 1.0, 0.6]))
    if kind == 4:
        knots = a.rng.uniform(-1.3, 1.3, (4, 3)) * size
        return tube(smooth_profile(knots, 14), size * a.uniform(0.15, 0.35), sides=10)
    roundness = (a.uniform(0.2, 1.6), a.uniform(0.2, 1.6))
    return ellipsoid((x, y, z), roundness=roundness, rows=14)


def superquadric(a: Assembly) -> Description:
    """One superellipsoid, perhaps bent or twisted."""
    look = any_look(a)
    radii = a.rng.uniform(0.2, 0.6, 3)
    part = ellipsoid(
        radii.tolist(), roundness=(a.uniform(0.15, 2), a.uniform(0.15, 2)), rows=20, segments=32
    )
    a.add(deformed(a, part), look, turn=any_turn(a) if a.chance(0.5) else None)
    return Description(("abstract shape", "shape", "block", "solid"), look)


def deformed(a: Assembly, part: Quads) -> Quads:
    """Return a part twisted about z, bent, or rippled, each by chance."""
    corners = part.corners.copy()
    z = corners[..., 2]
    if a.chance(0.4):
        angle = a.uniform(-2.5, 2.5) * z
        cos, sin = np.cos(angle), np.sin(angle)
        x, y = corners[..., 0].copy(), corners[..., 1].copy()
        corners[..., 0], corners[..., 1] = cos * x - sin * y, sin * x + cos * y
    if a.chance(0.3):
        corners[..., 0] += a.uniform(-0.8, 0.8) * z * z
    if a.chance(0.3):
        wave = np.sin(a.uniform(4, 12) * z + a.uniform(0, 6))
        corners[..., :2] *= (1 + a.uniform(0.05, 0.2) * wave)[..., None]
    return Quads(corners.astype(np.float32), part.uv, part.feature)


def blob(a: Assembly) -> Description:
    """A lumpy closed surface: a sphere moved by smooth waves."""
    look = any_look(a)
    part = ellipsoid((0.5, 0.5, 0.5 * a.uniform(0.5, 1.5)), rows=24, segments=36)
    corners = part.corners
    radius = np.ones(corners.shape[:2], np.float32)
    for _ in range(a.integer(2, 5)):
        wave = a.rng.normal(size=3) * a.uniform(2, 7)
        radius += a.uniform(0.04, 0.18) * np.sin(
            corners @ wave.astype(np.float32) + a.uniform(0, 6)
        )
    a.add(Quads(corners * radius[..., None], part.uv, None), look)
    return Description(("rock", "blob", "stone", "abstract shape", "lump"), look)


def composition(a: Assembly) -> Description:
    """A few overlapping primitives."""
    look = any_look(a)
    second = any_look(a, look)
    for _ in range(a.integer(2, 6)):
        at = a.rng.uniform(-0.4, 0.4, 3).tolist()
        part = any_part(a, a.uniform(0.12, 0.35))
        a.add(part, look if a.chance(0.65) else second, at, any_turn(a))
    return Description(NOUNS, look, (f"{second.color} parts",))


def mirrored(a: Assembly) -> Description:
    """Primitives with a plane of symmetry."""
    look = any_look(a)
    second = any_look(a, look)
    a.add(any_part(a, a.uniform(0.2, 0.4)), look)
    for _ in range(a.integer(1, 4)):
        at = (a.uniform(-0.4, 0.4), a.uniform(0.05, 0.5), a.uniform(-0.3, 0.5))
        part = any_part(a, a.uniform(0.08, 0.25))
        a.add_mirrored(part, look if a.chance(0.5) else second, at, any_turn(a))
    return Description((*NOUNS, "symmetric shape"), look, (f"{second.color} parts",))


def rosette(a: Assembly) -> Description:
    """Primitives repeated around the z axis, about a core."""
    look = any_look(a)
    second = any_look(a, look)
    if a.chance(0.8):
        a.add(cylinder(a.uniform(0.1, 0.3), a.uniform(0.2, 1.0), a.uniform(0.05, 0.3)), look)
    for _ in range(a.integer(1, 3)):
        part = any_part(a, a.uniform(0.08, 0.2)).moved(any_turn(a), (0, 0, 0))
        at = (a.uniform(0.15, 0.5), 0, a.uniform(0, 0.9))
        a.add_around(part, second if a.chance(0.6) else look, a.integer(3, 8), at)
    return Description((*NOUNS, "symmetric shape", "ornament"), look, (f"{second.color} parts",))


def turned(a: Assembly) -> Description:
    """A random surface of revolution, closed or hollow, smooth or stepped."""
    look = any_look(a)
    count = a.integer(3, 8)
    radii, heights = a.rng.uniform(0.05, 0.5, count), np.sort(a.rng.uniform(0, 1, count))
    heights = (heights - heights[0]) / (heights[-1] - heights[0])
    line = np.stack([radii, heights], axis=1)
    if a.chance(0.65):
        line = smooth_profile(line, 22)
        line[:, 0] = line[:, 0].clip(0.03)
    if a.chance(0.35):
        line = shell_profile(line, 0.04)
    else:
        line = np.concatenate([[(0, line[0, 1])], line, [(0, line[-1, 1])]])
    lobes = a.integer(3, 12) if a.chance(0.2) else 0
    segments = a.choose([28, 28, 28, 3, 4, 5, 6, 8])
    a.add(revolve(line, segments, lobes=lobes, lobe_depth=0.15), look)
    return Description(("turned shape", "abstract shape", "spindle", "shape", "vessel"), look)


def stack(a: Assembly) -> Description:
    """Blocks or discs piled up, shrinking or turning."""
    first = any_look(a)
    looks = [first, *(any_look(a, first) for _ in range(a.integer(0, 3)))]
    z, size, turn = 0.0, 0.5, a.choose([0.0, a.uniform(0, 45)])
    kind, shrink = a.integer(0, 2), a.uniform(0.7, 1.0)
    for k in range(a.integer(2, 7)):
        height = a.uniform(0.08, 0.3)
        look = looks[k % len(looks)]
        if kind == 0:
            part = box((2 * size, 2 * size * a.uniform(0.7, 1), height))
        elif kind == 1:
            part = cylinder(size, height, size * a.uniform(0.8, 1))
        else:
            part = ellipsoid((size, size, 0.55 * height)).moved(None, (0, 0, 0.5 * height))
        a.add(part, look, (a.uniform(-0.03, 0.03), 0, z), turn_about("z", turn * k))
        z, size = z + height, size * shrink
    return Description(("stack", "tower of blocks", "pile", "stacked shape"), first)


def frame(a: Assembly) -> Description:
    """A wire frame or knot of tubes."""
    look = any_look(a)
    thickness = a.uniform(0.02, 0.08)
    if a.chance(0.5):
        p, q = a.choose([(2, 3), (3, 2), (1, 0), (2, 5), (1, 3)])
        t = np.linspace(0, 2 * math.pi, 49)
        ring = 0.35 + 0.13 * np.cos(q * t)
        path = np.stack([ring * np.cos(p * t), ring * np.sin(p * t), 0.15 * np.sin(q * t)], axis=1)
        a.add(tube(path, thickness, sides=10, closed=True), look, turn=any_turn(a))
        return Description(("knot", "abstract sculpture", "twisted ring", "loop"), look)
    turns = a.uniform(1.5, 4)
    t = np.linspace(0, 1, 60)
    radius = 0.3 * (1 - a.uniform(0, 0.8) * t)
    angle = 2 * math.pi * turns * t
    path = np.stack([radius * np.cos(angle), radius * np.sin(angle), t], axis=1)
    a.add(tube(path, thickness), look)
    if a.chance(0.5):
        a.add(cylinder(0.35, 0.06), any_look(a, look))
    return Description(("spiral", "spring", "coil", "helix", "abstract sculpture"), look)


FAMILIES = (superquadric, blob, composition, mirrored, rosette, turned, stack, frame)
