"""Nature families: trees, plants, flowers, mushrooms, fruit, snowmen."""

from __future__ import annotations

import math

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import Assembly, Description, Look
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.greenery import leaf, plant_pot
from recipes.train_embedded_prior.procedural.materials import Mark
from recipes.train_embedded_prior.procedural.primitives import (
    box,
    cylinder,
    ellipsoid,
    prism,
    regular_polygon,
)
from recipes.train_embedded_prior.procedural.quads import turn_about
from recipes.train_embedded_prior.procedural.sweeps import (
    revolve,
    rod,
    shell_profile,
    smooth_profile,
    torus,
    tube,
)

PETALS = ("red", "pink", "yellow", "white", "purple", "orange", "magenta", "light blue", "blue")


def tree(a: Assembly) -> Description:
    """A tree: conifer, round crown, blobs or palm."""
    trunk = a.look("wooden", colors=("brown", "dark brown", "light brown"))
    crown = (
        a.look("leafy")
        if a.chance(0.8)
        else a.look(colors=("orange", "red", "yellow", "pink", "white"))
    )
    kind = a.choose(["conifer", "round", "blobs", "palm", "low-poly"])
    stem, radius = a.uniform(0.2, 0.5), a.uniform(0.04, 0.09)
    if kind == "conifer":
        stem *= 0.6
        tiers, size = a.integer(1, 5), a.uniform(0.28, 0.4)
        a.add(cylinder(radius, stem + 0.1), trunk)
        rise = 0.9 / tiers
        for k in range(tiers):
            reach = size * (1 - 0.75 * k / tiers)
            segments = a.choose([20, 20, 7])
            cone = revolve([(0, 0.06), (reach, 0), (0.0, rise * 1.5)], segments)
            a.add(cone, crown, (0, 0, stem + k * rise * 0.75))
        nouns = ("tree", "pine tree", "fir tree", "christmas tree")
    elif kind == "palm":
        path = smooth_profile([(0, 0, 0), (0.06, 0, 0.4), (a.uniform(0.1, 0.25), 0, 0.9)], 10)
        a.add(tube(path, np.linspace(0.06, 0.04, 10)), trunk)
        frond = leaf(a.uniform(0.4, 0.55), 0.16, a.uniform(0.6, 1.0))
        for k in range(a.integer(6, 9)):
            a.add(frond, crown, tuple(path[-1].tolist()), turn_about("z", 43.0 * k))
        nouns = ("palm tree", "tree", "palm")
    else:
        a.add(rod((0, 0, 0), (0, 0, stem + 0.2), radius, 0.7 * radius), trunk)
        if kind == "low-poly":
            knots = [(0, 0), (0.3, 0.12), (0.34, 0.35), (0.2, 0.62), (0, 0.72)]
            a.add(revolve(knots, a.integer(5, 8)), crown, (0, 0, stem))
        elif kind == "round":
            rx, rz = a.uniform(0.25, 0.4), a.uniform(0.25, 0.5)
            a.add(ellipsoid((rx, rx, rz)), crown, (0, 0, stem + 0.8 * rz))
        else:
            for k in range(a.integer(3, 7)):
                r = a.uniform(0.14, 0.24)
                angle = 2.4 * k
                at = (0.17 * math.cos(angle), 0.17 * math.sin(angle), stem + a.uniform(0.1, 0.5))
                a.add(ellipsoid((r, r, r), rows=8, segments=12), crown, at)
        nouns = ("tree", "tree", "low-poly tree" if kind == "low-poly" else "toy tree")
        if a.chance(0.2):
            fruit = a.look(colors=("red", "orange", "yellow"), avoid=crown)
            for k in range(8):
                at = (0.3 * math.cos(2.4 * k), 0.3 * math.sin(2.4 * k), stem + 0.15 + 0.06 * k)
                a.add(ellipsoid((0.04, 0.04, 0.04), rows=6, segments=8), fruit, at)
    return Description(nouns, crown, (detail(trunk, "trunk"), "a brown trunk"))


