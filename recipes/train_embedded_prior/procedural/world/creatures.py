"""Creature families: plush animals, four-legged ones, birds and fish, from ellipsoids and tubes."""

from __future__ import annotations

import math

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    Assembly,
    Description,
    Look,
)
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.materials import Material
from recipes.train_embedded_prior.procedural.palette import sample_color
from recipes.train_embedded_prior.procedural.primitives import cylinder, ellipsoid, prism
from recipes.train_embedded_prior.procedural.quads import Quads, turn_about
from recipes.train_embedded_prior.procedural.sweeps import revolve, rod, smooth_profile, tube

FUR = ("brown", "light brown", "dark brown", "white", "black", "grey", "beige", "orange", "cream")
SKIN = ("beige", "light brown", "brown", "cream", "dark brown")


def ball(radius: float) -> Quads:
    """Return a small round part."""
    return ellipsoid((radius, radius, radius), rows=8, segments=12)


def eyes(a: Assembly, x: float, y: float, z: float, size: float) -> None:
    """Add a pair of eyes, dark or white with a pupil."""
    dark = a.look(colors=("black",))
    if a.chance(0.3):
        a.add_mirrored(ball(size * 1.5), a.look(colors=("white",)), (x - 0.3 * size, y, z))
    a.add_mirrored(ball(size), dark, (x + 0.5 * size, y, z))


def spotted(a: Assembly, look: Look, accent: str) -> Look:
    """Return a look with irregular patches of a named colour."""
    color = sample_color(accent, a.rng)
    pattern = Material(
        look.material.color,
        color,
        "patches",
        a.uniform(6, 10),
        a.uniform(0.4, 0.6),
        a.uniform(0, 6),
    )
    return Look(pattern, look.color, look.substance, accent)


def teddy(a: Assembly) -> Description:
    """A sitting or standing plush animal: bear, rabbit, panda, mouse."""
    look = a.look("plush")
    pale = a.look("plush", colors=("cream", "beige", "white", "pink"), avoid=look)
    kind = a.choose(["bear", "bear", "rabbit", "mouse"])
    belly, head = a.uniform(0.22, 0.3), a.uniform(0.2, 0.26)
    z = 0.32
    a.add(ellipsoid((belly * 0.9, belly, belly * 1.15)), look, (0, 0, z))
    if a.chance(0.5):
        a.add(ellipsoid((belly * 0.4, belly * 0.65, belly * 0.75)), pale, (0.6 * belly, 0, z))
    top = z + belly * 1.0 + 0.75 * head
    a.add(ellipsoid((head, head * 1.05, head * 0.95)), look, (0, 0, top))
    a.add(ellipsoid((0.1, 0.11, 0.08)), pale, (0.85 * head, 0, top - 0.25 * head))
    a.add(
        ball(0.035),
        a.look(colors=("black", "dark brown", "pink")),
        (0.85 * head + 0.1, 0, top - 0.15 * head),
    )
    eyes(a, 0.85 * head, 0.4 * head, top + 0.2 * head, 0.026)
    if kind == "rabbit":
        ear = ellipsoid((0.035, 0.07, a.uniform(0.16, 0.26)))
        a.add_mirrored(ear, look, (0, 0.1, top + 1.5 * head), turn_about("x", a.uniform(-25, 0)))
    else:
        size = 0.17 if kind == "mouse" else a.uniform(0.08, 0.11)
        a.add_mirrored(ellipsoid((0.05, size, size)), look, (0, 0.8 * head, top + 0.75 * head))
        a.add_mirrored(
            ellipsoid((0.03, 0.65 * size, 0.65 * size)), pale, (0.04, 0.8 * head, top + 0.75 * head)
        )
    reach = a.uniform(-40, 60)
    arm = ellipsoid((0.09, 0.09, 0.2)).moved(
        turn_about("x", 35) @ turn_about("y", -reach), (0, 0, 0)
    )
    a.add_mirrored(arm, look, (0.06, belly + 0.07, z + 0.14))
    if a.chance(0.65):
        a.add_mirrored(ellipsoid((0.2, 0.1, 0.1)), look, (0.22, 0.17, 0.1))
        a.add_mirrored(ellipsoid((0.03, 0.07, 0.08)), pale, (0.41, 0.17, 0.11))
    else:
        a.add_mirrored(ellipsoid((0.1, 0.1, 0.2)), look, (0, 0.14, 0.0))
    details = []
    if a.chance(0.35):
        bow = a.look("fabric", avoid=look)
        a.add_mirrored(ellipsoid((0.04, 0.08, 0.05)), bow, (0.2, 0.08, z + belly))
        a.add(ball(0.035), bow, (0.22, 0, z + belly))
        details.append(detail(bow, "ribbon"))
    nouns = {
        "bear": ("teddy bear", "bear", "toy bear"),
        "rabbit": ("rabbit", "bunny", "toy rabbit"),
        "mouse": ("mouse", "toy mouse"),
    }[kind]
    return Description(nouns, look, (*details, "two ears"))


