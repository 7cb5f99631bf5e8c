"""Household things: cartons, books, devices and bags."""

from __future__ import annotations

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import Assembly, Description
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.home.household import FACE_X
from recipes.train_embedded_prior.procedural.materials import Mark
from recipes.train_embedded_prior.procedural.primitives import box, cylinder, disc, ellipsoid, prism
from recipes.train_embedded_prior.procedural.quads import turn_about
from recipes.train_embedded_prior.procedural.sweeps import arc, revolve, rod, torus, tube


def carton(a: Assembly) -> Description:
    """A cereal box, milk carton or packet with printed faces."""
    look = a.look(
        "paper",
        "cardboard",
        patterns=("two_tone", "gradient", "bands", "diagonal", "dots"),
        pattern_chance=0.4,
    )
    depth, width, height = a.uniform(0.15, 0.4), a.uniform(0.4, 0.7), a.uniform(0.6, 1.0)
    milk = a.chance(0.35)
    if milk:
        depth = width = a.uniform(0.35, 0.45)
    marks = []
    for sign in (1.0, -1.0):
        tone = a.look(avoid=look).material.color
        if a.chance(0.75):
            face = (sign * depth / 2, a.uniform(-0.1, 0.1) * width, height * a.uniform(0.5, 0.8))
            marks.append(
                Mark(
                    face,
                    (sign, 0, 0),
                    (width * a.uniform(0.25, 0.42), height * 0.13),
                    tone,
                    "label",
                )
            )
        picture = a.look(avoid=look).material.color
        low = (sign * depth / 2, a.uniform(-0.1, 0.1), height * a.uniform(0.2, 0.35))
        marks.append(
            Mark(
                low,
                (sign, 0, 0),
                (width * 0.3, height * 0.16),
                picture,
                a.choose(["disc", "rectangle", "star", "ring"]),
            )
        )
    if a.chance(0.5):
        tone = a.look(avoid=look).material.color
        for sign in (1.0, -1.0):
            marks.append(
                Mark(
                    (0, sign * width / 2, height / 2),
                    (0, sign, 0),
                    (depth * 0.35, height * 0.3),
                    tone,
                    "label",
                )
            )
    printed = look.marked(*marks)
    a.add(box((depth, width, height)), printed)
    if milk:
        roof = prism([(-0.5 * depth, 0), (0.5 * depth, 0), (0.02, 0.2), (-0.02, 0.2)], width)
        a.add(roof, look, (0, 0.5 * width, height), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]))
        a.add(box((0.02, width, 0.08)), look, (0, 0, height + 0.18))
        if a.chance(0.5):
            cap = a.look("plastic", avoid=look)
            a.add(cylinder(0.07, 0.07), cap, (0.12, 0, height + 0.08), turn_about("y", 45))
        return Description(
            ("milk carton", "carton", "juice carton", "juice box"), look, ("a label",)
        )
    nouns = ("box", "cereal box", "carton", "packet", "tea box")
    return Description(nouns, look, ("a label", "text", "letters"), ("printed",))


def book(a: Assembly) -> Description:
    """A closed or open book, or a stack of books."""
    look = a.look("leather", "paper", patterns=("two_tone", "rim", "bands"), pattern_chance=0.15)
    paper = a.look("paper", colors=("white", "cream"))
    x, y, thick = a.uniform(0.6, 0.8), a.uniform(0.8, 1.05), a.uniform(0.08, 0.25)
    if a.chance(0.25):
        for side in (-1.0, 1.0):
            t = np.linspace(0, 1, 9)
            rise = 0.12 * np.sin(np.pi * t**0.6) + 0.02
            outline = np.concatenate(
                [np.stack([t * x, rise], 1), np.stack([t[::-1] * x, 0 * t + 0.01], 1)]
            )
            page = prism(outline if side > 0 else outline[::-1] * [-1, 1], y)
            a.add(page, paper, (0, 0.5 * y, 0), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]))
        a.add(box((2.05 * x, 1.03 * y, 0.02)), look)
        return Description(("open book", "book"), look, ("white pages",))
    count = a.choose([1, 1, 1, 2, 3, 4])
    z = 0.0
    for k in range(count):
        cover = look if k == count - 1 else a.look("paper", "leather")
        turn = turn_about("z", a.uniform(-20, 20) if count > 1 else 0)
        title = Mark(
            (0.02, 0, z + thick),
            (0, 0, 1),
            (x * 0.3, y * 0.14),
            a.look(avoid=cover).material.color,
            a.choose(["label", "rectangle", "disc"]),
        )
        marked = cover.marked(title) if a.chance(0.7) and k == count - 1 else cover
        for level in (0.0, thick - 0.02):
            a.add(box((x, y, 0.02)), marked, (0, 0, z + level), turn)
        a.add(
            box((0.02, y, thick)),
            marked,
            tuple(turn @ np.array([-0.5 * x, 0, 0]) + np.array([0, 0, z])),
            turn,
        )
        a.add(box((x * 0.94, y * 0.95, thick - 0.02)), paper, (0, 0, z + 0.01), turn)
        z += thick
    nouns = (
        ("book", "notebook", "book") if count == 1 else ("stack of books", "pile of books", "books")
    )
    return Description(nouns, look, ("white pages",), ("thick",) if thick > 0.16 else ("thin",))


