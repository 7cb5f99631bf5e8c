"""Furniture families: things to sit at and on."""

from __future__ import annotations

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    DECORATIONS,
    Assembly,
    Description,
    Look,
)
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.primitives import box, cylinder, ellipsoid
from recipes.train_embedded_prior.procedural.quads import Quads
from recipes.train_embedded_prior.procedural.sweeps import rod, torus, tube


def cushion(x: float, y: float, z: float) -> Quads:
    """Return a soft box standing on z = 0."""
    part = ellipsoid((0.5 * x, 0.5 * y, 0.5 * z), roundness=(0.35, 0.25))
    return part.moved(None, (0, 0, 0.5 * z))


def four_legs(
    a: Assembly, look: Look, x: float, y: float, height: float, *, thickness: float | None = None
) -> None:
    """Add straight, tapered, splayed or square legs under a top of half size (x, y)."""
    size = thickness or a.uniform(0.02, 0.05)
    style = a.choose(["square", "round", "splayed"])
    splay = a.uniform(0.04, 0.12) if style == "splayed" else 0.0
    for side in (-1.0, 1.0):
        foot = (side * (x - size + splay), y - size + splay, 0.0)
        top = (side * (x - size - splay), y - size - splay, height)
        if style == "square":
            part = box((2 * size, 2 * size, height)).moved(None, (foot[0], foot[1], 0))
        else:
            part = rod(foot, top, size * (0.7 if style == "splayed" else 1.0), size)
        a.add_mirrored(part, look, (0, 0, 0))


def pedestal(a: Assembly, look: Look, height: float, reach: float) -> None:
    """Add one central leg on a round or crossed foot."""
    a.add(cylinder(a.uniform(0.03, 0.08), height, a.uniform(0.03, 0.06)), look)
    if a.chance(0.5):
        a.add(cylinder(reach, 0.05, reach * a.uniform(0.3, 0.95)), look)
    else:
        a.add_around(box((reach, 0.07, 0.05)), look, a.integer(3, 5), (0.5 * reach, 0, 0))


def chair_back(a: Assembly, look: Look, frame: Look, depth: float, width: float, z: float) -> str:
    """Add a back rest of one of several kinds behind the seat; return its name."""
    height, lean = a.uniform(0.35, 0.75), a.uniform(0.0, 0.12)
    kind = a.choose(["panel", "slats", "rungs", "pad", "round"])
    x = -0.5 * depth + 0.03
    if kind == "panel":
        a.add(box((0.04, width, height), shear=(-lean, 0)), look, (x, 0, z))
        return kind
    if kind == "pad":
        a.add(box((0.03, 0.08, 0.5 * height), shear=(-0.5 * lean, 0)), frame, (x, 0, z))
        a.add(cushion(0.1, width, 0.6 * height), look, (x - 0.5 * lean, 0, z + 0.4 * height))
        return kind
    top = (x - lean, 0.5 * width - 0.03, z + height)
    if kind == "round":
        angle = np.linspace(0, np.pi, 13)
        path = np.stack(
            [
                x - lean * np.sin(angle),
                0.5 * width * np.cos(angle) * 0.95,
                z + height * np.sin(angle),
            ],
            axis=1,
        )
        a.add(tube(path, 0.025), frame)
        for y in np.linspace(-0.3 * width, 0.3 * width, a.integer(3, 5)):
            rise = height * np.sqrt(1 - (y / (0.5 * width)) ** 2)
            a.add(rod((x, y, z), (x - lean, y, z + rise), 0.012), frame)
        return kind
    a.add_mirrored(rod((x, top[1], z), top, 0.028), frame, (0, 0, 0))
    count = a.integer(2, 5)
    if kind == "slats":
        for k in range(count):
            t = (k + 1.0) / count
            slat = box((0.025, width - 0.04, height * 0.4 / count))
            a.add(slat, look, (x - lean * t, 0, z + height * (t - 0.3 / count)))
    else:
        a.add(box((0.035, width, 0.08)), frame, (top[0], 0, z + height - 0.05))
        for y in np.linspace(-0.35 * width, 0.35 * width, count + 1):
            a.add(rod((x, y, z), (x - lean, y, z + height), 0.014), frame)
    return kind