QUADRUPEDS = {
    # name: body length, body radius, leg length, neck length, neck angle, head size, snout
    "dog": (0.5, 0.14, 0.3, 0.16, 45, 0.13, 0.12),
    "cat": (0.46, 0.12, 0.25, 0.1, 50, 0.12, 0.04),
    "cow": (0.6, 0.2, 0.3, 0.16, 30, 0.14, 0.13),
    "horse": (0.58, 0.16, 0.45, 0.34, 55, 0.12, 0.18),
    "pig": (0.52, 0.2, 0.16, 0.05, 20, 0.16, 0.09),
    "sheep": (0.46, 0.2, 0.22, 0.1, 40, 0.12, 0.09),
    "elephant": (0.6, 0.25, 0.3, 0.08, 30, 0.2, 0.0),
    "giraffe": (0.45, 0.15, 0.5, 0.65, 70, 0.1, 0.12),
    "lion": (0.55, 0.16, 0.28, 0.12, 45, 0.14, 0.1),
    "tiger": (0.56, 0.15, 0.28, 0.12, 40, 0.13, 0.09),
    "goat": (0.46, 0.14, 0.3, 0.18, 50, 0.1, 0.1),
    "fox": (0.45, 0.11, 0.24, 0.12, 40, 0.11, 0.14),
    "dinosaur": (0.6, 0.2, 0.26, 0.5, 50, 0.12, 0.1),
}
COATS: dict[str, tuple[str, ...]] = {
    "pig": ("pink", "beige"),
    "elephant": ("grey", "light grey", "dark grey", "light blue"),
    "giraffe": ("yellow", "beige", "orange"),
    "lion": ("golden", "light brown", "orange", "yellow"),
    "tiger": ("orange",),
    "fox": ("orange", "brown"),
    "sheep": ("white", "cream", "black"),
    "cow": ("white", "brown", "black", "white"),
    "dinosaur": ("green", "dark green", "olive", "purple", "blue", "brown"),
}