def speaker(a: Assembly) -> Description:
    """A loudspeaker box with cones, or a radio."""
    look = a.look(
        "plastic",
        "wooden",
        "metal",
        colors=("black", "dark grey", "brown", "white", "grey", "light brown", "red"),
    )
    cone = a.look("rubber", colors=("black", "dark grey", "grey"), avoid=look)
    ring = a.look("metal", avoid=cone)
    radio = a.chance(0.3)
    depth, width, height = (
        (0.3, 1.0, 0.6) if radio else (a.uniform(0.35, 0.5), a.uniform(0.4, 0.6), 1.0)
    )
    a.add(box((depth, width, height)), look)
    if radio:
        spots = [(0.27, 0.28, 0.19), (-0.27, 0.28, 0.19)]
        a.add(box((0.02, 0.5, 0.08)), ring, (0.5 * depth, 0, 0.48))
        a.add(rod((0, 0.4, height), (0, 0.1, height + 0.4), 0.012), ring)
    else:
        big = min(0.42 * width, 0.24)
        spots = [(0.0, 0.3, big), (0.0, 0.72, big * a.uniform(0.4, 0.9))]
    for y, z, radius in spots:
        at = (0.5 * depth + 0.005, y, z)
        a.add(torus(radius, 0.025), ring, at, FACE_X)
        bowl = revolve(
            [(radius, 0.015), (0.4 * radius, -0.02), (0.35 * radius, 0.02), (0, 0.04)], 20
        )
        a.add(bowl, cone, (at[0] + 0.01, y, z), FACE_X)
    if radio:
        return Description(("radio", "boombox", "speaker"), look, ("two knobs",))
    return Description(("speaker", "loudspeaker", "speaker"), look, ())


def camera(a: Assembly) -> Description:
    """A photo camera, or a security camera on a foot."""
    look = a.look(
        "plastic", "metal", colors=("black", "dark grey", "white", "silver", "red", "brown")
    )
    dark = a.look("plastic", colors=("black", "dark grey"), avoid=look)
    glass = a.look("glass", colors=("dark blue", "black", "blue"))
    if a.chance(0.35):
        a.add(cylinder(0.28, 0.06, 0.22), look)
        a.add(cylinder(0.06, 0.3), look)
        a.add(ellipsoid((0.32, 0.32, 0.32)), look, (0, 0, 0.55))
        a.add(cylinder(0.22, 0.16), dark, (0.2, 0, 0.55), FACE_X)
        a.add(disc(0.12), glass, (0.365, 0, 0.55), FACE_X)
        return Description(("security camera", "camera", "webcam"), look, ("a foot", "a lens"))
    depth, width, height = a.uniform(0.25, 0.35), 0.9, a.uniform(0.5, 0.65)
    a.add(box((depth, width, height)), dark)
    a.add(box((depth * 1.02, width * 1.01, height * 0.3)), look, (0, 0, height * 0.72))
    if a.chance(0.6):
        a.add(box((depth * 0.9, 0.32, 0.16), taper=(0.8, 0.7)), look, (0, 0, height))
    a.add(cylinder(0.05, 0.06), look, (0, 0.32, height))
    reach, radius = a.uniform(0.1, 0.4), a.uniform(0.19, 0.26)
    a.add(
        cylinder(radius, reach, radius * a.uniform(0.9, 1.1)),
        dark,
        (0.5 * depth, 0, 0.45 * height),
        FACE_X,
    )
    front = 0.5 * depth + reach
    a.add(torus(radius * 0.9, 0.025), look, (front, 0, 0.45 * height), FACE_X)
    a.add(disc(radius * 0.75), glass, (front + 0.01, 0, 0.45 * height), FACE_X)
    return Description(("camera", "photo camera", "video camera"), look, ("a lens", "a black lens"))


def stapler(a: Assembly) -> Description:
    """A stapler: two long arms joined at the back."""
    look = a.look("plastic", "metal")
    steel = a.look("metal", colors=("silver", "grey", "black"), avoid=look)
    length, width = 1.0, a.uniform(0.16, 0.26)
    a.add(box((length, width, 0.07)), look)
    lean = turn_about("y", -a.uniform(3, 14))
    a.add(box((0.92 * length, 0.6 * width, 0.06)), steel, (0.0, 0, 0.13), lean)
    cover = ellipsoid((0.5 * length, 0.5 * width, 0.12), roundness=(0.6, 0.35))
    a.add(cover, look, (0, 0, a.uniform(0.25, 0.32)), lean)
    a.add(box((0.2, width, 0.3)), look, (-0.4 * length, 0, 0))
    return Description(("stapler",), look, (detail(steel, "parts", plural=True),))


def suitcase(a: Assembly) -> Description:
    """A suitcase, briefcase or handbag."""
    look = a.look(
        "leather", "plastic", "fabric", patterns=("bands", "stripes", "checks"), pattern_chance=0.15
    )
    trim = a.look("leather", "metal", avoid=look)
    depth, width, height = a.uniform(0.2, 0.35), a.uniform(0.7, 1.0), a.uniform(0.5, 0.8)
    soft = a.chance(0.4)
    if soft:
        body = ellipsoid((0.5 * depth, 0.5 * width, 0.5 * height), roundness=(0.35, 0.3))
        a.add(body, look, (0, 0, 0.5 * height))
    else:
        a.add(box((depth, width, height), taper=(a.choose([1.0, 0.6]), 1)), look)
        a.add_mirrored(box((depth * 1.03, 0.05, height * 1.01)), trim, (0, 0.33 * width, 0))
    loop = arc(0, 180, 0.17, 11, plane="yz") * np.array([1, 1, a.uniform(0.6, 1.6)], np.float32)
    a.add(tube(loop, 0.025), trim, (0, 0, height * 0.98))
    nouns = ("bag", "handbag", "purse") if soft else ("suitcase", "briefcase", "suitcase")
    return Description(nouns, look, (detail(trim, "handle"), "a handle"))


FAMILIES = (
    carton,
    book,
    speaker,
    camera,
    stapler,
    suitcase,
)