def plant(a: Assembly) -> Description:
    """A potted plant with leaves."""
    pot_look, z = plant_pot(a)
    look = a.look("leafy")
    kind = a.choose(["leaves", "bush", "spikes"])
    if kind == "bush":
        for _ in range(a.integer(3, 9)):
            r = a.uniform(0.1, 0.2)
            at = (a.uniform(-0.18, 0.18), a.uniform(-0.18, 0.18), z + a.uniform(0.1, 0.5))
            a.add(ellipsoid((r, r, r), rows=8, segments=12), look, at)
    else:
        count = a.integer(6, 14)
        for k in range(count):
            length = a.uniform(0.3, 0.65)
            lean = a.uniform(20, 75) if kind == "leaves" else a.uniform(50, 88)
            width = a.uniform(0.12, 0.25) if kind == "leaves" else 0.07
            part = leaf(length, width, a.uniform(0.2, 0.9) if kind == "leaves" else 0.1)
            turn = turn_about("z", 137.5 * k) @ turn_about("y", -lean + 20)
            a.add(part, look, (0, 0, z), turn)
    return Description(
        ("plant", "potted plant", "plant"), look, (f"a {pot_look.color} pot", "green leaves")
    )


def flower(a: Assembly) -> Description:
    """A single flower or a flower in a pot."""
    petal = a.look(colors=PETALS)
    heart = a.look(colors=("yellow", "brown", "dark brown", "orange", "white"), avoid=petal)
    stem = a.look("leafy")
    base = plant_pot(a)[1] if a.chance(0.35) else 0.0
    height, count = base + a.uniform(0.5, 0.8), a.integer(5, 14)
    path = smooth_profile(
        [(0, 0, base), (a.uniform(-0.08, 0.08), 0, 0.5 * height), (0, 0, height)], 9
    )
    a.add(tube(path, 0.022), stem)
    face = turn_about("y", a.choose([0.0, a.uniform(20, 90)]))
    reach, width = a.uniform(0.16, 0.3), a.uniform(0.07, 0.16)
    tip = np.array([0, 0, height], np.float32)
    if a.chance(0.2):
        bud = revolve(
            shell_profile([(0.03, 0), (0.14, 0.1), (0.12, 0.25), (0.15, 0.3)], 0.02),
            24,
            lobes=6,
            lobe_depth=0.15,
        )
        a.add(bud, petal, (0, 0, height - 0.03))
        nouns = ("tulip", "flower", "rose")
    else:
        core = a.uniform(0.05, 0.14)
        for k in range(count):
            turn = face @ turn_about("z", 360.0 * k / count)
            part = ellipsoid((0.5 * reach, 0.5 * width, 0.02), rows=8, segments=12)
            part = part.moved(turn_about("y", -12), (core + 0.4 * reach, 0, 0.03))
            a.add(part, petal, tip, turn)
        a.add(ellipsoid((core, core, 0.05)), heart, tip, face)
        sunny = petal.color == "yellow" and "brown" in heart.color
        nouns = ("sunflower", "flower") if sunny else ("flower", "daisy", "flower")
    for k in range(a.integer(1, 3)):
        at = (0, 0, base + a.uniform(0.1, 0.6) * (height - base))
        a.add(leaf(0.25, 0.1, 0.4), stem, at, turn_about("z", 150.0 * k))
    return Description(nouns, petal, ("a green stem", f"{petal.color} petals", "leaves"))


