"""Play families: balls, blocks, toys and weights."""

from __future__ import annotations

import math

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    DECORATIONS,
    Assembly,
    Description,
    Look,
)
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.materials import Mark, MarkShape, Material
from recipes.train_embedded_prior.procedural.palette import sample_color
from recipes.train_embedded_prior.procedural.primitives import box, cylinder, disc, ellipsoid
from recipes.train_embedded_prior.procedural.quads import turn_about
from recipes.train_embedded_prior.procedural.sweeps import (
    arc,
    revolve,
    rod,
    smooth_profile,
    torus,
    tube,
)

GOLDEN = (1 + math.sqrt(5)) / 2
UPRIGHT = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], np.float32)
"""Turns a prism drawn in (x, y) into one whose outline is (y, z), extruded along +x."""


def ball(a: Assembly) -> Description:
    """A soccer ball, beach ball, basketball, tennis ball or plain ball."""
    kind = a.choose(["soccer", "soccer", "beach", "basketball", "tennis", "plain"])
    radius = 0.5
    if kind == "soccer":
        look = a.look(colors=("white", "white", "yellow", "light blue", "orange"))
        dark = a.choose(["black", "black", "dark blue", "red"])
        tone = sample_color(dark, a.rng)
        corners = [
            p for s in (-1, 1) for t in (-GOLDEN, GOLDEN) for p in ((0, s, t), (s, t, 0), (t, 0, s))
        ]
        scale = radius / math.sqrt(1 + GOLDEN**2)
        marks = [
            Mark(tuple(scale * v for v in p), (0, 0, 1), (0.19, 0.19), tone, "ball")
            for p in corners
        ]
        look = look.marked(*marks)
        a.add(ellipsoid((radius,) * 3, rows=16, segments=24), look, (0, 0, radius))
        moved = [
            Mark(
                (m.center[0], m.center[1], m.center[2] + radius), m.facing, m.size, m.color, "ball"
            )
            for m in marks
        ]
        a.materials[-1] = Material(look.material.color, marks=tuple(moved))
        details = (f"{dark} spots", f"{dark} patches")
        return Description(("soccer ball", "ball", "football"), look, details)
    if kind == "beach":
        look = a.look(colors=("white", "red", "blue", "yellow"))
        angle = np.linspace(-np.pi / 2, np.pi / 2, 13)
        line = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        quads = revolve(line, 24)
        sector = np.arange(len(quads.corners)) % 24 // 4
        names = []
        for k in range(6):
            colors = ("red", "blue", "yellow", "green", "orange", "white", "pink")
            other = look if k == 0 else a.look(colors=colors, avoid=look)
            names.append(other.color)
            part = type(quads)(quads.corners[sector == k], quads.uv[sector == k], None)
            a.add(part, other)
        return Description(
            ("beach ball", "ball", "toy ball"),
            look,
            (f"{names[1]} stripes", f"{names[1]} and {names[2]} stripes"),
        )
    if kind in ("basketball", "tennis"):
        look = a.look(colors=("orange",) if kind == "basketball" else ("yellow", "light green"))
        seam = a.look(colors=("black",) if kind == "basketball" else ("white",))
        a.add(ellipsoid((radius,) * 3, rows=16, segments=24), look)
        for axis in ("x", "y"):
            a.add(torus(radius, 0.014, segments=32, sides=5), seam, turn=turn_about(axis, 90))
        if kind == "basketball":
            a.add(torus(radius, 0.014, segments=32, sides=5), seam)
        nouns = ("basketball", "ball") if kind == "basketball" else ("tennis ball", "ball")
        return Description(nouns, look, (f"{seam.color} stripes",))
    look = a.look(
        "rubber", "plastic", "glass", "metal", "wooden", patterns=DECORATIONS, pattern_chance=0.5
    )
    a.add(ellipsoid((radius,) * 3, rows=16, segments=28), look)
    if a.chance(0.15):
        hole = a.look(colors=("black",)).material.color
        spots = [
            Mark((0.06 * k, 0.08 * (k % 2), radius), (0, 0, 1), (0.05, 0.05), hole)
            for k in range(3)
        ]
        a.materials[-1] = look.marked(*spots).material
        return Description(("bowling ball", "ball"), look)
    return Description(("ball", "ball", "rubber ball", "toy ball"), look, (), ("round", "plain"))