def quadruped(a: Assembly) -> Description:
    """A four-legged animal, as a toy or a statue."""
    name = a.choose(list(QUADRUPEDS))
    length, radius, leg, neck, angle, head, snout = (
        value * a.uniform(0.88, 1.12) for value in QUADRUPEDS[name]
    )
    statue = a.chance(0.15)
    look = (
        a.look("stone", "metal", "wooden")
        if statue
        else a.look("plush", "plastic", "plain", colors=COATS.get(name, FUR))
    )
    details: list[str] = []
    marks = {
        "cow": ("black", "brown", "dark brown"),
        "giraffe": ("brown",),
        "dog": ("brown", "black"),
    }
    if not statue and name in marks and a.chance(0.75):
        accent = a.choose([c for c in marks[name] if c != look.color] or ["white"])
        look = spotted(a, look, accent)
    elif not statue and name == "tiger":
        black = Material(look.material.color, sample_color("black", a.rng), "stripes", 12.0, 0.3)
        look = Look(black, look.color, look.substance, "black")
    other = look if statue else a.look("plush", avoid=look)
    z = leg + 0.75 * radius
    half = 0.5 * length
    a.add(ellipsoid((half * 1.05, radius, radius), roundness=(1, 0.85)), look, (0, 0, z))
    thick = radius * a.uniform(0.28, 0.42) * (1.3 if name == "elephant" else 1.0)
    for x in (0.66 * half, -0.66 * half):
        a.add_mirrored(
            rod((x, 0.55 * radius, 0), (x, 0.5 * radius, z), thick * 0.85, thick), look, (0, 0, 0)
        )
    rad = math.radians(angle)
    start = np.array([0.8 * half, 0, z + 0.3 * radius])
    tip = start + neck * np.array([math.cos(rad), 0, math.sin(rad)])
    if neck > 0.05:
        a.add(
            rod(
                start - 0.1 * np.array([math.cos(rad), 0, math.sin(rad)]),
                tip,
                radius * 0.62,
                head * 0.75,
                10,
            ),
            look,
        )
    center = tip + np.array([0.45 * head, 0, 0.35 * head])
    a.add(ellipsoid((head * 1.05, head * 0.85, head * 0.9)), look, tuple(center))
    if snout > 0.02:
        at = center + np.array([head * 0.75, 0, -0.3 * head])
        nose = other if name in ("pig", "cow", "dog") and a.chance(0.4) else look
        a.add(ellipsoid((snout, 0.55 * head, 0.48 * head)), nose, tuple(at))
        a.add(
            ball(0.026),
            a.look(colors=("black", "pink", "dark brown")),
            (at[0] + snout, 0, at[2] + 0.1 * head),
        )
    eyes(a, center[0] + 0.72 * head, 0.5 * head, center[2] + 0.35 * head, 0.022)
    _head_gear(a, name, look, other, center, head, details)
    back = (-1.0 * half, 0, z + 0.4 * radius)
    rise = a.uniform(-0.25, 0.25)
    if name == "dinosaur":
        tail = smooth_profile(
            [(-0.7 * half, 0, z), (-1.6 * half, 0, z - 0.1), (-2.4 * half, 0, 0.08)], 8
        )
        a.add(tube(tail, np.linspace(radius * 0.8, 0.02, 8)), look)
    else:
        long = {"cat": 0.35, "tiger": 0.35, "lion": 0.35, "horse": 0.3, "fox": 0.3}.get(name, 0.16)
        path = smooth_profile(
            [
                back,
                (-half - 0.5 * long, 0, z + 0.4 * radius + rise),
                (-half - long, 0, z + 0.3 * radius + 1.4 * rise),
            ],
            7,
        )
        a.add(tube(path, np.linspace(0.03, 0.055 if name in ("fox", "horse") else 0.02, 7)), look)
    nouns: tuple[str, ...] = (name, name, f"toy {name}", "animal")
    if statue:
        nouns = (f"{name} statue", f"statue of a {name}", f"{name} figurine")
    return Description(nouns, look, (*details, "a tail"))


