"""Bodies put together at random: a spine, limbs, a head, and what grows on them or is carried.

``families_creatures`` and ``families_figures`` build the usual animals and people; here every pose
and body plan occurs, with both sides alike or each in its own pose.
"""

from __future__ import annotations

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    DECORATIONS,
    Assembly,
    Description,
    Look,
)
from recipes.train_embedded_prior.procedural.families_abstract import any_look, any_part
from recipes.train_embedded_prior.procedural.primitives import box, cylinder, ellipsoid
from recipes.train_embedded_prior.procedural.quads import FloatArray
from recipes.train_embedded_prior.procedural.sweeps import rod, smooth_profile, tube

_SPINE_POINTS = 11


def spine(a: Assembly, upright: bool, leg: float) -> FloatArray:  # [P, 3]
    """Return the middle line of a trunk from the hips to the neck."""
    length = a.uniform(0.3, 0.8)
    if upright:
        knots = [
            (0, 0, leg),
            (a.uniform(-0.1, 0.1), 0, leg + 0.5 * length),
            (a.uniform(-0.08, 0.12), 0, leg + length),
        ]
    else:
        rise = a.uniform(-0.05, 0.3)
        knots = [
            (-0.5 * length, 0, leg),
            (0, 0, leg + a.uniform(-0.06, 0.08)),
            (0.5 * length, 0, leg + rise),
        ]
    return smooth_profile(np.array(knots), _SPINE_POINTS)


def trunk_radii(a: Assembly) -> FloatArray:  # [P]
    """Return the half widths of a trunk along its spine."""
    knots = a.rng.uniform(0.07, 0.24, 4)
    return np.interp(np.linspace(0, 3, _SPINE_POINTS), range(4), knots).astype(np.float32)


def limb(
    a: Assembly,
    look: Look,
    end_look: Look,
    root: FloatArray,  # [3]
    way: FloatArray,  # [3] unit
    length: float,
    thick: float,
    bend: FloatArray,  # [3] added to the way beyond the joint
) -> FloatArray:  # [3] where it ends
    """Add a limb of two segments and what it ends in."""
    joint = root + 0.5 * length * way
    beyond = way + bend
    end = joint + 0.5 * length * beyond / max(float(np.linalg.norm(beyond)), 1e-6)
    line = smooth_profile(np.stack([root, joint, end]), 9)
    radii = np.interp(
        np.linspace(0, 1, len(line)), [0, 0.5, 1], [thick, 0.85 * thick, 0.65 * thick]
    )
    a.add(tube(line, radii, sides=10), look)
    a.add(ellipsoid((1.3 * thick, 0.9 * thick, 0.8 * thick)), end_look, end.tolist())
    return end


def limbs(
    a: Assembly,
    look: Look,
    end_look: Look,
    root: FloatArray,  # [3] at y = 0
    out: float,
    ways: tuple[FloatArray, FloatArray],  # [3] unit, of the left and the right
    sizes: tuple[float, float],
    bends: tuple[FloatArray, FloatArray],  # [3]
) -> FloatArray:  # [3] the left one's end
    """Add a pair of limbs; poses are given for the left and mirrored for the right."""
    mirror = np.array([1, -1, 1], np.float32)
    length, thick = sizes
    left = root + np.array([0, out, 0], np.float32)
    end = limb(a, look, end_look, left, ways[0], length, thick, bends[0])
    limb(a, look, end_look, left * mirror, ways[1] * mirror, length, thick, bends[1] * mirror)
    return end


def poses(
    a: Assembly, low: tuple[float, float, float], high: tuple[float, float, float], alike: bool
) -> tuple[FloatArray, FloatArray]:  # [3] unit
    """Draw directions of a left and a right limb between two bounds."""
    first = a.rng.uniform(low, high).astype(np.float32)
    second = first if alike else a.rng.uniform(low, high).astype(np.float32)
    return first / np.linalg.norm(first), second / np.linalg.norm(second)


def bends_of(a: Assembly, most: float, alike: bool) -> tuple[FloatArray, FloatArray]:  # [3]
    """Draw how the two limbs of a pair bend."""
    first = a.rng.uniform(-most, most, 3).astype(np.float32)
    return first, first if alike else a.rng.uniform(-most, most, 3).astype(np.float32)


