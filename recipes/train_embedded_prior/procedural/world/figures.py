"""Figure families: people, statues and robots."""

from __future__ import annotations

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    DECORATIONS,
    Assembly,
    Description,
)
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.primitives import box, cylinder, ellipsoid
from recipes.train_embedded_prior.procedural.quads import turn_about
from recipes.train_embedded_prior.procedural.sweeps import revolve, rod, smooth_profile, tube
from recipes.train_embedded_prior.procedural.world.creatures import SKIN, ball, eyes


def person(a: Assembly) -> Description:
    """A standing figure: person, knight, soldier, doll; or a stone statue."""
    statue = a.chance(0.25)
    stone = a.look("stone", "metal", "marble", "wooden")
    skin = stone if statue else a.look(colors=SKIN)
    shirt = (
        stone if statue else a.look("fabric", "plastic", patterns=DECORATIONS, pattern_chance=0.15)
    )
    trousers = stone if statue else a.look("fabric", "plastic", avoid=shirt)
    hair = (
        stone
        if statue
        else a.look(colors=("black", "brown", "dark brown", "golden", "orange", "grey"))
    )
    shoes = stone if statue else a.look("leather", colors=("black", "brown", "dark grey", "red"))
    build, leg = a.uniform(0.85, 1.2), a.uniform(0.38, 0.5)
    blocky = a.chance(0.25)
    knight = a.chance(0.2)
    width = 0.13 * build
    if blocky:
        a.add_mirrored(box((0.14, 0.13, leg)), trousers, (0, 0.08, 0))
        a.add(box((0.17, 2.2 * width, 0.32)), shirt, (0, 0, leg))
        arm = box((0.12, 0.1, 0.32)).moved(None, (0, 0, -0.3))
        top = leg + 0.32
        a.add(box((0.22, 0.22, 0.22)), skin, (0, 0, top + 0.02))
    else:
        robe = a.chance(0.2)
        if robe:
            a.add(revolve([(0, 0), (0.24, 0), (0.13, leg + 0.05)], 20), shirt)
        else:
            a.add_mirrored(
                rod((0, 0.09, 0), (0, 0.07, leg + 0.05), 0.055, 0.075), trousers, (0, 0, 0)
            )
        a.add(
            ellipsoid((0.1 * build, 1.15 * width, 0.21), roundness=(0.7, 1)),
            shirt,
            (0, 0, leg + 0.17),
        )
        arm = rod((0, 0, 0), (0, 0, -0.32), 0.05, 0.04)
        top = leg + 0.36
        a.add(rod((0, 0, top - 0.03), (0, 0, top + 0.08), 0.045), skin)
        a.add(ellipsoid((0.1, 0.095, 0.12)), skin, (0, 0, top + 0.16))
    a.add_mirrored(box((0.18, 0.1, 0.05)), shoes, (0.03, 0.09, 0))
    swing, spread = a.uniform(-70, 70) if a.chance(0.4) else 0.0, a.uniform(4, 30)
    shoulder = (0.0, 1.05 * width + 0.04, leg + 0.3)
    turn = turn_about("x", spread) @ turn_about("y", -abs(swing))
    a.add_mirrored(arm, shirt, shoulder, turn)
    hand = np.asarray(shoulder) + turn @ np.array([0, 0, -0.35])
    a.add_mirrored(ball(0.05), skin, tuple(hand.tolist()))
    z = top + (0.13 if blocky else 0.16)
    dark = stone if statue else a.look(colors=("black",))
    a.add_mirrored(ball(0.016), dark, (0.1, 0.04, z + 0.02))
    details = [detail(shirt, "shirt"), f"{trousers.color} legs"] if not statue else []
    if knight:
        metal = (
            stone if statue else a.look("metal", colors=("silver", "grey", "dark grey", "golden"))
        )
        a.add(cylinder(0.125, 0.2, 0.1), metal, (0, 0, z - 0.06))
        sword = rod((0, 0, -0.1), (0, 0, 0.5), 0.018, 0.008)
        a.add(sword, metal, tuple(hand.tolist()), turn_about("y", 50))
        side = hand * np.array([1, -1, 1])
        a.add(
            cylinder(0.17, 0.03),
            shirt if a.chance(0.5) else metal,
            (side[0] + 0.05, side[1], side[2] + 0.1),
            turn_about("y", 90),
        )
        details = ["a sword", "a shield"]
        nouns: tuple[str, ...] = ("knight", "knight figure", "warrior", "toy knight")
    else:
        a.add(ellipsoid((0.11, 0.108, 0.1)), hair, (-0.015, 0, z + 0.06))
        if a.chance(0.3) and not statue:
            hat = a.look("fabric", avoid=shirt)
            a.add(cylinder(0.16, 0.02), hat, (0, 0, z + 0.08))
            a.add(cylinder(0.1, 0.12, 0.08), hat, (0, 0, z + 0.09))
            details.append(detail(hat, "hat"))
        nouns = ("figure", "doll", "toy figure", "character", "figurine")
    if statue:
        nouns = ("statue", "statue of a person", "figure statue", "stone statue")
        a.add(
            box((0.42, 0.5, a.uniform(0.08, 0.3))).moved(None, (0, 0, -0.08)), stone, (0, 0, -0.1)
        )
        details = ["a base"]
    return Description(nouns, stone if statue else shirt, tuple(details))


