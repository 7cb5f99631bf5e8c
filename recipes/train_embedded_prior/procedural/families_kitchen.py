"""Kitchen families: vessels, cutlery, pans and tins.

Every family is a function of an ``Assembly`` that adds parts and returns a ``Description``.
"""

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
from recipes.train_embedded_prior.procedural.materials import Mark
from recipes.train_embedded_prior.procedural.primitives import (
    arc,
    cylinder,
    disc,
    ellipsoid,
    revolve,
    rod,
    shell_profile,
    smooth_profile,
    torus,
    tube,
    turn_about,
)


def side_label(a: Assembly, radius: float, z: float, height: float, look: Look) -> Mark:
    """Return a printed label for the front of a round vessel."""
    tone = a.look(avoid=look).material.color
    width = radius * a.uniform(0.5, 0.9)
    return Mark((0, 0, z), (1, a.uniform(-0.3, 0.3), 0), (width, 0.5 * height), tone, "label")


def ear(
    a: Assembly, radius: float, low: float, high: float, look: Look, reach: float, angle: float = 0
) -> None:
    """Add a curved handle on the +x side between two heights, turned about z by ``angle``."""
    height = high - low
    thickness = height * a.uniform(0.08, 0.14)
    style = a.integer(0, 2)
    if style == 0:
        bend = arc(-88, 88, 1.0, 11)
        path = np.stack([bend[:, 0] * reach, bend[:, 1], bend[:, 2] * 0.5 * height], axis=1)
        path[:, 2] += low + 0.5 * height
    else:
        knots = [(0, 0, low), (reach, 0, low + (0.1 if style == 1 else 0.3) * height),
                 (reach * a.uniform(0.8, 1.1), 0, high - 0.1 * height), (0, 0, high)]
        path = smooth_profile(knots, 12)
    path[:, 0] += radius - 0.5 * thickness
    part = tube(path, thickness, flatten=a.uniform(0.8, 1.8))
    a.add(part, look, turn=turn_about("z", angle))


def mug(a: Assembly) -> Description:
    """A mug or cup with a handle."""
    look = a.look("ceramic", "ceramic", "plastic", "porcelain", "metal", patterns=DECORATIONS)
    height, radius = a.uniform(0.7, 1.2), a.uniform(0.33, 0.55)
    foot = radius * a.choose([1.0, 1.0, a.uniform(0.6, 0.95)])
    belly = a.choose([0.0, 0.0, a.uniform(-0.06, 0.1)])
    knots = [(foot, 0), (0.5 * (foot + radius) + belly, 0.45 * height), (radius, height)]
    outer = smooth_profile(knots, 10)
    if a.chance(0.25):
        label = Mark((0, 0, 0.5 * height), (0, a.choose([-1, 1]), 0.0),
                     (0.5 * radius, a.uniform(0.15, 0.3) * height),
                     a.look(avoid=look).material.color, a.choose(["disc", "star", "label", "ring"]))
        look = look.marked(label)
    wall = a.uniform(0.03, 0.06)
    inside = look if a.chance(0.6) else a.look(colors=("white", "cream", "black", "light grey"))
    profile = shell_profile(outer, wall)
    a.add(revolve(profile[:12], 28), look)
    a.add(revolve(profile[11:], 28), inside)
    handle_look = look if a.chance(0.8) else a.look(avoid=look)
    low, high = height * a.uniform(0.1, 0.25), height * a.uniform(0.72, 0.92)
    ear(a, min(foot, radius) + 0.4 * (radius - foot), low, high, handle_look, a.uniform(0.2, 0.38))
    details = ["a handle"] if handle_look is look else [detail(handle_look, "handle")]
    nouns = ("mug", "mug", "cup", "coffee mug", "coffee cup", "tea cup")
    return Description(nouns, look, tuple(details), ("tall",) if height > 2.2 * radius else ("wide",))


def tumbler(a: Assembly) -> Description:
    """A cup without handle."""
    look = a.look("plastic", "glass", "paper", "metal", patterns=DECORATIONS)
    height, radius = a.uniform(0.6, 1.2), a.uniform(0.28, 0.5)
    outer = [(radius * a.uniform(0.6, 0.95), 0), (radius, height)]
    lid = a.chance(0.25)
    a.add(revolve(shell_profile(outer, 0.03), a.choose([28, 28, 8, 6])), look)
    details = []
    if lid:
        cover = a.look("plastic", avoid=look)
        a.add(cylinder(radius * 1.04, 0.06, radius * 0.95), cover, (0, 0, height))
        details.append(detail(cover, "lid"))
        if a.chance(0.6):
            a.add(rod((0, 0, height), (0.1, 0, height + 0.5), 0.03), a.look("plastic"))
            details.append("a straw")
    return Description(("cup", "tumbler", "paper cup", "drinking cup", "beaker"), look, tuple(details))