def _head_gear(
    a: Assembly,
    name: str,
    look: Look,
    other: Look,
    center: np.ndarray,
    head: float,
    details: list[str],
) -> None:
    """Add ears, horns, manes and trunks."""
    top = (center[0] - 0.2 * head, 0.5 * head, center[2] + 0.8 * head)
    pale = a.look(colors=("cream", "white", "beige"))
    if name in ("cat", "fox", "tiger"):
        a.add_mirrored(revolve([(0.5 * head, 0), (0, 0.75 * head)], 8), look, top)
        details.append("pointed ears")
    elif name == "elephant":
        a.add_mirrored(
            ellipsoid((0.05, 0.9 * head, 1.0 * head)),
            look,
            (center[0] - 0.3 * head, 1.35 * head, center[2]),
            turn_about("z", -30),
        )
        x, z = center[0] + 0.8 * head, center[2] - 0.1 * head
        trunk = smooth_profile(
            [(x, 0, z), (x + 0.14, 0, z - 0.2), (x + a.uniform(0.1, 0.35), 0, z - 0.42)], 9
        )
        a.add(tube(trunk, np.linspace(0.085, 0.04, 9)), look)
        a.add_mirrored(
            rod((x, 0.1, z - 0.08), (x + 0.16, 0.12, z - 0.14), 0.024, 0.01), pale, (0, 0, 0)
        )
        details.append("a long trunk")
    elif name != "dinosaur":
        droop = a.uniform(-40, 70) if name == "dog" else 70
        ear = ellipsoid((0.035, 0.25 * head, 0.55 * head)).moved(turn_about("x", -droop), (0, 0, 0))
        a.add_mirrored(
            ear, other if name == "dog" else look, (top[0], 0.85 * head, top[2] - 0.3 * head)
        )
    if name in ("cow", "goat", "giraffe"):
        size = 0.3 if name == "goat" else 0.14
        a.add_mirrored(
            rod(
                (top[0], 0.35 * head, top[2]),
                (top[0] - 0.3 * size, 0.35 * head + 0.3 * size, top[2] + size),
                0.025,
                0.012,
            ),
            pale,
            (0, 0, 0),
        )
        details.append("horns")
    if name == "lion":
        a.add(
            ellipsoid((0.6 * head, 1.5 * head, 1.5 * head)),
            other,
            (center[0] - 0.5 * head, 0, center[2]),
        )
        details.append(detail(other, "mane"))
    if name == "horse":
        for k in range(5):
            a.add(ball(0.06), other, (top[0] - 0.06 * k - 0.04, 0, top[2] - 0.09 * k + 0.02))
        details.append(detail(other, "mane"))


def duck(a: Assembly) -> Description:
    """A duck, chick, swan, penguin or another bird."""
    kind = a.choose(["duck", "duck", "bird", "penguin", "owl", "chick", "swan"])
    colors = {
        "duck": ("yellow", "yellow", "white", "brown", "green"),
        "chick": ("yellow",),
        "swan": ("white", "black"),
        "penguin": ("black", "dark blue", "grey"),
    }.get(kind)
    look = a.look(
        "rubber",
        "plastic",
        "plush",
        colors=colors or ("blue", "red", "brown", "green", "yellow", "grey", "white", "light blue"),
    )
    beak = a.look("plastic", colors=("orange", "red", "yellow", "dark grey"), avoid=look)
    pale = a.look(colors=("white", "cream"), avoid=look)
    details = [detail(beak, "beak")]
    if kind in ("penguin", "owl"):
        a.add(ellipsoid((0.26, 0.28, 0.4)), look, (0, 0, 0.4))
        a.add(ellipsoid((0.16, 0.22, 0.32)), pale, (0.13, 0, 0.36))
        x, z, r = 0.0, 0.78, 0.2
        a.add(ellipsoid((r, r * 1.05, r)), look, (x, 0, z))
        a.add_mirrored(ellipsoid((0.12, 0.05, 0.27)), look, (0, 0.29, 0.42), turn_about("x", 12))
        a.add_mirrored(ellipsoid((0.11, 0.08, 0.03)), beak, (0.12, 0.12, 0.03))
        if kind == "owl":
            a.add_mirrored(ellipsoid((0.04, 0.09, 0.09)), pale, (0.17, 0.09, z + 0.04))
            a.add_mirrored(revolve([(0.06, 0), (0, 0.14)], 8), look, (0, 0.12, z + 0.14))
    else:
        a.add(ellipsoid((0.36, 0.25, 0.22)), look, (0, 0, 0.22), turn_about("y", -8))
        a.add(revolve([(0.14, 0), (0, 0.3)], 12), look, (-0.2, 0, 0.26), turn_about("y", -62))
        x, z, r = 0.22, a.uniform(0.5, 0.6), a.uniform(0.15, 0.19)
        if kind == "swan":
            path = smooth_profile(
                [(0.28, 0, 0.25), (0.4, 0, 0.5), (0.26, 0, 0.75), (0.36, 0, 0.85)], 12
            )
            a.add(tube(path, np.linspace(0.09, 0.06, 12)), look)
            x, z, r = 0.38, 0.85, 0.09
        a.add(ellipsoid((r, r, r)), look, (x, 0, z))
        a.add_mirrored(ellipsoid((0.22, 0.05, 0.12)), look, (-0.06, 0.24, 0.27))
        if kind in ("bird", "chick"):
            a.add_mirrored(rod((0, 0.08, 0.06), (0.02, 0.1, -0.16), 0.018), beak, (0, 0, 0))
            a.add_mirrored(ellipsoid((0.09, 0.05, 0.012)), beak, (0.05, 0.1, -0.16))
    if kind in ("duck", "swan"):
        a.add(ellipsoid((0.12, 0.09, 0.03)), beak, (x + r + 0.04, 0, z - 0.03))
    else:
        a.add(rod((x + 0.8 * r, 0, z), (x + r + 0.12, 0, z - 0.02), 0.05, 0.005), beak)
    eyes(a, x + 0.78 * r, 0.5 * r, z + 0.3 * r, 0.024)
    nouns = {
        "duck": ("duck", "rubber duck", "toy duck"),
        "bird": ("bird", "bird"),
        "chick": ("chick", "bird"),
        "owl": ("owl", "bird"),
        "swan": ("swan", "bird"),
        "penguin": ("penguin", "toy penguin"),
    }[kind]
    return Description(nouns, look, tuple(details))


