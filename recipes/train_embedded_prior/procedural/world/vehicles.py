"""Vehicle families: things that drive. The front looks along +x."""

from __future__ import annotations

import math

import numpy as np

from gscomplete.util.arrays import Float32Array
from recipes.train_embedded_prior.procedural.assembly import (
    DECORATIONS,
    Assembly,
    Description,
    Look,
)
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.primitives import box, cylinder, ellipsoid, prism
from recipes.train_embedded_prior.procedural.quads import Quads, turn_about
from recipes.train_embedded_prior.procedural.sweeps import revolve, torus

SIDEWAYS = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], np.float32)
"""Turns a prism drawn in (x, y) into one whose outline is (x, z), extruded along -y."""
PAINTS = (
    "red",
    "blue",
    "yellow",
    "white",
    "black",
    "green",
    "orange",
    "silver",
    "grey",
    "dark blue",
    "light blue",
    "dark green",
    "pink",
    "turquoise",
    "purple",
    "dark red",
    "beige",
)


def slab(outline: list[tuple[float, float]], width: float, top: float = 1.0) -> Quads:
    """Return a body from its side view (x, z), ``width`` across; ``top`` narrows it upward."""
    part = prism(outline, width).moved(SIDEWAYS, (0, 0.5 * width, 0))
    if top == 1.0:
        return part
    corners = part.corners.copy()
    z = corners[..., 2]
    height = (z - z.min()) / max(float(np.ptp(z)), 1e-6)
    corners[..., 1] *= 1 - (1 - top) * height
    return Quads(corners, part.uv, part.feature)


def wheels(
    a: Assembly, xs: list[float], y: float, radius: float, width: float, color: Look | None = None
) -> Look:
    """Add pairs of wheels that stand on z = 0; return the look of the tyres."""
    tyre = color or a.look("rubber", colors=("black", "dark grey", "black", "black"))
    hub = a.look("metal", colors=("silver", "grey", "white", "golden"), avoid=tyre)
    part = cylinder(radius, width, segments=18)
    face = cylinder(radius * 0.55, width * 1.08, segments=12)
    lean = turn_about("x", 90)
    for x in xs:
        a.add_mirrored(part, tyre, (x, y + 0.5 * width, radius), lean)
        a.add_mirrored(face, hub, (x, y + 0.54 * width, radius), lean)
    return tyre


def lights(a: Assembly, x: float, y: float, z: float, rear: float) -> None:
    """Add a pair of head lights at x and rear lights."""
    bright = a.look("glass", colors=("yellow", "white", "cream"))
    back = a.look("glass", colors=("red",))
    a.add_mirrored(ellipsoid((0.03, 0.05, 0.04), rows=6, segments=8), bright, (x, y, z))
    a.add_mirrored(box((0.03, 0.08, 0.05)), back, (rear, y, z))