def bust(a: Assembly) -> Description:
    """A bust or a seated statue on a plinth; also a sitting cat."""
    look = a.look(
        "stone",
        "stone",
        "marble",
        "metal",
        "clay",
        "golden",
        "wooden",
        colors=None if a.chance(0.8) else ("black", "white", "grey"),
    )
    kind = a.choose(["bust", "cat", "seated"])
    if kind == "bust":
        a.add(
            revolve([(0, 0), (0.2, 0), (0.17, 0.06), (0.09, 0.12), (0.12, 0.24), (0, 0.24)], 20),
            look,
        )
        a.add(ellipsoid((0.17, 0.32, 0.2), roundness=(0.8, 1)), look, (0, 0, 0.36))
        a.add(rod((0, 0, 0.45), (0.02, 0, 0.65), 0.09, 0.08), look)
        a.add(ellipsoid((0.16, 0.13, 0.19)), look, (0.03, 0, 0.78))
        a.add(rod((0.17, 0, 0.8), (0.2, 0, 0.74), 0.02, 0.035), look)
        a.add(ellipsoid((0.15, 0.15, 0.14)), look, (-0.02, 0, 0.86))
        a.add_mirrored(ellipsoid((0.03, 0.02, 0.04)), look, (0.02, 0.13, 0.77))
        return Description(("bust", "statue", "stone bust"), look, ("a base",))
    if kind == "cat":
        a.add(box((0.5, 0.32, 0.07)), look)
        body = smooth_profile([(0.2, 0.05), (0.21, 0.25), (0.13, 0.55), (0.09, 0.7)], 12)
        a.add(
            revolve(np.concatenate([[(0, 0.05)], body, [(0, 0.72)]]), 20).stretched(1, 0.85, 1),
            look,
        )
        a.add(rod((0.14, 0, 0.05), (0.1, 0, 0.5), 0.07, 0.08), look)
        a.add(ellipsoid((0.14, 0.11, 0.11)), look, (0.06, 0, 0.8))
        a.add(ellipsoid((0.06, 0.05, 0.045)), look, (0.19, 0, 0.77))
        a.add_mirrored(revolve([(0.05, 0), (0, 0.15)], 8), look, (0.02, 0.06, 0.87))
        path = smooth_profile([(-0.18, 0, 0.1), (-0.22, 0.16, 0.1), (0.0, 0.22, 0.1)], 9)
        a.add(tube(path, 0.035), look)
        eyes(a, 0.17, 0.045, 0.82, 0.014)
        return Description(
            ("cat statue", "cat", "egyptian cat statue", "statue of a cat"), look, ("a base",)
        )
    a.add(box((0.45, 0.4, 0.4)), look)
    a.add(box((0.12, 0.4, a.uniform(0.4, 0.8))), look, (-0.2, 0, 0.3))
    a.add(ellipsoid((0.13, 0.17, 0.24)), look, (-0.02, 0, 0.62))
    a.add(ellipsoid((0.1, 0.09, 0.12)), look, (0.02, 0, 0.97))
    a.add_mirrored(rod((0.0, 0.09, 0.45), (0.3, 0.1, 0.44), 0.08, 0.07), look, (0, 0, 0))
    a.add_mirrored(rod((0.3, 0.1, 0.44), (0.3, 0.1, 0.0), 0.07, 0.06), look, (0, 0, 0))
    a.add_mirrored(rod((-0.02, 0.18, 0.78), (0.22, 0.14, 0.52), 0.05), look, (0, 0, 0))
    return Description(
        ("seated statue", "seated figure", "statue", "statue of a seated figure"), look, ("a base",)
    )


