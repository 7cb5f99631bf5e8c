"""Cooking families: goblets, pans, pots, spoons, tins and pastry."""

from __future__ import annotations

import math

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    DECORATIONS,
    Assembly,
    Description,
)
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.home.kitchen import side_label
from recipes.train_embedded_prior.procedural.primitives import cylinder, disc, ellipsoid
from recipes.train_embedded_prior.procedural.sweeps import (
    arc,
    revolve,
    rod,
    shell_profile,
    smooth_profile,
    torus,
    tube,
)


def goblet(a: Assembly) -> Description:
    """A glass on a stem, or a chalice."""
    look = a.look(
        "glass",
        "metal",
        "golden",
        "ceramic",
        patterns=("bands", "gradient", "rim"),
        pattern_chance=0.2,
    )
    radius, stem = a.uniform(0.2, 0.32), a.uniform(0.2, 0.5)
    cup_height, foot = a.uniform(0.3, 0.5), a.uniform(0.16, 0.26)
    cup = smooth_profile(
        [
            (0.03, stem),
            (radius * a.uniform(0.8, 1.1), stem + 0.45 * cup_height),
            (radius * a.uniform(0.7, 1.1), stem + cup_height),
        ],
        12,
    )
    base = np.array([(0, 0), (foot, 0), (foot * 0.9, 0.03), (0.03, 0.08)])
    outer = np.concatenate([base, cup])
    inner = np.stack(
        [np.maximum(cup[::-1, 0] - 0.025, 0), np.maximum(cup[::-1, 1], stem + 0.03)], 1
    )
    a.add(revolve(np.concatenate([outer, inner]), 24), look)
    nouns = ("goblet", "wine glass", "glass", "chalice", "cocktail glass")
    details: tuple[str, ...] = ("a stem",)
    if a.chance(0.35):
        drink = a.look(colors=("dark red", "red", "yellow", "orange", "brown"))
        level = float(cup[7, 0]) - 0.02
        a.add(disc(max(level, 0.05)), drink, (0, 0, float(cup[7, 1])))
        details = (f"{drink.color} wine",)
    return Description(nouns, look, details)


def pan(a: Assembly) -> Description:
    """A frying pan or a saucepan with one long handle."""
    look = a.look("metal", colors=("black", "dark grey", "grey", "black", "silver", "red", "blue"))
    deep = a.chance(0.35)
    radius, depth = 0.4, a.uniform(0.25, 0.4) if deep else a.uniform(0.06, 0.12)
    outer = [(radius * a.uniform(0.8, 0.98), 0), (radius, depth)]
    inside = look if a.chance(0.6) else a.look("metal", avoid=look)
    profile = shell_profile(outer, 0.025)
    a.add(revolve(profile[:4], 28), look)
    a.add(revolve(profile[3:], 28), inside)
    if a.chance(0.08):
        return Description(("frying pan", "pan", "skillet"), look, ("no handle",))
    grip = look if a.chance(0.5) else a.look("wooden", "plastic", avoid=look)
    length, rise = a.uniform(0.4, 0.75), a.uniform(0.0, 0.15)
    path = smooth_profile(
        [
            (radius * 0.95, 0, depth * 0.7),
            (radius + 0.15, 0, depth + 0.3 * rise),
            (radius + length, 0, depth + rise),
        ],
        8,
    )
    a.add(tube(path, np.linspace(0.025, a.uniform(0.03, 0.05), 8), flatten=a.uniform(1, 1.8)), grip)
    details = [detail(grip, "handle")] if grip is not look else ["a long handle"]
    if deep:
        return Description(("saucepan", "pot", "pan", "cooking pot"), look, tuple(details))
    return Description(("frying pan", "pan", "skillet"), look, tuple(details))