def car(a: Assembly) -> Description:
    """A car: sedan, hatchback, van, pickup or race car."""
    look = a.look(
        "painted", "plastic", "metal", colors=PAINTS, patterns=("two_tone",), pattern_chance=0.1
    )
    glass = a.look("glass", colors=("light blue", "black", "dark blue", "dark grey"), avoid=look)
    length, width = 1.2, a.uniform(0.45, 0.6)
    radius, low = a.uniform(0.1, 0.15), a.uniform(0.07, 0.1)
    belt, roof = a.uniform(0.26, 0.32), a.uniform(0.42, 0.56)
    kind = a.choose(["sedan", "sedan", "hatch", "van", "pickup", "race"])
    half = 0.5 * length
    if kind == "race":
        body = [(-half, low), (half, low), (half, low + 0.06), (0.1, 0.24), (-half, 0.27)]
        a.add(slab(body, width * 0.5), look)
        a.add(ellipsoid((0.13, 0.1, 0.09)), glass, (0.0, 0, 0.26))
        a.add(box((0.14, width, 0.03)), look, (-half + 0.03, 0, 0.38))
        a.add_mirrored(box((0.1, 0.02, 0.14)), look, (-half + 0.03, 0.2 * width, 0.26))
        a.add(box((0.12, width * 1.05, 0.03)), look, (half, 0, low))
        wheels(a, [0.37 * length, -0.36 * length], 0.36 * width, 0.14, 0.14)
        return Description(("race car", "racing car", "toy race car"), look, ("black wheels",))
    hood = a.uniform(0.75, 0.98) * belt
    body = [
        (-half, low),
        (half, low),
        (half, hood * 0.8),
        (half * 0.95, hood),
        (0.3 * half, belt),
        (-half, belt),
        (-half * 1.02, 0.6 * belt),
    ]
    a.add(slab(body, width, 0.95), look)
    cabins = {
        "sedan": [(-0.62, 0), (0.42, 0), (0.15, 1), (-0.42, 1)],
        "hatch": [(-0.98, 0), (0.42, 0), (0.12, 1), (-0.85, 1)],
        "van": [(-1.0, 0), (0.75, 0), (0.5, 1), (-0.98, 1)],
        "pickup": [(-0.1, 0), (0.5, 0), (0.3, 1), (-0.08, 1)],
    }
    cabin = np.array(cabins[kind])
    rise = roof - belt + (0.1 if kind == "van" else 0.0)
    outline = [(float(x) * half, belt + float(t) * rise) for x, t in cabin]
    a.add(slab(outline, width * 0.94, 0.82), look)
    middle = np.array(outline).mean(axis=0)
    pane = (np.array(outline) - middle) * np.array([0.86, 0.72]) + middle
    a.add(slab([tuple(p) for p in pane.tolist()], width * 1.0, 0.84), glass)
    wide = (np.array(outline) - middle) * np.array([1.015, 0.72]) + middle
    a.add(slab([tuple(p) for p in wide.tolist()], width * 0.76, 0.86), glass)
    if kind == "pickup":
        a.add_mirrored(box((0.9 * half, 0.03, 0.1)), look, (-0.53 * half, 0.45 * width, belt))
        a.add(box((0.03, 0.9 * width, 0.1)), look, (-0.97 * half, 0, belt))
    wheels(a, [0.6 * half, -0.6 * half], 0.42 * width, radius, 0.1)
    lights(a, half * 0.98, 0.34 * width, 0.7 * belt, -half)
    details = ["black wheels", detail(glass, "windows", plural=True), "windows"]
    nouns = {
        "sedan": ("car", "toy car", "sedan"),
        "hatch": ("car", "toy car", "small car"),
        "van": ("van", "minivan", "car"),
        "pickup": ("pickup truck", "pickup", "truck"),
    }[kind]
    if kind == "sedan" and a.chance(0.12):
        sign = a.look("plastic", colors=("yellow", "white", "blue", "red"), avoid=look)
        a.add(box((0.1, 0.2, 0.07)), sign, (-0.1, 0, roof))
        nouns = ("taxi", "police car") if sign.color == "blue" else ("taxi", "cab")
    return Description(nouns, look, tuple(details))