def bottle(a: Assembly) -> Description:
    """A bottle with cap and perhaps a label."""
    look = a.look("glass", "plastic", "plastic", "metal", "ceramic", patterns=DECORATIONS,
                  pattern_chance=0.25)
    radius, body = a.uniform(0.16, 0.32), a.uniform(0.45, 0.75)
    neck, neck_height = radius * a.uniform(0.3, 0.6), a.uniform(0.08, 0.3)
    shoulder = a.uniform(0.08, 0.3)
    knots = [(radius, 0.0), (radius, body), (radius * 0.85, body + 0.5 * shoulder),
             (neck, body + shoulder), (neck, body + shoulder + neck_height)]
    outer = np.array(knots) if a.chance(0.3) else np.concatenate(
        [[(radius * 0.9, 0), (radius, 0.04)], smooth_profile(knots[1:], 12)])
    if a.chance(0.2):
        waist = radius * a.uniform(0.75, 0.9)
        outer = np.concatenate([[(radius, 0), (radius, 0.3 * body), (waist, 0.5 * body),
                                 (radius, 0.7 * body)], smooth_profile(knots[1:], 10)])
    power = a.choose([2.0, 2.0, 2.0, 5.0])
    details = []
    if a.chance(0.55):
        label = a.look("paper", avoid=look)
        band = revolve([(radius * 1.015, body * 0.25), (radius * 1.015, body * 0.8)], 24, power=power)
        tone = label.marked(side_label(a, radius, 0.52 * body, 0.35 * body, label))
        a.add(band, tone if a.chance(0.7) else label)
        details.append(detail(label, "label"))
    a.add(revolve(np.concatenate([[(0, 0)], outer]), 24, power=power), look)
    top = body + shoulder + neck_height
    cap = a.look("plastic", "metal", avoid=look)
    a.add(cylinder(neck * a.uniform(1.1, 1.4), a.uniform(0.05, 0.14)), cap, (0, 0, top - 0.02))
    details.append(detail(cap, "cap"))
    nouns = ("bottle", "bottle", "water bottle", "wine bottle", "juice bottle", "soda bottle", "flask")
    return Description(nouns, look, tuple(details), ("tall",) if top > 4 * radius else ("short",))


def bowl(a: Assembly) -> Description:
    """An open bowl, ramekin or dish."""
    look = a.look("ceramic", "porcelain", "wooden", "metal", "plastic", "clay", patterns=DECORATIONS)
    radius, height = 0.5, a.uniform(0.15, 0.5)
    foot = radius * a.uniform(0.35, 0.95)
    if foot > 0.75 * radius:
        outer = smooth_profile([(foot, 0), (radius, 0.5 * height), (radius, height)], 10)
    else:
        angle = np.linspace(0, a.uniform(1.2, 1.57), 11)
        outer = np.stack([foot + (radius - foot) * np.sin(angle), height * (1 - np.cos(angle))], 1)
    inside = look if a.chance(0.6) else a.look("ceramic", avoid=look)
    wall = a.uniform(0.02, 0.05)
    profile = shell_profile(outer, wall)
    lobes = a.integer(8, 20) if a.chance(0.15) else 0
    rows = len(outer) + 1
    a.add(revolve(profile[: rows + 1], 30, lobes=lobes, lobe_depth=0.06), look)
    a.add(revolve(profile[rows:], 30, lobes=lobes, lobe_depth=0.06), inside)
    details = [] if inside is look else [f"a {inside.color} inside"]
    if a.chance(0.12):
        stub = a.look("plastic", avoid=look)
        a.add(rod((radius * 0.95, 0, height * 0.9), (radius + 0.25, 0, height), 0.05), stub)
        details.append(detail(stub, "handle"))
    nouns = ("bowl", "bowl", "dish", "soup bowl", "salad bowl")
    nouns = ("ramekin", "bowl", "dish") if foot > 0.75 * radius and height > 0.3 else nouns
    return Description(nouns, look, tuple(details), ("deep",) if height > 0.35 else ("shallow",))