def cactus(a: Assembly) -> Description:
    """A cactus, with arms or round, often in a pot."""
    look = a.look("leafy", colors=("green", "dark green", "light green"))
    details = []
    z = 0.0
    if a.chance(0.75):
        pot_look, z = plant_pot(a)
        details.append(f"a {pot_look.color} pot")
    if a.chance(0.35):
        r = a.uniform(0.2, 0.3)
        knots = [(0.05, 0), (0.85 * r, 0.35 * r), (r, 0.9 * r), (0.7 * r, 1.55 * r), (0, 1.8 * r)]
        line = smooth_profile(knots, 14).clip(0)
        a.add(revolve(line, 48, lobes=a.integer(8, 14), lobe_depth=0.12), look, (0, 0, z - 0.02))
        top = z + 1.9 * r
    else:
        r, height = a.uniform(0.08, 0.13), a.uniform(0.5, 0.8)
        body = revolve(
            [(r, 0), (r, height - r), (0.75 * r, height - 0.3 * r), (0, height)],
            32,
            lobes=8,
            lobe_depth=0.1,
        )
        a.add(body, look, (0, 0, z))
        for side in (-1.0, 1.0)[: a.integer(1, 2)]:
            low, high = z + a.uniform(0.2, 0.35), z + a.uniform(0.5, 0.7)
            path = smooth_profile(
                [(0, 0, low), (side * 0.2, 0, low + 0.02), (side * 0.22, 0, high)], 9
            )
            a.add(tube(path, 0.06), look)
            a.add(ellipsoid((0.06, 0.06, 0.06)), look, (side * 0.22, 0, high))
        top = z + height
    if a.chance(0.4):
        bloom = a.look(colors=("pink", "red", "yellow", "white"))
        a.add(ellipsoid((0.06, 0.06, 0.05)), bloom, (0, 0, top))
        details.append(f"a {bloom.color} flower")
    return Description(("cactus", "cactus", "succulent"), look, tuple(details))


def mushroom(a: Assembly) -> Description:
    """A mushroom with a spotted or plain cap."""
    cap = a.look(
        colors=("red", "brown", "orange", "light brown", "white", "purple", "beige", "yellow")
    )
    stem = a.look(colors=("white", "cream", "beige"))
    height, r = a.uniform(0.35, 0.7), a.uniform(0.3, 0.5)
    line = smooth_profile([(0.16, 0), (0.1, 0.5 * height), (0.09, height)], 8)
    a.add(revolve(np.concatenate([[(0, 0)], line]), 20), stem)
    rise = a.uniform(0.2, 0.45)
    dome = smooth_profile([(0.08, 0.0), (r, 0.0), (0.85 * r, 0.55 * rise), (0, rise)], 14).clip(0)
    details = ["a white stem"]
    if a.chance(0.6):
        spots = []
        tone = a.look(colors=("white", "cream", "yellow"), avoid=cap).material.color
        for k in range(10):
            share = 0.1 + 0.8 * ((k * 0.618) % 1.0)
            at = 0.95 * r * math.sqrt(1 - share)
            angle = 2.4 * k
            center = (at * math.cos(angle), at * math.sin(angle), height + rise * share)
            spots.append(Mark(center, (0, 0, 1), (a.uniform(0.04, 0.08),) * 2, tone, "ball"))
        cap = cap.marked(*spots)
        details.append("white spots")
    a.add(revolve(dome, 28), cap, (0, 0, height - 0.05))
    return Description(("mushroom", "mushroom", "toadstool"), cap, tuple(details))