def truck(a: Assembly) -> Description:
    """A truck with cab and a box, a tank, a tipper or an open bed."""
    look = a.look("painted", "plastic", "metal", colors=PAINTS)
    load = (
        look
        if a.chance(0.3)
        else a.look(
            "metal", "plastic", "wooden", avoid=look, patterns=DECORATIONS, pattern_chance=0.15
        )
    )
    glass = a.look("glass", colors=("light blue", "black", "dark blue"), avoid=look)
    width, radius = a.uniform(0.45, 0.55), a.uniform(0.1, 0.14)
    cab, body, height = a.uniform(0.3, 0.42), a.uniform(0.7, 1.1), a.uniform(0.45, 0.6)
    half = 0.5 * (cab + body)
    deck = radius * 1.5
    chassis = a.look("metal", colors=("black", "dark grey"))
    a.add(box((2 * half, 0.8 * width, 0.07)), chassis, (0, 0, radius))
    x = half - 0.5 * cab
    nose = a.chance(0.35)
    if nose:
        a.add(box((cab * 0.55, width * 0.9, height * 0.5)), look, (half + 0.15 * cab, 0, deck))
    slope = a.uniform(0.75, 1.0)
    a.add(
        box((cab, width, height), taper=(slope, 0.95), shear=(-0.5 * cab * (1 - slope), 0)),
        look,
        (x, 0, deck),
    )
    a.add(box((cab * 0.5, width * 1.02, height * 0.35)), glass, (x, 0, deck + 0.52 * height))
    a.add(
        box((0.03, width * 0.85, height * 0.35)),
        glass,
        (half - 0.4 * cab * (1 - slope) * 1.2, 0, deck + 0.52 * height),
    )
    rear = -half + 0.5 * body
    kind = a.choose(["box", "box", "tank", "bed", "dump"])
    if kind == "box":
        a.add(box((body * 0.97, width * 1.04, height * a.uniform(1.0, 1.5))), load, (rear, 0, deck))
    elif kind == "tank":
        r = 0.5 * width
        shape = revolve(
            [(0, 0), (r * 0.8, 0), (r, 0.06), (r, body - 0.06), (r * 0.8, body), (0, body)]
        )
        a.add(shape, load, (-half, 0, deck + r), turn_about("y", 90))
    else:
        tall = height * (0.3 if kind == "bed" else 0.55)
        lean = turn_about("y", 12.0 if kind == "dump" and a.chance(0.4) else 0.0)
        for sign in (-1.0, 1.0):
            a.add(box((body, 0.03, tall)), load, (rear, sign * 0.5 * width, deck), lean)
        for end in (-0.5, 0.5):
            a.add(box((0.03, width, tall)), load, (rear + end * body, 0, deck), lean)
        a.add(box((body, width, 0.04)), load, (rear, 0, deck), lean)
        if a.chance(0.3):
            cargo = a.look("stone", "wooden", avoid=load)
            a.add(ellipsoid((0.42 * body, 0.45 * width, tall)), cargo, (rear, 0, deck + 0.5 * tall))
    axles = [half - 0.4 * cab, -half + 0.2 * body]
    if a.chance(0.5):
        axles.append(-half + 0.2 * body + 2.2 * radius)
    wheels(a, axles, 0.38 * width, radius, 0.12)
    lights(a, half + (0.42 * cab if nose else 0.0), 0.35 * width, deck + 0.1, -half)
    nouns = {
        "box": ("truck", "lorry", "truck", "toy truck"),
        "tank": ("tanker truck", "truck", "milk truck"),
        "bed": ("truck", "toy truck", "lorry"),
        "dump": ("dump truck", "truck", "toy truck"),
    }[kind]
    part = "tank" if kind == "tank" else "back"
    return Description(nouns, look, (f"a {load.color} {part}", "black wheels"))


def bus(a: Assembly) -> Description:
    """A bus or a tram: a long box with rows of windows."""
    look = a.look("painted", "plastic", colors=PAINTS, patterns=("two_tone",), pattern_chance=0.3)
    glass = a.look("glass", colors=("light blue", "black", "dark blue", "white"), avoid=look)
    length, width = 1.3, a.uniform(0.38, 0.48)
    decks = 2 if a.chance(0.25) else 1
    height, low = 0.42 * (1.7 if decks == 2 else 1) * a.uniform(0.9, 1.1), 0.09
    body = ellipsoid(
        (0.5 * length, 0.5 * width, 0.5 * height), roundness=(0.18, 0.18), rows=16, segments=24
    )
    a.add(body, look, (0, 0, low + 0.5 * height))
    for deck in range(decks):
        z = low + height * (0.52 if decks == 1 else 0.28 + 0.42 * deck)
        tall = height * (0.32 if decks == 1 else 0.2)
        count = a.integer(4, 7)
        for k in range(count):
            x = ((k + 0.5) / count - 0.5) * 0.92 * length
            a.add(box((0.75 * length / count, width * 1.02, tall)), glass, (x, 0, z))
        a.add(box((length * 1.012, 0.8 * width, tall)), glass, (0, 0, z))
    wheels(a, [0.32 * length, -0.32 * length], 0.4 * width, 0.1, 0.09)
    lights(a, 0.49 * length, 0.34 * width, 0.2, -0.5 * length)
    nouns = ("bus", "tall bus") if decks == 2 else ("bus", "school bus", "toy bus", "tram")
    return Description(
        nouns, look, (detail(glass, "windows", plural=True), "windows", "black wheels")
    )