def vase(a: Assembly) -> Description:
    """A vase or urn: any profile that curves, often lobed."""
    look = a.look("ceramic", "porcelain", "glass", "clay", "stone", patterns=DECORATIONS)
    count = a.integer(3, 6)
    radii = a.rng.uniform(0.1, 0.36, count)
    radii[0] = max(radii[0], 0.14)
    outer = smooth_profile(np.stack([radii, np.linspace(0, 1, count)], axis=1), 18)
    outer[:, 0] = outer[:, 0].clip(0.06)
    lobes = a.choose([0, 0, 0, a.integer(5, 14)])
    segments = a.choose([28, 28, 28, 4, 6, 8])
    a.add(revolve(shell_profile(outer, 0.035), segments, lobes=lobes, lobe_depth=0.08), look)
    details: list[str] = []
    if a.chance(0.2):
        for angle in (0.0, 180.0):
            ear(a, float(outer[9, 0]), 0.45, 0.85, look, 0.18, angle)
        details.append("two handles")
    if a.chance(0.2):
        bloom = a.look(colors=("red", "pink", "yellow", "white", "purple", "orange"))
        stem = a.look("leafy")
        for _ in range(a.integer(1, 5)):
            end = (a.uniform(-0.3, 0.3), a.uniform(-0.3, 0.3), a.uniform(1.2, 1.6))
            a.add(rod((0, 0, 0.6), end, 0.015), stem)
            a.add(ellipsoid((0.1, 0.1, 0.08)), bloom, end)
        details.append(f"{bloom.color} flowers")
    return Description(("vase", "vase", "urn", "flower vase", "pot"), look, tuple(details))


def plate(a: Assembly) -> Description:
    """A plate or saucer."""
    look = a.look("ceramic", "porcelain", "plastic", patterns=("stripes", "dots", "patches"),
                  pattern_chance=0.2)
    rise, foot = a.uniform(0.04, 0.14), a.uniform(0.25, 0.36)
    outer = [(foot, 0), (0.38, 0.3 * rise), (0.5, rise)]
    segments = a.choose([32, 32, 32, 4, 8])
    inner_edge = a.uniform(0.3, 0.4)
    profile = [(0, 0), *outer, (0.49, rise + 0.02), (inner_edge, 0.45 * rise), (foot, 0.03), (0, 0.03)]
    details = []
    if a.chance(0.4):
        rim = a.look("ceramic", avoid=look)
        a.add(revolve(profile[2:6], segments), rim)
        a.add(revolve(profile[:3], segments), look)
        a.add(revolve(profile[5:], segments), look)
        details.append(detail(rim, "rim"))
    else:
        a.add(revolve(profile, segments), look)
    if a.chance(0.15):
        for _ in range(a.integer(1, 4)):
            food = a.look(colors=("red", "orange", "green", "brown", "yellow"))
            size = a.uniform(0.06, 0.12)
            at = (a.uniform(-0.18, 0.18), a.uniform(-0.18, 0.18), 0.05 + 0.5 * size)
            a.add(ellipsoid((size, size, 0.7 * size)), food, at)
        details.append("food")
    return Description(("plate", "plate", "dish", "saucer", "dinner plate"), look, tuple(details))


def teapot(a: Assembly) -> Description:
    """A teapot or kettle: body, spout, handle, lid with a knob."""
    look = a.look("ceramic", "porcelain", "metal", "clay", patterns=DECORATIONS)
    height, radius = a.uniform(0.5, 0.85), a.uniform(0.38, 0.52)
    top = radius * a.uniform(0.4, 0.65)
    knots = [(radius * 0.6, 0), (radius, 0.4 * height), (0.85 * radius, 0.75 * height), (top, height)]
    a.add(revolve(np.concatenate([[(0, 0)], smooth_profile(knots, 14)]), 28), look)
    lid = look if a.chance(0.6) else a.look("ceramic", avoid=look)
    dome = a.uniform(0.06, 0.16)
    cap = [(top * 1.05, 0), (0.8 * top, 0.6 * dome), (0.3 * top, dome), (0, dome)]
    a.add(revolve(cap, 24), lid, (0, 0, height))
    knob = a.uniform(0.04, 0.075)
    a.add(ellipsoid((knob, knob, knob)), lid, (0, 0, height + dome + 0.7 * knob))
    start, reach = radius * 0.75, radius + a.uniform(0.25, 0.4)
    spout = smooth_profile([(start, 0, 0.3 * height), (reach - 0.1, 0, 0.45 * height),
                            (reach, 0, height * a.uniform(0.85, 1.05))], 9)
    a.add(tube(spout, np.linspace(0.11, 0.045, 9)), look)
    grip = look if a.chance(0.7) else a.look("plastic", "wooden", avoid=look)
    if a.chance(0.7):
        ear(a, radius * 0.9, 0.2 * height, 0.85 * height, grip, a.uniform(0.25, 0.35), 180)
    else:
        loop = arc(0, 180, 1.0, 13)
        path = loop * np.array([0.8 * radius, 1, 0.6], np.float32) + np.array([0, 0, 0.85 * height])
        a.add(tube(path, 0.04), grip)
    details = [f"a {lid.color} lid"] if lid is not look else ["a lid", "a spout"]
    if grip is not look:
        details.append(detail(grip, "handle"))
    return Description(("teapot", "teapot", "kettle", "tea pot"), look, tuple(details))