def head(a: Assembly, look: Look, second: Look, at: FloatArray) -> None:
    """Add a head with some of: snout, ears, horns, hat, eyes."""
    size = a.uniform(0.07, 0.2)
    center = at + np.array([a.uniform(0, 0.6) * size, 0, 0.8 * size], np.float32)
    x, y, z = center.tolist()
    if a.chance(0.2):
        a.add(box((2 * size, 2 * size, 2 * size)), look, (x, y, z - size))
    else:
        round_head = ellipsoid((size, size * a.uniform(0.7, 1.2), size * a.uniform(0.8, 1.3)))
        a.add(round_head, look, (x, y, z))
    if a.chance(0.5):
        snout = (size * a.uniform(0.3, 0.9), 0.4 * size, 0.35 * size)
        a.add(ellipsoid(snout), look if a.chance(0.6) else second, (x + size, 0, z - 0.2 * size))
    if a.chance(0.6):
        tip = (a.uniform(-0.6, 0.6), a.uniform(0.4, 1.6), a.uniform(0.6, 2.0))
        end = tuple(c * size + o for c, o in zip(tip, (x, 0, z), strict=True))
        start = (x, 0.6 * size, z + 0.5 * size)
        a.add_mirrored(rod(start, end, 0.3 * size, 0.08 * size), second, (0, 0, 0))
    if a.chance(0.25):
        a.add(cylinder(1.15 * size, 0.5 * size, size), second, (x, 0, z + 0.6 * size))
    dark = a.look(colors=("black", "white"))
    a.add_mirrored(ellipsoid((0.015, 0.015, 0.015)), dark, (x + 0.9 * size, 0.4 * size, z))


def growths(a: Assembly, look: Look, second: Look, line: FloatArray, radii: FloatArray) -> None:
    """Add a tail, a shell, wings or spikes, each by chance."""
    back = line[0] if a.chance(0.8) else line[2]
    if a.chance(0.4):
        knots = [back]
        for step in a.rng.uniform((-0.3, -0.08, -0.3), (-0.05, 0.08, 0.25), (3, 3)):
            knots.append(knots[-1] + step.astype(np.float32))
        thick = float(radii[0]) * a.uniform(0.2, 0.6)
        tail = smooth_profile(np.stack(knots), 12)
        a.add(tube(tail, np.linspace(thick, 0.2 * thick, len(tail)), sides=8), look)
    middle, wide = line[_SPINE_POINTS // 2], float(radii.max())
    x, _, z = middle.tolist()
    if a.chance(0.25):
        shell = ellipsoid((0.6 * wide, 1.1 * wide, 1.5 * wide))
        a.add(shell, second, (x - 0.7 * wide, 0, z))
    if a.chance(0.15):
        wing = ellipsoid((0.02, a.uniform(0.15, 0.4), a.uniform(0.1, 0.25)))
        a.add_mirrored(wing, second, (x - wide, 1.5 * wide, z + 0.1))


def body(a: Assembly) -> Description:
    """A creature or figure: upright or on four legs, at rest or in motion, perhaps on a base."""
    statue = a.chance(0.3)
    look = (
        a.look("stone", "metal", "marble", "wooden", "clay")
        if statue
        else a.look("plastic", "plush", "fabric", "plain", patterns=DECORATIONS, pattern_chance=0.2)
    )
    second, third = (look, look) if statue else (any_look(a, look), any_look(a, look))
    upright, alike, leg = a.chance(0.65), a.chance(0.5), a.uniform(0.1, 0.55)
    line, radii = spine(a, upright, leg), trunk_radii(a)
    a.add(tube(line, radii, sides=14, flatten=a.uniform(0.75, 1.3)), look)
    for end in (0, -1):
        a.add(ellipsoid((radii[end],) * 3), look, line[end].tolist())
    head(a, look, second, line[-1])
    stride = 0.5 if a.chance(0.4) else 0.12
    legs = look if a.chance(0.5) else second
    pairs = [(0, 0.6 * radii[0])] if upright else [(1, 0.7 * radii[1]), (-2, 0.7 * radii[-2])]
    for at, out in pairs:
        thick = float(radii[at]) * a.uniform(0.3, 0.6)
        ways = poses(a, (-stride, 0.0, -1.0), (stride, 0.3, -1.0), alike)
        bends = bends_of(a, 0.25, alike)
        reach = float(line[at][2]) * 1.05
        limbs(a, legs, third, line[at], float(out), ways, (reach, thick), bends)
    if upright:
        thick = float(radii[-2]) * a.uniform(0.25, 0.5)
        ways = poses(a, (-0.4, 0.3, -1.0), (1.0, 1.0, 1.0 if a.chance(0.4) else -0.2), alike)
        length = a.uniform(0.25, 0.6)
        bends = bends_of(a, 0.9, alike)
        out = 0.9 * float(radii[-2])
        hand = limbs(a, look, second, line[-2], out, ways, (length, thick), bends)
        if a.chance(0.25):
            a.add(any_part(a, a.uniform(0.05, 0.15)), any_look(a, look), hand.tolist())
        elif a.chance(0.15):
            x, y, z = hand.tolist()
            a.add(rod((x, y, 0), (x, y, z + a.uniform(0.1, 0.5)), 0.02), any_look(a, look))
    growths(a, look, second, line, radii)
    if a.chance(0.5 if statue else 0.1):
        wide = a.uniform(0.2, 0.4)
        a.add(box((2 * wide, 2 * wide, 0.12)) if a.chance(0.5) else cylinder(wide, 0.12), second,
              (0, 0, -0.1))  # fmt: skip
    nouns = ("figure", "figurine", "person", "character", "doll") if upright else ("animal", "toy")
    return Description(("statue", "sculpture", "figure") if statue else nouns, look)


FAMILIES = (body,)