def train(a: Assembly) -> Description:
    """A locomotive, perhaps with a wagon."""
    look = a.look("painted", "plastic", "wooden", "metal", colors=PAINTS)
    trim = a.look("metal", "plastic", avoid=look)
    width, wheel = 0.4, a.uniform(0.1, 0.15)
    a.add(box((1.1, width, 0.08)), trim, (0, 0, wheel))
    z = wheel + 0.08
    r = a.uniform(0.15, 0.2)
    a.add(cylinder(r, 0.7), look, (-0.15, 0, z + r), turn_about("y", 90))
    a.add(cylinder(r * 0.6, 0.02), trim, (0.55, 0, z + r), turn_about("y", 90))
    for x in (0.0, 0.3):
        a.add(torus(r * 1.0, 0.02, sides=6), trim, (x, 0, z + r), turn_about("y", 90))
    stack = revolve([(0.06, 0), (0.06, 0.14), (a.uniform(0.06, 0.13), 0.26), (0, 0.24)], 16)
    a.add(stack, trim, (0.4, 0, z + 1.8 * r))
    a.add(ellipsoid((0.07, 0.07, 0.09)), trim, (0.12, 0, z + 2 * r))
    tall = a.uniform(0.45, 0.6)
    a.add(box((0.4, width, tall)), look, (-0.35, 0, z))
    a.add(box((0.48, width * 1.15, 0.05)), trim, (-0.35, 0, z + tall))
    dark = a.look("glass", colors=("black", "light blue", "dark blue"), avoid=look)
    a.add(box((0.2, width * 1.03, 0.5 * r + 0.06)), dark, (-0.35, 0, z + 0.58 * tall))
    a.add(box((0.12, width * 0.8, 0.1), taper=(0.3, 1)), trim, (0.57, 0, 0.4 * wheel))
    axles = [0.38, 0.1, -0.35]
    if a.chance(0.3):
        cart = a.look("painted", "wooden", avoid=look)
        a.add(box((0.5, width, 0.3)), cart, (-0.95, 0, z))
        a.add(box((0.2, 0.06, 0.05)), trim, (-0.62, 0, z))
        axles.append(-0.95)
    wheels(a, axles, 0.4 * width, wheel, 0.06, a.look("rubber", "metal"))
    return Description(
        ("train", "locomotive", "toy locomotive", "toy train", "train engine"),
        look,
        (detail(trim, "roof"), "a chimney"),
    )


def ring_of(
    x: float, half_width: float, half_height: float, z: float, power: float
) -> Float32Array:
    """Return a superellipse section [16, 3] in the yz plane at x."""
    angle = np.linspace(0, 2 * math.pi, 16, endpoint=False)
    cos, sin = np.cos(angle), np.sin(angle)
    reach = (np.abs(cos) ** power + np.abs(sin) ** power) ** (-1 / power)
    return np.stack(
        [np.full(16, x), half_width * reach * cos, z + half_height * reach * sin], axis=1
    ).astype(np.float32)


def wing(root: float, tip: float, span: float, sweep: float, thick: float) -> Quads:
    """Return a wing from the root at y = 0 outward along +y."""
    outline = [
        (0.5 * root, 0.0),
        (0.5 * tip - sweep, span),
        (-0.5 * tip - sweep, span),
        (-0.5 * root, 0.0),
    ]
    return prism(outline, thick)


FAMILIES = (
    car,
    truck,
    bus,
    train,
)