def jug(a: Assembly) -> Description:
    """A jug or pitcher with a lip and a handle, open at the top."""
    look = a.look("ceramic", "glass", "metal", "clay", "plastic", patterns=DECORATIONS)
    radius, neck = a.uniform(0.24, 0.38), a.uniform(0.14, 0.26)
    knots = [(radius * 0.8, 0), (radius, 0.35), (neck, 0.75), (neck * a.uniform(1.0, 1.3), 1.0)]
    part = revolve(shell_profile(smooth_profile(knots, 14), 0.03), 28)
    corners = part.corners.copy()
    lip = np.clip((corners[..., 2] - 0.8) / 0.2, 0, 1) * (corners[..., 0] > 0)
    corners[..., 0] *= 1 + a.uniform(0.3, 0.7) * lip * (1 - np.abs(corners[..., 1]) / (neck * 1.4)).clip(0)
    a.add(type(part)(corners, part.uv, None), look)
    ear(a, neck + 0.02, 0.3, 0.92, look, a.uniform(0.22, 0.34), 180)
    return Description(("jug", "pitcher", "water jug", "milk jug", "carafe"), look, ("a handle",))


def goblet(a: Assembly) -> Description:
    """A glass on a stem, or a chalice."""
    look = a.look("glass", "metal", "golden", "ceramic", patterns=("bands", "gradient", "rim"),
                  pattern_chance=0.2)
    radius, stem = a.uniform(0.2, 0.32), a.uniform(0.2, 0.5)
    cup_height, foot = a.uniform(0.3, 0.5), a.uniform(0.16, 0.26)
    cup = smooth_profile([(0.03, stem), (radius * a.uniform(0.8, 1.1), stem + 0.45 * cup_height),
                          (radius * a.uniform(0.7, 1.1), stem + cup_height)], 12)
    base = np.array([(0, 0), (foot, 0), (foot * 0.9, 0.03), (0.03, 0.08)])
    outer = np.concatenate([base, cup])
    inner = np.stack([np.maximum(cup[::-1, 0] - 0.025, 0), np.maximum(cup[::-1, 1], stem + 0.03)], 1)
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
    path = smooth_profile([(radius * 0.95, 0, depth * 0.7), (radius + 0.15, 0, depth + 0.3 * rise),
                           (radius + length, 0, depth + rise)], 8)
    a.add(tube(path, np.linspace(0.025, a.uniform(0.03, 0.05), 8), flatten=a.uniform(1, 1.8)), grip)
    details = [detail(grip, "handle")] if grip is not look else ["a long handle"]
    if deep:
        return Description(("saucepan", "pot", "pan", "cooking pot"), look, tuple(details))
    return Description(("frying pan", "pan", "skillet"), look, tuple(details))


