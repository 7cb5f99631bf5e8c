"""Furniture families: things to sit on, to lie on, to put things on and into."""

from __future__ import annotations

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    DECORATIONS,
    Assembly,
    Description,
    Look,
)
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.materials import Mark
from recipes.train_embedded_prior.procedural.primitives import (
    Quads,
    box,
    cylinder,
    ellipsoid,
    prism,
    rod,
    torus,
    tray,
    tube,
)


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
        path = np.stack([x - lean * np.sin(angle), 0.5 * width * np.cos(angle) * 0.95,
                         z + height * np.sin(angle)], axis=1)
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
    look = a.look("wooden", "wooden", "plastic", "fabric", "leather", "metal", patterns=DECORATIONS,
                  pattern_chance=0.15)
    frame = look if a.chance(0.5) else a.look("wooden", "metal", avoid=look)
    width, depth, z = a.uniform(0.42, 0.6), a.uniform(0.4, 0.55), a.uniform(0.4, 0.6)
    if a.chance(0.85):
        four_legs(a, frame, 0.5 * depth, 0.5 * width, z)
        if a.chance(0.3):
            for y in (-1, 1):
                bar = 0.5 * width * y * 0.9
                a.add(rod((-0.45 * depth, bar, 0.4 * z), (0.45 * depth, bar, 0.4 * z), 0.015), frame)
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
        a.add_mirrored(rod((0.4 * depth, 0.5 * width, z), (0.4 * depth, 0.5 * width, rest), 0.02),
                       frame, (0, 0, 0))
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
    return Description(("stool", "stool", "bar stool", "footstool"), look, details,
                       ("tall",) if z > 0.65 else ("low",))


def armchair(a: Assembly) -> Description:
    """An armchair, couch, or corner sofa."""
    look = a.look("fabric", "leather", "fabric", patterns=("stripes", "checks", "dots"),
                  pattern_chance=0.12)
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
        a.add(cushion(depth - thick, unit * 0.98, seat * 0.6), pads, (thick * 0.4, y, leg + seat * 0.5))
        if a.chance(0.85):
            a.add(cushion(thick, unit * 0.95, back), pads, (-0.5 * depth + thick, y, leg + seat * 0.8))
    a.add(cushion(thick, width + 0.1, seat + back), look, (-0.5 * depth + 0.3 * thick, 0, leg))
    if a.chance(0.85):
        arm = a.uniform(0.1, 0.2)
        a.add_mirrored(cushion(depth, arm, seat + a.uniform(0.1, 0.25)), look,
                       (0, 0.5 * width + 0.4 * arm, leg))
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
    adjectives = {"square": ("square",), "round": ("round",), "long": ("long", "rectangular")}[shape]
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
        drawers(a, front, knob, 0.475 * depth, y, side, 0.08, z - 0.1, a.integer(2, 4))
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
    a: Assembly, look: Look, knob: Look, x: float, y: float, width: float, low: float, high: float,
    count: int,
) -> None:
    """Add drawer fronts with knobs on the plane x, between two heights."""
    step = (high - low) / count
    for k in range(count):
        z = low + k * step
        a.add(box((0.03, width * 0.92, step * 0.88)), look, (x, y, z))
        a.add(ellipsoid((0.025, 0.05, 0.015)), knob, (x + 0.03, y, z + 0.5 * step))


def shelf(a: Assembly) -> Description:
    """An open shelf, rack or bookcase, empty or with things on it."""
    look = a.look("wooden", "wooden", "metal", "plastic")
    depth, width, height = a.uniform(0.22, 0.4), a.uniform(0.4, 1.0), a.uniform(0.5, 1.3)
    tiers, thick = a.integer(2, 5), a.uniform(0.02, 0.05)
    posts = a.chance(0.4)
    if posts:
        for x in (-0.5, 0.5):
            a.add_mirrored(box((0.04, 0.04, height)), look, (x * (depth - 0.04), 0.5 * width - 0.02, 0))
    else:
        a.add_mirrored(box((depth, thick, height)), look, (0, 0.5 * width, 0))
        if a.chance(0.6):
            a.add(box((0.02, width, height)), look, (-0.5 * depth, 0, 0))
    filled = a.chance(0.35)
    levels = np.linspace(0.05 if a.chance(0.7) else 0.2, height - thick, tiers)
    for k, z in enumerate(levels):
        a.add(box((depth, width, thick)), look, (0, 0, z))
        if filled and k + 1 < tiers:
            room, y = levels[1] - levels[0] - thick, -0.45 * width
            while y < 0.4 * width and a.chance(0.9):
                size = a.uniform(0.03, 0.09)
                book = a.look("paper")
                a.add(box((0.7 * depth, size * 0.9, room * a.uniform(0.5, 0.85))), book,
                      (0, y + 0.5 * size, z + thick))
                y += size
    if posts:
        nouns = ("rack", "shelf", "shoe rack", "shelving unit")
    else:
        nouns = ("shelf", "bookcase", "bookshelf", "book shelf")
    return Description(nouns, look, ("books",) if filled else (f"{_number(tiers)} shelves",))