def chair(a: Assembly) -> Description:
    """A chair with four legs or a pedestal."""
    look = a.look(
        "wooden",
        "wooden",
        "plastic",
        "fabric",
        "leather",
        "metal",
        patterns=DECORATIONS,
        pattern_chance=0.15,
    )
    frame = look if a.chance(0.5) else a.look("wooden", "metal", avoid=look)
    width, depth, z = a.uniform(0.42, 0.6), a.uniform(0.4, 0.55), a.uniform(0.4, 0.6)
    if a.chance(0.85):
        four_legs(a, frame, 0.5 * depth, 0.5 * width, z)
        if a.chance(0.3):
            for y in (-1, 1):
                bar = 0.5 * width * y * 0.9
                a.add(
                    rod((-0.45 * depth, bar, 0.4 * z), (0.45 * depth, bar, 0.4 * z), 0.015), frame
                )
    else:
        pedestal(a, frame, z, 0.28)
    if a.chance(0.4):
        a.add(cushion(depth, width, 0.12), look, (0, 0, z - 0.02))
    elif a.chance(0.2):
        a.add(cylinder(0.52 * width, 0.05), look, (0, 0, z))
    else:
        a.add(box((depth, width, 0.05)), look, (0, 0, z))
    chair_back(a, look, frame, depth, width, z + 0.04)
    if a.chance(0.25):
        rest = z + a.uniform(0.2, 0.28)
        a.add_mirrored(box((depth, 0.06, 0.04)), frame, (0, 0.5 * width, rest))
        a.add_mirrored(
            rod((0.4 * depth, 0.5 * width, z), (0.4 * depth, 0.5 * width, rest), 0.02),
            frame,
            (0, 0, 0),
        )
    details = () if frame is look else (detail(frame, "legs", plural=True),)
    nouns = ("chair", "chair", "dining chair", "kitchen chair", "seat")
    return Description(nouns, look, details)


def stool(a: Assembly) -> Description:
    """A stool: a seat on three or four legs or a pedestal, no back."""
    look = a.look("wooden", "leather", "metal", "plastic")
    frame = look if a.chance(0.5) else a.look("wooden", "metal", avoid=look)
    z, size = a.uniform(0.35, 1.0), a.uniform(0.18, 0.28)
    if a.chance(0.6):
        seat = cylinder(size, 0.06) if a.chance(0.6) else cushion(2 * size, 2 * size, 0.14)
    else:
        seat = box((2 * size, 2 * size, 0.06))
    a.add(seat, look, (0, 0, z))
    if a.chance(0.25):
        pedestal(a, frame, z, size * 1.1)
    else:
        count, splay = a.integer(3, 4), a.uniform(0.0, 0.12)
        leg = rod((0.8 * size + splay, 0, 0), (0.75 * size, 0, z), 0.025)
        a.add_around(leg, frame, count, (0, 0, 0), 45)
        if a.chance(0.5):
            a.add(torus(0.78 * size + 0.6 * splay, 0.015), frame, (0, 0, 0.4 * z))
    details = () if frame is look else (detail(frame, "legs", plural=True),)
    return Description(
        ("stool", "stool", "bar stool", "footstool"),
        look,
        details,
        ("tall",) if z > 0.65 else ("low",),
    )


def armchair(a: Assembly) -> Description:
    """An armchair, couch, or corner sofa."""
    look = a.look(
        "fabric", "leather", "fabric", patterns=("stripes", "checks", "dots"), pattern_chance=0.12
    )
    seats = a.integer(1, 3)
    unit, depth = a.uniform(0.5, 0.65), a.uniform(0.6, 0.8)
    width, seat, leg = seats * unit, a.uniform(0.25, 0.35), a.uniform(0.03, 0.15)
    frame = a.look("wooden", "metal", avoid=look)
    four_legs(a, frame, 0.48 * depth, 0.5 * width + 0.08, leg, thickness=0.03)
    a.add(box((depth, width, seat * 0.6)), look, (0, 0, leg))
    pads = look if a.chance(0.7) else a.look("fabric", avoid=look)
    back, thick = a.uniform(0.35, 0.6), a.uniform(0.12, 0.2)
    for k in range(seats):
        y = (k - 0.5 * (seats - 1)) * unit
        a.add(
            cushion(depth - thick, unit * 0.98, seat * 0.6),
            pads,
            (thick * 0.4, y, leg + seat * 0.5),
        )
        if a.chance(0.85):
            a.add(
                cushion(thick, unit * 0.95, back), pads, (-0.5 * depth + thick, y, leg + seat * 0.8)
            )
    a.add(cushion(thick, width + 0.1, seat + back), look, (-0.5 * depth + 0.3 * thick, 0, leg))
    if a.chance(0.85):
        arm = a.uniform(0.1, 0.2)
        a.add_mirrored(
            cushion(depth, arm, seat + a.uniform(0.1, 0.25)),
            look,
            (0, 0.5 * width + 0.4 * arm, leg),
        )
    corner = seats > 1 and a.chance(0.25)
    if corner:
        a.add(cushion(1.1, unit, seat), look, (0.3 + 0.2 * depth, 0.5 * (seats - 1) * unit, leg))
    if a.chance(0.3):
        pillow = a.look("fabric", avoid=look)
        a.add(cushion(0.12, 0.3, 0.28), pillow, (-0.1, a.uniform(-0.3, 0.3) * unit, leg + seat))
        details = [f"{pillow.color} cushions"]
    else:
        details = ["cushions"]
    details.append(detail(frame, "legs", plural=True))
    nouns = ("armchair", "armchair", "lounge chair") if seats == 1 else ("sofa", "couch", "settee")
    nouns = ("corner sofa", "sofa", "couch") if corner else nouns
    return Description(nouns, look, tuple(details))