def fruit(a: Assembly) -> Description:
    """One fruit or vegetable: apple, pear, orange, banana, pepper, pumpkin, carrot and so on."""
    kind = a.choose(
        [
            "apple",
            "pear",
            "orange",
            "banana",
            "pepper",
            "pumpkin",
            "carrot",
            "strawberry",
            "eggplant",
            "watermelon",
        ]
    )
    stem = a.look("leafy", colors=("green", "dark green", "brown"))
    colors = {
        "apple": ("red", "green", "yellow", "dark red"),
        "pear": ("green", "yellow", "light green"),
        "orange": ("orange",),
        "banana": ("yellow",),
        "pepper": ("red", "green", "yellow", "orange"),
        "pumpkin": ("orange",),
        "carrot": ("orange",),
        "strawberry": ("red",),
        "eggplant": ("purple", "dark blue"),
        "watermelon": ("green", "dark green"),
    }[kind]
    look = a.look(colors=colors, patterns=("gradient", "speckles"), pattern_chance=0.0)
    profiles = {
        "apple": [(0, 0.06), (0.2, 0.02), (0.48, 0.42), (0.3, 0.82), (0.08, 0.78), (0, 0.7)],
        "pear": [(0, 0), (0.35, 0.08), (0.42, 0.4), (0.2, 0.8), (0.1, 1.0), (0, 1.02)],
        "orange": [(0, 0), (0.4, 0.18), (0.48, 0.48), (0.4, 0.78), (0, 0.94)],
        "pepper": [(0, 0.06), (0.25, 0.0), (0.36, 0.3), (0.42, 0.7), (0.28, 0.88), (0, 0.78)],
        "pumpkin": [(0, 0.08), (0.3, 0.0), (0.55, 0.36), (0.35, 0.7), (0, 0.6)],
        "carrot": [(0, 0), (0.06, 0.15), (0.14, 0.7), (0.16, 0.95), (0, 1.02)],
        "strawberry": [(0, 0), (0.22, 0.22), (0.36, 0.6), (0.25, 0.8), (0, 0.78)],
        "eggplant": [(0, 0), (0.28, 0.1), (0.3, 0.4), (0.17, 0.8), (0.1, 1.0), (0, 1.02)],
        "watermelon": [(0, 0), (0.38, 0.12), (0.5, 0.5), (0.38, 0.88), (0, 1.0)],
    }
    if kind == "banana":
        path = smooth_profile(
            [(-0.45, 0, 0.25), (-0.2, 0, 0.02), (0.2, 0, 0.02), (0.5, 0, 0.3)], 14
        )
        radii = np.interp(
            np.linspace(0, 1, 14), [0, 0.12, 0.5, 0.88, 1], [0.02, 0.08, 0.11, 0.08, 0.03]
        )
        for k in range(a.choose([1, 1, 3])):
            a.add(tube(path, radii, sides=6), look, (0, 0.19 * k, 0))
        a.add(
            ellipsoid((0.035, 0.035, 0.05)), a.look(colors=("dark brown", "olive")), (0.5, 0, 0.32)
        )
        return Description(("banana", "fruit"), look)
    line = smooth_profile(profiles[kind], 18).clip(0)
    lobes, depth = {"pepper": (4, 0.14), "pumpkin": (a.integer(8, 12), 0.14)}.get(kind, (0, 0.0))
    if kind == "watermelon":
        material = type(look.material)(
            look.material.color, (look.material.color * 0.45), "stripes", 4.0
        )
        look = Look(material, look.color, look.substance)
    if kind == "strawberry":
        material = type(look.material)(
            look.material.color, np.array([0.95, 0.85, 0.4], np.float32), "dots", 12.0, 0.2
        )
        look = Look(material, look.color, look.substance)
    a.add(revolve(line, 48 if lobes else 24, lobes=lobes, lobe_depth=depth), look)
    top = float(line[-1, 1])
    if kind in ("carrot", "strawberry"):
        for k in range(6):
            a.add(
                leaf(0.26, 0.1, 0.3),
                stem,
                (0, 0, top - 0.02),
                turn_about("z", 60.0 * k) @ turn_about("y", -55.0 if kind == "carrot" else 0),
            )
    elif kind not in ("watermelon",):
        r = 0.05 if kind in ("pepper", "pumpkin", "eggplant") else 0.02
        a.add(rod((0, 0, top - 0.04), (a.uniform(-0.05, 0.05), 0, top + 0.16), r, 0.8 * r), stem)
        if kind == "eggplant":
            a.add(cylinder(0.14, 0.06, 0.05), stem, (0, 0, top - 0.08))
        if kind in ("apple", "pear", "orange") and a.chance(0.6):
            a.add(leaf(0.2, 0.1, 0.5), stem, (0, 0, top + 0.08))
    nouns = {
        "pepper": ("bell pepper", "pepper", "vegetable"),
        "pumpkin": ("pumpkin",),
        "carrot": ("carrot", "vegetable"),
        "eggplant": ("eggplant", "vegetable"),
    }.get(kind, (kind, kind, "fruit"))
    return Description(
        nouns, look, ("a stem", "a green stem" if "green" in stem.color else "a stem")
    )