def _number(count: int) -> str:
    """Spell a small number."""
    return ("no", "one", "two", "three", "four", "five", "six", "seven", "eight")[count]


def cabinet(a: Assembly) -> Description:
    """A cabinet, chest of drawers, wardrobe, TV stand, refrigerator or washing machine."""
    kind = a.choose(["drawers", "doors", "tv", "fridge", "washer"])
    metal = kind in ("fridge", "washer")
    look = a.look("metal", "plastic", colors=("white", "grey", "silver", "red", "light grey", "black",
                                              "light green", "cream")) if metal else a.look(
        "wooden", "wooden", "plastic", "metal")
    front = look if a.chance(0.6) else a.look("wooden", avoid=look)
    knob = a.look("metal", avoid=front)
    sizes = {"drawers": (0.45, 0.7, 0.8), "doors": (0.4, 0.6, 1.1), "tv": (0.4, 1.3, 0.35),
             "fridge": (0.5, 0.5, 1.15), "washer": (0.55, 0.6, 0.75)}[kind]
    depth, width, height = (value * a.uniform(0.8, 1.2) for value in sizes)
    leg = a.choose([0.0, 0.0, a.uniform(0.05, 0.15)])
    if leg:
        four_legs(a, knob, 0.48 * depth, 0.48 * width, leg, thickness=0.025)
    marks = ()
    x = 0.5 * depth
    if kind == "washer":
        z = leg + 0.45 * height
        marks = (Mark((x, 0, z), (1, 0, 0), (0.22, 0.22), a.look("glass").material.color, "disc", 0.1),)
        a.add(torus(0.23, 0.025), knob, (x, 0, z), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    a.add(box((depth, width, height)), look.marked(*marks), (0, 0, leg))
    if kind == "drawers":
        drawers(a, front, knob, x, 0, width, leg + 0.03, leg + height - 0.03, a.integer(2, 5))
    elif kind == "tv":
        for y in (-0.33, 0, 0.33):
            drawers(a, front, knob, x, y * width, width / 3, leg + 0.03, leg + height - 0.03,
                    a.integer(1, 2))
    elif kind == "doors":
        a.add_mirrored(box((0.03, 0.47 * width, 0.92 * height)), front,
                       (x, 0.245 * width, leg + 0.04 * height))
        a.add_mirrored(box((0.03, 0.02, 0.15)), knob, (x + 0.03, 0.05, leg + 0.5 * height))
    elif kind == "fridge":
        split = a.uniform(0.3, 0.7)
        for low, high in ((0.02, split - 0.01), (split + 0.01, 0.99)):
            a.add(box((0.05, width * 0.98, (high - low) * height)), look, (x, 0, leg + low * height))
            a.add(box((0.03, 0.025, 0.3 * (high - low) * height + 0.05)), knob,
                  (x + 0.06, 0.4 * width, leg + (0.6 * low + 0.4 * high) * height))
    nouns = {"drawers": ("chest of drawers", "dresser", "cabinet"), "doors": (
        "wardrobe", "cupboard", "cabinet", "closet"), "tv": ("cabinet", "sideboard", "tv cabinet"),
        "fridge": ("refrigerator", "fridge"), "washer": ("washing machine", "washer")}[kind]
    extra = {"drawers": "drawers", "doors": "two doors", "tv": "drawers", "fridge": "two doors",
             "washer": "a round door"}[kind]
    details = (f"{front.color} {extra}" if front is not look and kind == "drawers" else extra,)
    return Description(nouns, look, details, ("tall",) if height > 1.2 * width else ("wide",))


def bed(a: Assembly) -> Description:
    """A bed with mattress, cover and pillows."""
    frame = a.look("wooden", "wooden", "metal", "fabric")
    length, width, z = 1.3, a.uniform(0.6, 1.2), a.uniform(0.12, 0.3)
    four_legs(a, frame, 0.5 * length, 0.5 * width, z, thickness=0.035)
    a.add(box((length, width, 0.12)), frame, (0, 0, z - 0.06))
    head = a.uniform(0.35, 0.7)
    a.add(box((0.06, width * 1.04, head)), frame, (-0.5 * length, 0, z - 0.06))
    if a.chance(0.4):
        a.add(box((0.05, width * 1.04, head * 0.5)), frame, (0.5 * length, 0, z - 0.06))
    sheet = a.look("fabric", colors=("white", "cream", "light grey", "light blue"))
    a.add(cushion(length * 0.97, width * 0.97, 0.16), sheet, (0, 0, z + 0.04))
    cover = a.look("fabric", avoid=sheet, patterns=DECORATIONS, pattern_chance=0.3)
    share = a.uniform(0.5, 0.75)
    a.add(box((length * share, width * 1.02, 0.13)), cover, (0.5 * length * (1 - share), 0, z + 0.09))
    for k in range(2 if width > 0.8 else 1):
        y = 0.0 if width <= 0.8 else (k - 0.5) * 0.5 * width
        a.add(cushion(0.22, 0.4 * min(width, 0.9), 0.12), sheet, (-0.4 * length, y, z + 0.17))
    details = (detail(cover, "blanket"), f"{sheet.color} linen", "pillows")
    return Description(("bed", "bed", "double bed" if width > 0.8 else "single bed"), frame, details)


def bench(a: Assembly) -> Description:
    """A bench with or without back."""
    look = a.look("wooden", "wooden", "stone", "metal")
    frame = look if a.chance(0.4) else a.look("metal", "stone", avoid=look)
    width, depth, z = a.uniform(1.0, 1.6), a.uniform(0.3, 0.45), a.uniform(0.3, 0.45)
    slats = a.integer(1, 5)
    for k in range(slats):
        x = ((k + 0.5) / slats - 0.5) * depth
        a.add(box((depth / slats * 0.85, width, 0.05)), look, (x, 0, z))
    a.add_mirrored(box((depth * 0.9, a.uniform(0.05, 0.12), z)), frame, (0, 0.4 * width, 0))
    if a.chance(0.6):
        rows = a.integer(1, 3)
        for k in range(rows):
            a.add(box((0.04, width, 0.3 / rows)), look, (-0.5 * depth - 0.02 * k, 0, z + 0.12 + k * 0.36 / rows))
        a.add_mirrored(box((0.05, 0.06, 0.45), shear=(-0.05, 0)), frame, (-0.52 * depth, 0.4 * width, z))
    details = () if frame is look else (detail(frame, "legs", plural=True),)
    return Description(("bench", "bench", "park bench", "garden bench"), look, details)


def crate(a: Assembly) -> Description:
    """A crate, chest, storage bin or gift box."""
    kind = a.choose(["crate", "chest", "bin", "gift", "carton"])
    x, y, z = a.uniform(0.4, 0.8), a.uniform(0.5, 1.0), a.uniform(0.3, 0.7)
    if kind == "crate":
        look = a.look("wooden", "plastic")
        rows = a.integer(2, 4)
        for k in range(rows):
            level, tall = (k + 0.1) * z / rows, 0.8 * z / rows
            for sign in (-1, 1):
                a.add(box((0.03, y, tall)), look, (sign * 0.5 * x, 0, level))
                a.add(box((x, 0.03, tall)), look, (0, sign * 0.5 * y, level))
        for sign in (-1, 1):
            a.add_mirrored(box((0.05, 0.05, z)), look, (sign * 0.5 * x, 0.5 * y, 0))
        a.add(box((x, y, 0.03)), look)
        return Description(("crate", "box", "slatted box"), look)
    if kind == "bin":
        look = a.look("plastic", "metal", "straw", patterns=DECORATIONS, pattern_chance=0.2)
        a.add(tray((x, y, z), 0.03, a.uniform(1.0, 1.15)), look)
        return Description(("storage bin", "bin", "basket", "open box", "container"), look)
    if kind == "carton":
        look = a.look("cardboard", "paper")
        a.add(tray((x, y, z), 0.015), look)
        for sign in (-1, 1):
            flap = box((0.012, y, 0.3), shear=(0.2 * sign, 0))
            a.add(flap, look, (sign * 0.5 * x, 0, z))
        return Description(("cardboard box", "open box", "carton", "box"), look, ("open flaps",))
    if kind == "gift":
        look = a.look("paper", patterns=DECORATIONS)
        ribbon = a.look("fabric", avoid=look)
        a.add(box((x, y, z)), look)
        a.add(box((x * 1.02, 0.08, z * 1.02)), ribbon)
        a.add(box((0.08, y * 1.02, z * 1.02)), ribbon)
        a.add_mirrored(ellipsoid((0.06, 0.12, 0.06)), ribbon, (0, 0.1, z + 0.06))
        return Description(("gift box", "present", "gift", "box"), look, (detail(ribbon, "ribbon"),))
    look = a.look("wooden", "metal")
    trim = a.look("metal", avoid=look)
    a.add(box((x, y, z * 0.6)), look)
    angle = np.linspace(0, np.pi, 9)
    outline = np.stack([0.5 * x * np.cos(angle), 0.45 * x * np.sin(angle)], axis=1)
    lid = prism(outline, y).moved([[1, 0, 0], [0, 0, -1], [0, 1, 0]], (0, 0.5 * y, z * 0.6))
    a.add(lid, look)
    for share in (-0.4, 0.4):
        band = prism(outline * 1.04, 0.06).moved([[1, 0, 0], [0, 0, -1], [0, 1, 0]],
                                                 (0, share * y + 0.03, z * 0.6))
        a.add(band, trim)
        a.add(box((x * 1.03, 0.06, z * 0.61)), trim, (0, share * y, 0))
    a.add(box((0.05, 0.1, 0.12)), trim, (0.5 * x, 0, z * 0.52))
    return Description(("chest", "treasure chest", "trunk"), look, (f"{trim.color} bands",))


FAMILIES = (
    chair, stool, armchair, table, desk, shelf, cabinet, bed, bench, crate,
)