def table(a: Assembly) -> Description:
    """A table: square, long or round; four legs or one."""
    look = a.look("wooden", "wooden", "glass", "metal", "plastic", "marble")
    frame = look if a.chance(0.55) else a.look("wooden", "metal", avoid=look)
    z, x, y = a.uniform(0.3, 0.8), a.uniform(0.25, 0.5), a.uniform(0.3, 0.8)
    thick = a.uniform(0.03, 0.08)
    shape = a.choose(["square", "round", "long", "long"])
    if shape == "round":
        a.add(cylinder(y, thick, segments=a.choose([32, 32, 8, 6])), look, (0, 0, z))
        x = y = 0.7 * y
    else:
        x = y if shape == "square" else x
        a.add(box((2 * x, 2 * y, thick)), look, (0, 0, z))
        if a.chance(0.4):
            a.add(box((1.8 * x, 1.85 * y, 0.07)), frame, (0, 0, z - 0.07))
    if a.chance(0.3 if shape == "long" else 0.5):
        pedestal(a, frame, z, 0.7 * min(x, y))
    else:
        four_legs(a, frame, x, y, z)
        if a.chance(0.2):
            a.add(box((1.8 * x, 1.8 * y, 0.03)), look, (0, 0, 0.3 * z))
    adjectives = {"square": ("square",), "round": ("round",), "long": ("long", "rectangular")}[
        shape
    ]
    nouns = ("table", "table", "coffee table" if z < 0.45 else "dining table", "side table")
    details = () if frame is look else (detail(frame, "legs", plural=True),)
    return Description(nouns, look, details, adjectives)


def desk(a: Assembly) -> Description:
    """A desk: a top with drawers on one or both sides."""
    look = a.look("wooden", "wooden", "plastic", "metal")
    front = look if a.chance(0.5) else a.look("wooden", "plastic", avoid=look)
    depth, width, z = a.uniform(0.4, 0.6), a.uniform(0.9, 1.4), a.uniform(0.55, 0.7)
    a.add(box((depth, width, 0.05)), look, (0, 0, z))
    side = a.uniform(0.25, 0.35)
    knob = a.look("metal")
    sides = [-1.0] if a.chance(0.6) else [-1.0, 1.0]
    for sign in sides:
        y = sign * (0.5 * width - 0.5 * side)
        a.add(box((depth * 0.95, side, z - 0.06)), look, (0, y, 0.06))
        drawers(a, front, knob, (0.475 * depth, y), side, (0.08, z - 0.1), a.integer(2, 4))
    if len(sides) == 1:
        if a.chance(0.5):
            a.add(box((depth * 0.9, 0.05, z)), look, (0, 0.5 * width - 0.03, 0))
        else:
            for x in (-0.45, 0.45):
                a.add(box((0.05, 0.05, z)), look, (x * depth, 0.5 * width - 0.03, 0))
    if a.chance(0.3):
        a.add(box((0.04, width, 0.25)), look, (-0.48 * depth, 0, z))
    details = ("drawers",) if front is look else (detail(front, "drawers", plural=True),)
    return Description(("desk", "writing desk", "office desk", "work table"), look, details)


def drawers(
    a: Assembly,
    look: Look,
    knob: Look,
    at: tuple[float, float],
    width: float,
    span: tuple[float, float],
    count: int,
) -> None:
    """Add drawer fronts with knobs about x and y, between two heights."""
    (x, y), (low, high) = at, span
    step = (high - low) / count
    for k in range(count):
        z = low + k * step
        a.add(box((0.03, width * 0.92, step * 0.88)), look, (x, y, z))
        a.add(ellipsoid((0.025, 0.05, 0.015)), knob, (x + 0.03, y, z + 0.5 * step))


FAMILIES = (
    chair,
    stool,
    armchair,
    table,
    desk,
)