def fish(a: Assembly) -> Description:
    """A fish, whale or shark, and a turtle."""
    look = a.look(
        "plastic",
        "plush",
        "rubber",
        "glass",
        patterns=("stripes", "bands", "dots", "gradient"),
        pattern_chance=0.4,
    )
    fin = look if a.chance(0.4) else a.look("plastic", avoid=look)
    if a.chance(0.3):
        shell = a.look(
            colors=("green", "brown", "dark green", "olive", "light brown"),
            avoid=look,
            patterns=("patches",),
            pattern_chance=0.5,
        )
        skin = a.look(colors=("green", "light green", "olive", "beige"), avoid=shell)
        a.add(
            revolve(smooth_profile([(0.42, 0), (0.36, 0.2), (0, 0.34)], 9).clip(0), 24),
            shell,
            (0, 0, 0.1),
        )
        a.add(cylinder(0.4, 0.08), skin, (0, 0, 0.06))
        a.add(ellipsoid((0.14, 0.11, 0.11)), skin, (0.5, 0, 0.22))
        eyes(a, 0.6, 0.05, 0.26, 0.02)
        for x in (0.28, -0.28):
            a.add_mirrored(
                ellipsoid((0.14, 0.09, 0.06)), skin, (x, 0.34, 0.07), turn_about("z", 35)
            )
        return Description(("turtle", "tortoise", "toy turtle"), shell, (detail(skin, "head"),))
    big = a.chance(0.35)
    tall, wide = (0.22, 0.22) if big else (a.uniform(0.16, 0.3), a.uniform(0.08, 0.14))
    a.add(ellipsoid((0.42, wide, tall)), look, (0, 0, tall))
    tail = prism([(0.0, -0.04), (-0.25, -0.2), (-0.18, 0.0), (-0.25, 0.2), (0.0, 0.04)], 0.04)
    flat = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], np.float32)
    if big:
        a.add(tail, fin, (-0.36, 0, tall))
    else:
        a.add(tail, fin, (-0.36, 0.02, tall), flat)
    dorsal = prism([(-0.12, 0), (0.14, 0), (-0.12, 0.18)], 0.03)
    a.add(dorsal, fin, (0, 0.015, 1.85 * tall), flat)
    a.add_mirrored(
        ellipsoid((0.1, 0.12, 0.015)), fin, (0.1, wide + 0.06, 0.8 * tall), turn_about("x", 30)
    )
    eyes(a, 0.28, wide * 0.72, tall * 1.2, 0.025)
    nouns = ("whale", "shark", "dolphin") if big else ("fish", "fish", "toy fish")
    return Description(nouns, look, (detail(fin, "fins", plural=True), "fins"))


FAMILIES = (
    teddy,
    quadruped,
    duck,
    fish,
)