def snowman(a: Assembly) -> Description:
    """A snowman with a carrot nose, buttons, and perhaps hat and scarf."""
    look = a.look(colors=("white",))
    dark = a.look(colors=("black", "dark grey"))
    orange = a.look(colors=("orange",))
    r, z = a.uniform(0.28, 0.36), 0.0
    shrink = a.uniform(0.68, 0.82)
    balls = a.integer(2, 3)
    for _ in range(balls):
        z += r * 0.85
        a.add(ellipsoid((r, r, r)), look, (0, 0, z))
        top, size = z, r
        z += 0.7 * r
        r *= shrink
    a.add(rod((0.9 * size, 0, top), (1.9 * size, 0, top - 0.02), 0.045, 0.005), orange)
    a.add_mirrored(
        ellipsoid((0.03, 0.03, 0.03), rows=6, segments=8),
        dark,
        (0.87 * size, 0.35 * size, top + 0.3 * size),
    )
    for k in range(3):
        a.add(
            ellipsoid((0.03, 0.03, 0.03), rows=6, segments=8),
            dark,
            (size / shrink * 0.98, 0, top - size * 1.1 - 0.1 * k),
        )
    details = ["a carrot nose", "buttons"]
    if a.chance(0.7):
        hat = a.look("fabric", colors=("black", "red", "blue", "green", "dark grey"))
        a.add(cylinder(size * 1.05, 0.03), hat, (0, 0, top + 0.75 * size))
        a.add(cylinder(size * 0.65, 0.24), hat, (0, 0, top + 0.77 * size))
        details.append(detail(hat, "hat"))
    if a.chance(0.6):
        scarf = a.look("fabric", colors=("red", "blue", "green", "yellow", "purple"))
        a.add(torus(size * 0.85, 0.06), scarf, (0, 0, top - 0.75 * size))
        a.add(box((0.04, 0.09, 0.25)), scarf, (size * 0.95, 0.1, top - 0.75 * size - 0.25))
        details.append(detail(scarf, "scarf"))
    if a.chance(0.6):
        arm = a.look("wooden", colors=("brown", "dark brown"))
        a.add_mirrored(
            rod((0, size, top - size), (0, size + 0.4, top - 0.5 * size), 0.018), arm, (0, 0, 0)
        )
    return Description(("snowman",), look, tuple(details))


def gem(a: Assembly) -> Description:
    """A star, a heart or a crystal."""
    look = a.look("glass", "plastic", "metal", "golden")
    kind = a.choose(["star", "crystal", "heart"])
    if kind == "star":
        outline = regular_polygon(a.integer(5, 8), 0.5, star=a.uniform(0.4, 0.6))
        a.add(
            prism(outline, a.uniform(0.1, 0.25)),
            look,
            (0, 0, 0.5),
            turn_about("y", 90) @ turn_about("z", 180),
        )
        return Description(("star", "star"), look)
    if kind == "heart":
        t = np.linspace(0, 2 * math.pi, 28, endpoint=False)
        x = 16 * np.sin(t) ** 3
        y = 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t)
        outline = np.stack([x, y], axis=1)[::-1] / 34
        turn = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], np.float32)
        a.add(prism(outline, 0.12, top_scale=0.75), look, (0, 0, 0.5), turn)
        turned = np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]], np.float32)
        a.add(prism(outline, 0.12, top_scale=0.75), look, (0, 0, 0.5), turned)
        return Description(("heart",), look)
    sides, r = a.integer(5, 8), a.uniform(0.15, 0.3)
    for k in range(a.choose([1, 1, 4])):
        line = [(0, 0), (r, 0.15 * a.uniform(0, 2)), (r * 0.9, 0.7), (0, 1.0)]
        turn = turn_about("z", 100.0 * k) @ turn_about("x", 28.0 if k else 0.0)
        a.add(revolve(np.array(line) * (0.65 if k else 1.0), sides), look, turn=turn)
    return Description(("crystal", "gem", "diamond"), look)


FAMILIES = (tree, plant, flower, cactus, mushroom, fruit, snowman, gem)