def pot(a: Assembly) -> Description:
    """A cooking pot with two handles and perhaps a lid."""
    look = a.look("metal", "metal", "ceramic", patterns=("bands", "rim", "two_tone", "gradient"),
                  pattern_chance=0.25)
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
        a.add(revolve([(rim * 1.03, 0), (rim * 1.03, 0.02), (0.7 * rim, 0.7 * dome), (0, dome)], 28),
              lid, (0, 0, height))
        a.add(ellipsoid((0.06, 0.06, 0.05)), grip, (0, 0, height + dome + 0.03))
        details.append("a lid" if lid is look else detail(lid, "lid"))
    else:
        a.add(revolve(shell_profile(outer, 0.03), 28), look)
    loop = arc(-90, 90, 0.12, 9, plane="yx")[:, [1, 0, 2]]
    path = np.stack([0.9 * np.abs(loop[:, 1]), 1.2 * loop[:, 0], loop[:, 2]], axis=1)
    path = np.stack([0.12 * np.cos(np.linspace(-1.57, 1.57, 9)),
                     0.14 * np.sin(np.linspace(-1.57, 1.57, 9)), np.zeros(9)], axis=1)
    part = tube(path, 0.025)
    a.add_around(part, grip, 2, (radius * 0.97, 0, height * 0.75))
    return Description(("pot", "cooking pot", "stew pot", "casserole", "saucepan"), look, tuple(details))


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
        a.add(revolve(shell_profile(cup, 0.012), 20).stretched(1.35, 1, 1), look, (*center[:2], -0.02))
    elif kind == "spatula":
        blade = ellipsoid((bowl_size * 1.5, bowl_size, 0.015), roundness=(1, 0.3))
        a.add(blade, look, center)
    else:
        a.add(ellipsoid((0.1, 0.09, 0.02)), look, (-0.08, 0, 0.03))
        for y in (-0.07, -0.023, 0.023, 0.07):
            a.add(rod((-0.1, y, 0.03), (-0.32, y, 0.05), 0.014), look)
    nouns = {"spoon": ("spoon", "wooden spoon" if look.substance == "wooden" else "spoon"),
             "ladle": ("ladle", "soup ladle"), "spatula": ("spatula", "kitchen spatula"),
             "fork": ("fork",)}[kind]
    return Description(nouns, look, () if grip is look else (detail(grip, "handle"),), ("long",))


def jar(a: Assembly) -> Description:
    """A jar, can or tin: a cylinder with a lid or rims and a label."""
    look = a.look("glass", "metal", "ceramic", "plastic", patterns=DECORATIONS, pattern_chance=0.3)
    radius, height = a.uniform(0.25, 0.45), a.uniform(0.35, 1.1)
    kind = a.choose(["jar", "can", "tin"])
    power = a.choose([2.0, 2.0, 6.0]) if kind != "can" else 2.0
    edge = 0.03
    knots = [(0, 0), (radius - edge, 0), (radius, edge), (radius, height - edge),
             (radius - edge, height), (0, height)]
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
        a.add(revolve([(size, 0), (size, 1.0), (0, 1.0)], 26, power=power).stretched(1, 1, a.uniform(
            0.06, 0.16)), lid, (0, 0, height))
        if a.chance(0.25):
            a.add(ellipsoid((0.05, 0.05, 0.05)), lid, (0, 0, height + 0.15))
        details.append(detail(lid, "lid"))
    nouns = {"jar": ("jar", "glass jar" if look.substance == "glass" else "jar", "cookie jar"),
             "can": ("can", "soda can", "tin can"), "tin": ("tin", "canister", "container")}[kind]
    return Description(nouns, look, tuple(details), ("tall",) if height > 2.2 * radius else ("short",))


def cake(a: Assembly) -> Description:
    """A cake or muffin with icing."""
    sponge = a.look(colors=("brown", "beige", "light brown", "dark brown", "yellow", "cream", "pink"))
    icing = a.look(colors=("pink", "white", "brown", "cream", "light blue", "red", "light green"),
                   avoid=sponge)
    if a.chance(0.3):
        a.add(revolve([(0, 0), (0.25, 0), (0.36, 0.35), (0, 0.35)], 24, lobes=14, lobe_depth=0.05),
              sponge)
        swirl = smooth_profile([(0.38, 0.33), (0.36, 0.45), (0.2, 0.6), (0, 0.72)], 10)
        a.add(revolve(swirl, 24), icing)
        nouns = ("cupcake", "muffin", "cake")
    else:
        z, radius = 0.0, 0.5
        for _ in range(a.integer(1, 3)):
            height = a.uniform(0.15, 0.3)
            a.add(cylinder(radius, height), sponge, (0, 0, z))
            drip = a.integer(7, 12)
            cover = [(radius * 1.02, 0.6 * height), (radius * 1.03, height + 0.02), (0, height + 0.025)]
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
    icing = a.look(colors=("pink", "white", "dark brown", "light blue", "yellow", "purple", "cream"),
                   avoid=dough, patterns=("speckles", "diagonal"), pattern_chance=0.5)
    angle = np.linspace(a.uniform(-0.4, 0.1), math.pi + a.uniform(-0.1, 0.4), 9)
    line = np.stack([radius + 1.04 * thick * np.cos(angle), 1.04 * thick * np.sin(angle)], axis=1)
    a.add(revolve(line, 30), icing)
    return Description(("donut", "doughnut", "donut", "ring cake"), dough,
                       (f"{icing.color} icing", f"{icing.color} frosting"))


FAMILIES = (
    mug, tumbler, bottle, bowl, vase, plate, teapot, jug, goblet, pan, pot, spoon, jar, cake, donut,
)