def pot(a: Assembly) -> Description:
    """A cooking pot with two handles and perhaps a lid."""
    look = a.look(
        "metal",
        "metal",
        "ceramic",
        patterns=("bands", "rim", "two_tone", "gradient"),
        pattern_chance=0.25,
    )
    radius, height = 0.42, a.uniform(0.3, 0.7)
    knots = [(radius * 0.92, 0), (radius, 0.15 * height), (radius * a.uniform(0.9, 1.0), height)]
    outer = smooth_profile(knots, 8)
    lidded = a.chance(0.6)
    grip = look if a.chance(0.5) else a.look("plastic", "metal", avoid=look)
    details = ["two handles"] if grip is look else [f"{grip.color} handles"]
    if lidded:
        lid = look if a.chance(0.5) else a.look("metal", "glass", avoid=look)
        a.add(revolve(np.concatenate([[(0, 0)], outer]), 28), look)
        dome, rim = a.uniform(0.05, 0.18), float(outer[-1, 0])
        a.add(
            revolve([(rim * 1.03, 0), (rim * 1.03, 0.02), (0.7 * rim, 0.7 * dome), (0, dome)], 28),
            lid,
            (0, 0, height),
        )
        a.add(ellipsoid((0.06, 0.06, 0.05)), grip, (0, 0, height + dome + 0.03))
        details.append("a lid" if lid is look else detail(lid, "lid"))
    else:
        a.add(revolve(shell_profile(outer, 0.03), 28), look)
    loop = arc(-90, 90, 0.12, 9, plane="yx")[:, [1, 0, 2]]
    path = np.stack([0.9 * np.abs(loop[:, 1]), 1.2 * loop[:, 0], loop[:, 2]], axis=1)
    path = np.stack(
        [
            0.12 * np.cos(np.linspace(-1.57, 1.57, 9)),
            0.14 * np.sin(np.linspace(-1.57, 1.57, 9)),
            np.zeros(9),
        ],
        axis=1,
    )
    part = tube(path, 0.025)
    a.add_around(part, grip, 2, (radius * 0.97, 0, height * 0.75))
    return Description(
        ("pot", "cooking pot", "stew pot", "casserole", "saucepan"), look, tuple(details)
    )


def spoon(a: Assembly) -> Description:
    """A spoon, ladle or spatula, lying or standing."""
    look = a.look("metal", "wooden", "plastic", "wooden")
    length, bowl_size = a.uniform(0.7, 1.0), a.uniform(0.09, 0.2)
    kind = a.choose(["spoon", "spoon", "ladle", "spatula", "fork"])
    grip = look if a.chance(0.6) else a.look("wooden", "plastic", avoid=look)
    lift = a.uniform(0.0, 0.15)
    path = smooth_profile([(0, 0, 0.03), (0.5 * length, 0, lift), (length, 0, 0.5 * lift)], 9)
    a.add(tube(path, np.linspace(0.02, a.uniform(0.025, 0.045), 9), flatten=1.3), grip)
    center = (-bowl_size * 1.1, 0, 0.05)
    if kind in ("spoon", "ladle"):
        depth = bowl_size * (0.9 if kind == "ladle" else 0.35)
        angle = np.linspace(0, 1.5, 8)
        cup = np.stack([bowl_size * np.sin(angle), depth * (1 - np.cos(angle))], axis=1)
        a.add(
            revolve(shell_profile(cup, 0.012), 20).stretched(1.35, 1, 1), look, (*center[:2], -0.02)
        )
    elif kind == "spatula":
        blade = ellipsoid((bowl_size * 1.5, bowl_size, 0.015), roundness=(1, 0.3))
        a.add(blade, look, center)
    else:
        a.add(ellipsoid((0.1, 0.09, 0.02)), look, (-0.08, 0, 0.03))
        for y in (-0.07, -0.023, 0.023, 0.07):
            a.add(rod((-0.1, y, 0.03), (-0.32, y, 0.05), 0.014), look)
    nouns = {
        "spoon": ("spoon", "wooden spoon" if look.substance == "wooden" else "spoon"),
        "ladle": ("ladle", "soup ladle"),
        "spatula": ("spatula", "kitchen spatula"),
        "fork": ("fork",),
    }[kind]
    return Description(nouns, look, () if grip is look else (detail(grip, "handle"),), ("long",))


