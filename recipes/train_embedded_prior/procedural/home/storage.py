"""Storage families: shelves, cabinets, beds, benches, crates."""

from __future__ import annotations

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    DECORATIONS,
    Assembly,
    Description,
)
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.home.furniture import cushion, drawers, four_legs
from recipes.train_embedded_prior.procedural.materials import Mark
from recipes.train_embedded_prior.procedural.primitives import box, ellipsoid, prism, tray
from recipes.train_embedded_prior.procedural.sweeps import torus


def shelf(a: Assembly) -> Description:
    """An open shelf, rack or bookcase, empty or with things on it."""
    look = a.look("wooden", "wooden", "metal", "plastic")
    depth, width, height = a.uniform(0.22, 0.4), a.uniform(0.4, 1.0), a.uniform(0.5, 1.3)
    tiers, thick = a.integer(2, 5), a.uniform(0.02, 0.05)
    posts = a.chance(0.4)
    if posts:
        for x in (-0.5, 0.5):
            a.add_mirrored(
                box((0.04, 0.04, height)), look, (x * (depth - 0.04), 0.5 * width - 0.02, 0)
            )
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
                a.add(
                    box((0.7 * depth, size * 0.9, room * a.uniform(0.5, 0.85))),
                    book,
                    (0, y + 0.5 * size, z + thick),
                )
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
    look = (
        a.look(
            "metal",
            "plastic",
            colors=(
                "white",
                "grey",
                "silver",
                "red",
                "light grey",
                "black",
                "light green",
                "cream",
            ),
        )
        if metal
        else a.look("wooden", "wooden", "plastic", "metal")
    )
    front = look if a.chance(0.6) else a.look("wooden", avoid=look)
    knob = a.look("metal", avoid=front)
    sizes = {
        "drawers": (0.45, 0.7, 0.8),
        "doors": (0.4, 0.6, 1.1),
        "tv": (0.4, 1.3, 0.35),
        "fridge": (0.5, 0.5, 1.15),
        "washer": (0.55, 0.6, 0.75),
    }[kind]
    depth, width, height = (value * a.uniform(0.8, 1.2) for value in sizes)
    leg = a.choose([0.0, 0.0, a.uniform(0.05, 0.15)])
    if leg:
        four_legs(a, knob, 0.48 * depth, 0.48 * width, leg, thickness=0.025)
    marks = ()
    x = 0.5 * depth
    if kind == "washer":
        z = leg + 0.45 * height
        marks = (
            Mark((x, 0, z), (1, 0, 0), (0.22, 0.22), a.look("glass").material.color, "disc", 0.1),
        )
        a.add(torus(0.23, 0.025), knob, (x, 0, z), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    a.add(box((depth, width, height)), look.marked(*marks), (0, 0, leg))
    if kind == "drawers":
        span = (leg + 0.03, leg + height - 0.03)
        drawers(a, front, knob, (x, 0), width, span, a.integer(2, 5))
    elif kind == "tv":
        for y in (-0.33, 0, 0.33):
            span = (leg + 0.03, leg + height - 0.03)
            drawers(a, front, knob, (x, y * width), width / 3, span, a.integer(1, 2))
    elif kind == "doors":
        a.add_mirrored(
            box((0.03, 0.47 * width, 0.92 * height)), front, (x, 0.245 * width, leg + 0.04 * height)
        )
        a.add_mirrored(box((0.03, 0.02, 0.15)), knob, (x + 0.03, 0.05, leg + 0.5 * height))
    elif kind == "fridge":
        split = a.uniform(0.3, 0.7)
        for low, high in ((0.02, split - 0.01), (split + 0.01, 0.99)):
            a.add(
                box((0.05, width * 0.98, (high - low) * height)), look, (x, 0, leg + low * height)
            )
            a.add(
                box((0.03, 0.025, 0.3 * (high - low) * height + 0.05)),
                knob,
                (x + 0.06, 0.4 * width, leg + (0.6 * low + 0.4 * high) * height),
            )
    nouns = {
        "drawers": ("chest of drawers", "dresser", "cabinet"),
        "doors": ("wardrobe", "cupboard", "cabinet", "closet"),
        "tv": ("cabinet", "sideboard", "tv cabinet"),
        "fridge": ("refrigerator", "fridge"),
        "washer": ("washing machine", "washer"),
    }[kind]
    extra = {
        "drawers": "drawers",
        "doors": "two doors",
        "tv": "drawers",
        "fridge": "two doors",
        "washer": "a round door",
    }[kind]
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
    a.add(
        box((length * share, width * 1.02, 0.13)), cover, (0.5 * length * (1 - share), 0, z + 0.09)
    )
    for k in range(2 if width > 0.8 else 1):
        y = 0.0 if width <= 0.8 else (k - 0.5) * 0.5 * width
        a.add(cushion(0.22, 0.4 * min(width, 0.9), 0.12), sheet, (-0.4 * length, y, z + 0.17))
    details = (detail(cover, "blanket"), f"{sheet.color} linen", "pillows")
    return Description(
        ("bed", "bed", "double bed" if width > 0.8 else "single bed"), frame, details
    )


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
            a.add(
                box((0.04, width, 0.3 / rows)),
                look,
                (-0.5 * depth - 0.02 * k, 0, z + 0.12 + k * 0.36 / rows),
            )
        a.add_mirrored(
            box((0.05, 0.06, 0.45), shear=(-0.05, 0)), frame, (-0.52 * depth, 0.4 * width, z)
        )
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
        return Description(
            ("gift box", "present", "gift", "box"), look, (detail(ribbon, "ribbon"),)
        )
    look = a.look("wooden", "metal")
    trim = a.look("metal", avoid=look)
    a.add(box((x, y, z * 0.6)), look)
    angle = np.linspace(0, np.pi, 9)
    outline = np.stack([0.5 * x * np.cos(angle), 0.45 * x * np.sin(angle)], axis=1)
    lid = prism(outline, y).moved([[1, 0, 0], [0, 0, -1], [0, 1, 0]], (0, 0.5 * y, z * 0.6))
    a.add(lid, look)
    for share in (-0.4, 0.4):
        band = prism(outline * 1.04, 0.06).moved(
            [[1, 0, 0], [0, 0, -1], [0, 1, 0]], (0, share * y + 0.03, z * 0.6)
        )
        a.add(band, trim)
        a.add(box((x * 1.03, 0.06, z * 0.61)), trim, (0, share * y, 0))
    a.add(box((0.05, 0.1, 0.12)), trim, (0.5 * x, 0, z * 0.52))
    return Description(("chest", "treasure chest", "trunk"), look, (f"{trim.color} bands",))


FAMILIES = (
    shelf,
    cabinet,
    bed,
    bench,
    crate,
)