def robot(a: Assembly) -> Description:
    """A robot from boxes and cylinders."""
    look = a.look("metal", "plastic", "metal", patterns=("two_tone", "rim"), pattern_chance=0.1)
    trim = a.look("metal", "plastic", avoid=look)
    glow = a.look(
        "glass", colors=("yellow", "red", "light blue", "green", "white", "black"), avoid=look
    )
    leg, width = a.uniform(0.2, 0.4), a.uniform(0.35, 0.55)
    if a.chance(0.25):
        a.add_mirrored(cylinder(0.14, 0.12), trim, (0, 0.5 * width, 0.14), turn_about("x", 90))
        leg = 0.22
    else:
        a.add_mirrored(box((0.14, 0.13, leg)), trim, (0, 0.27 * width, 0))
        a.add_mirrored(box((0.26, 0.17, 0.08)), look, (0.04, 0.27 * width, 0))
    tall = a.uniform(0.35, 0.5)
    body = box((0.3, width, tall)) if a.chance(0.7) else cylinder(0.5 * width, tall)
    a.add(body, look, (0, 0, leg))
    a.add(box((0.04, 0.55 * width, 0.4 * tall)), trim, (0.16, 0, leg + 0.3 * tall))
    for y in (-0.15, 0.0, 0.15):
        a.add(
            ball(0.03),
            a.look(colors=("red", "yellow", "green", "blue")),
            (0.19, y * width, leg + 0.5 * tall),
        )
    z = leg + tall
    a.add(cylinder(0.06, 0.08), trim, (0, 0, z))
    head = a.uniform(0.22, 0.34)
    if a.chance(0.7):
        a.add(box((0.26, head * 1.1, 0.24)), look, (0, 0, z + 0.06))
    else:
        a.add(ellipsoid((0.16, 0.5 * head, 0.15)), look, (0, 0, z + 0.18))
    a.add_mirrored(ball(0.045), glow, (0.13, 0.26 * head, z + 0.21))
    a.add(box((0.03, 0.5 * head, 0.03)), trim, (0.13, 0, z + 0.1))
    if a.chance(0.6):
        a.add(rod((0, 0, z + 0.28), (0, 0, z + 0.42), 0.014), trim)
        a.add(ball(0.035), glow, (0, 0, z + 0.44))
    swing = a.uniform(-80, 10)
    arm = rod((0, 0, 0), (0, 0, -0.3), 0.05)
    turn = turn_about("y", swing)
    shoulder = np.array([0, 0.5 * width + 0.06, z - 0.08])
    a.add_mirrored(arm, trim, tuple(shoulder), turn)
    a.add_mirrored(ball(0.07), look, tuple((shoulder + turn @ np.array([0, 0, -0.33])).tolist()))
    return Description(
        ("robot", "toy robot", "robot", "android"),
        look,
        (detail(trim, "arms", plural=True), f"{glow.color} eyes"),
    )


FAMILIES = (
    person,
    bust,
    robot,
)