def toy_block(a: Assembly) -> Description:
    """A lettered cube, dice, domino, or a building brick."""
    kind = a.choose(["letter", "dice", "brick", "domino", "cube"])
    look = a.look("wooden", "plastic", "painted")
    if kind in ("letter", "dice"):
        marks = []
        tone = a.look(avoid=look).material.color
        for axis in range(3):
            for sign in (1.0, -1.0):
                facing = [0.0, 0.0, 0.0]
                facing[axis] = sign
                center = np.array([0, 0, 0.5]) + 0.5 * np.array(facing)
                if kind == "letter":
                    rim: list[tuple[MarkShape, float]] = [("rectangle", 0.42), ("rectangle", 0.36)]
                    shape: MarkShape = a.choose(["label", "star", "disc", "ring"])
                    for (name, size), paint in zip(rim, (tone, look.material.color), strict=True):
                        marks.append(Mark(tuple(center), tuple(facing), (size, size), paint, name))
                    color = a.look(avoid=look).material.color
                    marks.append(Mark(tuple(center), tuple(facing), (0.26, 0.26), color, shape))
                    continue
                across = np.roll(np.eye(3)[axis], 1), np.roll(np.eye(3)[axis], 2)
                for k in range(a.integer(1, 3)):
                    spot = center + (k - 1) * 0.26 * (across[0] + across[1])
                    marks.append(Mark(tuple(spot), tuple(facing), (0.09, 0.09), tone, "ball"))
        cube = (
            ellipsoid((0.5,) * 3, roundness=(0.12, 0.12), rows=16, segments=24)
            if a.chance(0.4)
            else box((1, 1, 1)).moved(None, (0, 0, -0.5))
        )
        a.add(cube, look.marked(*marks), (0, 0, 0.5))
        nouns = (
            ("toy block", "block", "wooden block") if kind == "letter" else ("dice", "die", "cube")
        )
        details = ("letters", "lettered faces") if kind == "letter" else ("spots", "dots")
        nouns = ("toy block", "block", "letter block") if look.substance != "wooden" else nouns
        return Description(nouns, look, details)
    if kind == "domino":
        tile = a.look("plastic", colors=("white", "black", "cream"))
        ink = sample_color("black" if tile.color != "black" else "white", a.rng)
        marks = [
            Mark((0.1, y, 0.5 + s * (0.25 + z)), (1, 0, 0), (0.06, 0.06), ink, "ball")
            for s in (-1, 1)
            for y, z in ((0.13, 0.12), (-0.13, -0.12), (0, 0))[: a.integer(1, 3)]
        ]
        marks.append(Mark((0.1, 0, 0.5), (1, 0, 0), (0.22, 0.015), ink, "rectangle"))
        a.add(box((0.2, 0.5, 1)), tile.marked(*marks))
        return Description(("domino", "domino tile", "tile"), tile, ("dots", "spots"))
    if kind == "brick":
        x, y = a.choose([(1, 2), (2, 2), (2, 3), (2, 4), (1, 4)])
        plastic = a.look("plastic")
        a.add(box((0.25 * x, 0.25 * y, 0.3)), plastic)
        for i in range(x):
            for j in range(y):
                at = ((i - 0.5 * (x - 1)) * 0.25, (j - 0.5 * (y - 1)) * 0.25, 0.3)
                a.add(cylinder(0.075, 0.06, segments=12), plastic, at)
        return Description(("building block", "toy block"), plastic)
    colors = [a.look("plastic").material.color for _ in range(6)]
    a.add(box((0.97, 0.97, 0.97)), a.look(colors=("black",)), (0, 0, 0.015))
    for k in range(27):
        for axis in range(3):
            for sign in (1, -1):
                cell = np.array([k % 3, k // 3 % 3, k // 9]) - 1
                if cell[axis] != sign:
                    continue
                tone = (
                    colors[int(a.rng.integers(6))]
                    if a.chance(0.5)
                    else colors[2 * axis + (sign > 0)]
                )
                size = [0.27, 0.27, 0.27]
                size[axis] = 0.03
                at = cell * 0.325
                at = at + 0.17 * sign * np.eye(3)[axis]
                part = box(size).moved(None, (0, 0, -0.5 * size[2]))
                sticker = Look(Material(tone), "red", "plastic")
                a.add(part, sticker, (at[0], at[1], at[2] + 0.5))
    return Description(
        ("puzzle cube", "cube", "toy cube"),
        a.look(colors=("black",)),
        ("colorful faces", "colorful squares"),
    )


def top(a: Assembly) -> Description:
    """A spinning top, yo-yo, stacking rings or drum."""
    look = a.look(
        "wooden",
        "plastic",
        "metal",
        patterns=("bands", "stripes", "dots", "checks"),
        pattern_chance=0.5,
    )
    trim = a.look("wooden", "plastic", "metal", avoid=look)
    kind = a.choose(["top", "rings", "drum", "yo-yo"])
    if kind == "top":
        line = smooth_profile(
            [(0, 0), (0.1, 0.1), (0.45, 0.38), (0.3, 0.52), (0.05, 0.6)], 16
        ).clip(0)
        a.add(revolve(line, 28), look)
        a.add(cylinder(0.045, 0.35, 0.035), trim, (0, 0, 0.55))
        return Description(("spinning top", "top", "toy top"), look, (detail(trim, "handle"),))
    if kind == "rings":
        a.add(cylinder(0.4, 0.08), trim)
        z, r, count = 0.08, 0.38, a.integer(3, 6)
        for _ in range(count):
            ring = a.look("plastic", "wooden")
            a.add(torus(r * 0.68, 0.09), ring, (0, 0, z + 0.09))
            z, r = z + 0.17, r * 0.88
        a.add(cylinder(0.06, z - 0.05), trim, (0, 0, 0.05))
        a.add(ellipsoid((0.1, 0.1, 0.1)), trim, (0, 0, z + 0.06))
        return Description(("stacked rings", "toy tower", "toy"), ring, ("colorful rings",))
    if kind == "drum":
        skin = a.look("leather", colors=("white", "cream", "beige"))
        height = a.uniform(0.4, 1.0)
        a.add(revolve([(0, 0), (0.42, 0), (0.42, height)], 28), look)
        a.add(disc(0.42), skin, (0, 0, height))
        for z in (0.02, height):
            a.add(torus(0.43, 0.03, sides=8), trim, (0, 0, z))
        return Description(("drum", "toy drum"), look, (detail(trim, "rim"), "a white top"))
    for sign in (-1.0, 1.0):
        half = revolve(
            smooth_profile([(0.06, 0), (0.4, 0.06), (0.42, 0.16), (0, 0.24)], 10).clip(0), 24
        )
        turn = np.eye(3) if sign > 0 else turn_about("x", 180)
        a.add(half, look if sign > 0 else trim, (0, 0, sign * 0.02), turn_about("y", 90) @ turn)
    a.add(cylinder(0.08, 0.1), trim, (-0.05, 0, 0), turn_about("y", 90))
    return Description(("yo-yo", "toy"), look, (f"a {trim.color} side",))


def dumbbell(a: Assembly) -> Description:
    """A dumbbell, barbell or kettlebell."""
    look = a.look(
        "metal",
        "rubber",
        colors=("black", "dark grey", "grey", "red", "blue", "green", "pink", "purple"),
    )
    bar = a.look("metal", colors=("silver", "grey", "black"), avoid=look)
    sideways = turn_about("x", 90)
    kind = a.choose(["dumbbell", "dumbbell", "barbell", "kettlebell"])
    if kind == "kettlebell":
        a.add(
            revolve(
                smooth_profile([(0.2, 0), (0.36, 0.3), (0.12, 0.62), (0, 0.64)], 14).clip(0), 24
            ),
            look,
        )
        loop = arc(-30, 210, 0.2, 13, plane="yz") * np.array([1, 1, 0.9], np.float32)
        a.add(tube(loop, 0.05), look if a.chance(0.6) else bar, (0, 0, 0.66))
        return Description(("kettlebell", "weight"), look, ("a handle",))
    half = 0.5 if kind == "dumbbell" else 1.0
    a.add(rod((0, -half, 0.25), (0, half, 0.25), 0.04), bar)
    segments = a.choose([24, 24, 6])
    y = 0.24 if kind == "dumbbell" else 0.62
    for _ in range(a.integer(1, 3)):
        r, thick = a.uniform(0.16, 0.28), a.uniform(0.07, 0.16)
        a.add_mirrored(cylinder(r, thick, segments=segments), look, (0, y + thick, 0.25), sideways)
        y += thick + 0.01
    if kind == "dumbbell" and a.chance(0.25):
        a.add_mirrored(ellipsoid((0.22, 0.2, 0.22)), look, (0, 0.38, 0.25))
    nouns = (
        ("dumbbell", "dumbbell", "weight")
        if kind == "dumbbell"
        else ("barbell", "barbell", "weights")
    )
    return Description(nouns, look, (detail(bar, "handle"), detail(look, "weights", plural=True)))


FAMILIES = (
    ball,
    toy_block,
    top,
    dumbbell,
)