def jar(a: Assembly) -> Description:
    """A jar, can or tin: a cylinder with a lid or rims and a label."""
    look = a.look("glass", "metal", "ceramic", "plastic", patterns=DECORATIONS, pattern_chance=0.3)
    radius, height = a.uniform(0.25, 0.45), a.uniform(0.35, 1.1)
    kind = a.choose(["jar", "can", "tin"])
    power = a.choose([2.0, 2.0, 6.0]) if kind != "can" else 2.0
    edge = 0.03
    knots = [
        (0, 0),
        (radius - edge, 0),
        (radius, edge),
        (radius, height - edge),
        (radius - edge, height),
        (0, height),
    ]
    a.add(revolve(knots, 26, power=power), look)
    details = []
    if a.chance(0.6):
        label = a.look("paper", avoid=look, patterns=DECORATIONS, pattern_chance=0.3)
        mark = side_label(a, radius, 0.5 * height, 0.4 * height, label)
        band = [(radius * 1.012, 0.15 * height), (radius * 1.012, 0.85 * height)]
        a.add(revolve(band, 26, power=power), label.marked(mark))
        details.append(detail(label, "label"))
    if kind == "can":
        steel = a.look("metal", colors=("silver", "grey"))
        for z in (0.0, height):
            a.add(torus(radius - edge, 0.02, sides=6), steel, (0, 0, z))
        a.add(disc(radius - edge), steel, (0, 0, height + 0.003))
    else:
        lid = a.look("metal", "plastic", "wooden", avoid=look)
        size = radius * a.uniform(0.85, 1.05)
        a.add(
            revolve([(size, 0), (size, 1.0), (0, 1.0)], 26, power=power).stretched(
                1, 1, a.uniform(0.06, 0.16)
            ),
            lid,
            (0, 0, height),
        )
        if a.chance(0.25):
            a.add(ellipsoid((0.05, 0.05, 0.05)), lid, (0, 0, height + 0.15))
        details.append(detail(lid, "lid"))
    nouns = {
        "jar": ("jar", "glass jar" if look.substance == "glass" else "jar", "cookie jar"),
        "can": ("can", "soda can", "tin can"),
        "tin": ("tin", "canister", "container"),
    }[kind]
    return Description(
        nouns, look, tuple(details), ("tall",) if height > 2.2 * radius else ("short",)
    )


def cake(a: Assembly) -> Description:
    """A cake or muffin with icing."""
    sponge = a.look(
        colors=("brown", "beige", "light brown", "dark brown", "yellow", "cream", "pink")
    )
    icing = a.look(
        colors=("pink", "white", "brown", "cream", "light blue", "red", "light green"), avoid=sponge
    )
    if a.chance(0.3):
        a.add(
            revolve([(0, 0), (0.25, 0), (0.36, 0.35), (0, 0.35)], 24, lobes=14, lobe_depth=0.05),
            sponge,
        )
        swirl = smooth_profile([(0.38, 0.33), (0.36, 0.45), (0.2, 0.6), (0, 0.72)], 10)
        a.add(revolve(swirl, 24), icing)
        nouns = ("cupcake", "muffin", "cake")
    else:
        z, radius = 0.0, 0.5
        for _ in range(a.integer(1, 3)):
            height = a.uniform(0.15, 0.3)
            a.add(cylinder(radius, height), sponge, (0, 0, z))
            drip = a.integer(7, 12)
            cover = [
                (radius * 1.02, 0.6 * height),
                (radius * 1.03, height + 0.02),
                (0, height + 0.025),
            ]
            a.add(revolve(cover, 30, lobes=drip, lobe_depth=0.012), icing, (0, 0, z))
            z, radius = z + height, radius * a.uniform(0.6, 0.8)
        nouns = ("cake", "birthday cake", "layer cake")
    top = max(float(q.corners[..., 2].max()) for q in a.quads)
    details = [f"{icing.color} icing", f"{icing.color} frosting"]
    if a.chance(0.5):
        berry = a.look(colors=("red", "dark red", "purple"))
        a.add(ellipsoid((0.06, 0.06, 0.06)), berry, (0, 0, top + 0.03))
        details.append("a cherry")
    if nouns[0] == "cake" and a.chance(0.35):
        candle = a.look("wax")
        count = a.integer(3, 8)
        a.add_around(rod((0, 0, 0), (0, 0, 0.2), 0.02), candle, count, (0.22, 0, top - 0.02))
        details.append("candles")
    return Description(nouns, sponge, tuple(details))


def donut(a: Assembly) -> Description:
    """A donut with icing and sprinkles, or a plain ring."""
    dough = a.look(colors=("light brown", "brown", "beige", "golden"))
    radius, thick = 0.35, a.uniform(0.12, 0.2)
    a.add(torus(radius, thick), dough)
    icing = a.look(
        colors=("pink", "white", "dark brown", "light blue", "yellow", "purple", "cream"),
        avoid=dough,
        patterns=("speckles", "diagonal"),
        pattern_chance=0.5,
    )
    angle = np.linspace(a.uniform(-0.4, 0.1), math.pi + a.uniform(-0.1, 0.4), 9)
    line = np.stack([radius + 1.04 * thick * np.cos(angle), 1.04 * thick * np.sin(angle)], axis=1)
    a.add(revolve(line, 30), icing)
    return Description(
        ("donut", "doughnut", "donut", "ring cake"),
        dough,
        (f"{icing.color} icing", f"{icing.color} frosting"),
    )


FAMILIES = (
    goblet,
    pan,
    pot,
    spoon,
    jar,
    cake,
    donut,
)
