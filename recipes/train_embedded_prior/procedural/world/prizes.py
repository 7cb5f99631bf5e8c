"""Prizes, instruments, game devices and chess pieces."""

from __future__ import annotations

import math

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    Assembly,
    Description,
)
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.primitives import box, cylinder, disc, ellipsoid, prism
from recipes.train_embedded_prior.procedural.quads import turn_about
from recipes.train_embedded_prior.procedural.sweeps import (
    arc,
    revolve,
    rod,
    shell_profile,
    smooth_profile,
    torus,
    tube,
)
from recipes.train_embedded_prior.procedural.world.play import UPRIGHT


def trophy(a: Assembly) -> Description:
    """A trophy cup on a base, or a medal."""
    look = a.look("golden", "metal", colors=("golden", "silver", "golden", "brown"))
    base = a.look("stone", "wooden", colors=("black", "dark brown", "brown", "dark grey"))
    z = a.uniform(0.1, 0.25)
    a.add(box((0.34, 0.34, z)) if a.chance(0.5) else cylinder(0.2, z), base)
    r = a.uniform(0.2, 0.32)
    line = smooth_profile([(0.15, 0), (0.035, 0.12), (0.04, 0.26), (r * 0.8, 0.45), (r, 0.8)], 16)
    a.add(revolve(shell_profile(line, 0.02, 0.3), 24), look, (0, 0, z))
    if a.chance(0.8):
        loop = arc(-90, 90, 1.0, 9, plane="yz") * np.array([1, 0.16, 0.16], np.float32)
        a.add_mirrored(tube(loop, 0.022), look, (0, r * 0.85, z + 0.6))
    if a.chance(0.3):
        a.add(ellipsoid((0.08, 0.08, 0.1)), look, (0, 0, z + 0.8))
    return Description(
        ("trophy", "trophy cup", "award", "cup"), look, (detail(base, "base"), "two handles")
    )


def bell(a: Assembly) -> Description:
    """A bell with a handle or a loop."""
    look = a.look("golden", "metal", "metal", patterns=("bands", "rim"), pattern_chance=0.15)
    grip = look if a.chance(0.4) else a.look("wooden", avoid=look)
    r, height = a.uniform(0.35, 0.45), a.uniform(0.5, 0.75)
    line = smooth_profile(
        [(r, 0), (0.7 * r, 0.18 * height), (0.55 * r, 0.7 * height), (0.1, height)], 14
    )
    inner = line[::-1] - np.array([0.03, 0.0])
    a.add(
        revolve(
            np.concatenate([line, [(0, height + 0.01), (0, height - 0.04)], inner.clip(0.01)]), 28
        ),
        look,
    )
    a.add(ellipsoid((0.07, 0.07, 0.07)), look, (0, 0, 0.03))
    if a.chance(0.6):
        a.add(rod((0, 0, height), (0, 0, height + a.uniform(0.25, 0.4)), 0.045, 0.06), grip)
        details = (detail(grip, "handle"),)
    else:
        a.add(torus(0.1, 0.028), look, (0, 0, height + 0.09), turn_about("x", 90))
        details = ("a ring",)
    return Description(("bell", "hand bell", "bell"), look, details)


def guitar(a: Assembly) -> Description:
    """A guitar, ukulele or violin, standing upright."""
    look = a.look("wooden", "wooden", "painted", patterns=("gradient",), pattern_chance=0.15)
    neck = a.look("wooden", colors=("dark brown", "brown", "black"), avoid=look)
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    waist = 1 - a.uniform(0.2, 0.34) * np.exp(-((np.sin(angle) - 0.15) ** 2) / 0.08)
    width = np.where(np.sin(angle) > 0.15, a.uniform(0.72, 0.85), 1.0)
    outline = np.stack([0.3 * np.cos(angle) * waist * width, 0.38 * np.sin(angle)], axis=1)
    depth = a.uniform(0.07, 0.14)
    a.add(prism(outline, depth), look, (-0.5 * depth, 0, 0.38), UPRIGHT)
    front = 0.5 * depth
    a.add(
        disc(0.1),
        a.look(colors=("black", "dark brown")),
        (front + 0.006, 0, 0.46),
        turn_about("y", 90),
    )
    a.add(box((0.04, 0.08, a.uniform(0.6, 0.85))), neck, (front, 0, 0.56))
    tip = 0.56 + 0.72
    a.add(box((0.04, 0.14, 0.2)), neck, (front, 0, tip))
    a.add(box((0.03, 0.2, 0.04)), neck, (front + 0.01, 0, 0.2))
    steel = a.look("metal", colors=("silver", "white", "golden"))
    for y in (-0.02, 0.0, 0.02):
        a.add(rod((front + 0.04, y, 0.22), (front + 0.035, y, tip + 0.1), 0.004), steel)
    for z in (0.05, 0.12):
        a.add_mirrored(
            ellipsoid((0.02, 0.03, 0.02), rows=6, segments=8), steel, (front, 0.09, tip + z)
        )
    return Description(
        ("guitar", "guitar", "ukulele", "toy guitar"), look, (detail(neck, "handle"), "strings")
    )


def controller(a: Assembly) -> Description:
    """A game controller, remote control, hand-held game, phone, tablet or laptop."""
    look = a.look(
        "plastic",
        "metal",
        colors=(
            "black",
            "white",
            "grey",
            "dark grey",
            "red",
            "blue",
            "silver",
            "light blue",
            "pink",
        ),
    )
    dark = a.look("plastic", avoid=look, colors=("black", "dark grey", "white", "grey"))
    screen = a.look("glass", colors=("black", "dark blue", "light blue", "dark grey"), avoid=look)
    kind = a.choose(["gamepad", "remote", "tablet", "laptop", "vr", "monitor"])
    if kind == "gamepad":
        a.add(ellipsoid((0.25, 0.42, 0.1), roundness=(0.8, 0.6)), look, (0.05, 0, 0.16))
        a.add_mirrored(
            ellipsoid((0.28, 0.12, 0.1)), look, (-0.14, 0.36, 0.13), turn_about("z", -18)
        )
        for x, y in ((0.02, 0.14), (0.12, 0.28)):
            a.add_mirrored(cylinder(0.05, 0.08), dark, (x, y, 0.22))
        for k in range(4):
            color = a.look("plastic", colors=("red", "green", "blue", "yellow"))
            at = (0.14 + 0.06 * math.cos(1.57 * k), -0.26 + 0.06 * math.sin(1.57 * k), 0.25)
            a.add(ellipsoid((0.022, 0.022, 0.02), rows=6, segments=8), color, at)
        return Description(("game controller", "controller", "gamepad"), look, ("buttons",))
    if kind == "vr":
        grip = [(0, 0), (0.1, 0), (0.11, 0.2), (0.09, 0.45), (0, 0.47)]
        a.add(revolve(smooth_profile(grip, 12).clip(0), 20), look, turn=turn_about("y", 20))
        a.add(cylinder(0.17, 0.06), dark, (0.17, 0, 0.44), turn_about("y", 35))
        a.add(torus(0.24, 0.035), look, (0.2, 0, 0.52), turn_about("y", a.uniform(20, 70)))
        a.add(ellipsoid((0.035, 0.035, 0.05)), dark, (0.2, 0, 0.5))
        return Description(
            ("vr controller", "hand controller", "controller"), look, ("buttons", "a ring")
        )
    if kind == "remote":
        a.add(ellipsoid((0.5, 0.14, 0.06), roundness=(0.4, 0.4)), look, (0, 0, 0.06))
        for i in range(5):
            for j in (-1, 0, 1):
                button = (
                    dark if a.chance(0.85) else a.look("plastic", colors=("red", "green", "blue"))
                )
                a.add(
                    ellipsoid((0.03, 0.025, 0.02), rows=6, segments=8),
                    button,
                    (0.35 - 0.15 * i, 0.07 * j, 0.12),
                )
        return Description(("remote", "tv remote"), look, (detail(dark, "buttons", plural=True),))
    wide, tall = a.uniform(0.6, 0.8), a.uniform(0.9, 1.1)
    slim = ellipsoid((0.03, 0.5 * wide, 0.5 * tall), roundness=(0.3, 0.12), rows=14)
    if kind == "tablet":
        phone = a.chance(0.4)
        scale = 0.7 if phone else 1.0
        turn = turn_about("y", a.choose([0.0, -90.0, -25.0]))
        a.add(slim.stretched(1, scale, 1), look, turn=turn)
        a.add(
            box((0.02, wide * scale * 0.9, tall * 0.88)).moved(None, (0.026, 0, -0.44 * tall)),
            screen,
            turn=turn,
        )
        return Description(
            ("phone", "smartphone") if phone else ("tablet", "tablet computer"),
            look,
            (detail(screen, "screen"),),
        )
    panel = box((0.03, 1.0, 0.65))
    lean = turn_about("y", -a.uniform(5, 25))
    if kind == "laptop":
        a.add(box((0.65, 1.0, 0.04)), look)
        a.add(box((0.3, 0.9, 0.015)), dark, (0.1, 0, 0.035))
        at = (-0.32, 0, 0.02)
    else:
        a.add(cylinder(0.22, 0.03), look)
        a.add(rod((-0.05, 0, 0), (-0.03, 0, 0.3), 0.04), look)
        at, lean = (0, 0, 0.2), turn_about("y", 0)
    a.add(panel, look, at, lean)
    pane = box((0.02, 0.93, 0.57)).moved(None, (0.02, 0, 0.04))
    a.add(pane, screen, at, lean)
    nouns = (
        ("laptop", "laptop computer") if kind == "laptop" else ("monitor", "screen", "television")
    )
    return Description(nouns, look, (detail(screen, "screen"),))


def chess_piece(a: Assembly) -> Description:
    """A chess piece: pawn, rook, bishop, queen or king."""
    look = a.look("wooden", "plastic", "stone", "marble", colors=None)
    kind = a.choose(["pawn", "rook", "bishop", "queen", "king"])
    foot = [(0, 0), (0.24, 0), (0.24, 0.08), (0.19, 0.14), (0.12, 0.22)]
    height = {"pawn": 0.5, "rook": 0.55, "bishop": 0.65, "queen": 0.8, "king": 0.85}[kind]
    a.add(
        revolve(
            [
                *foot,
                (0.09, height * 0.8),
                (0.15, height),
                (0.15, height + 0.03),
                (0, height + 0.03),
            ],
            24,
        ),
        look,
    )
    if kind == "pawn":
        a.add(ellipsoid((0.13, 0.13, 0.13)), look, (0, 0, height + 0.12))
    elif kind == "rook":
        a.add(revolve(shell_profile([(0.15, 0), (0.17, 0.14)], 0.05), 24), look, (0, 0, height))
        a.add_around(box((0.05, 0.07, 0.06)), look, 6, (0.145, 0, height + 0.14))
    elif kind == "bishop":
        a.add(ellipsoid((0.12, 0.12, 0.17)), look, (0, 0, height + 0.16))
        a.add(ellipsoid((0.035,) * 3), look, (0, 0, height + 0.35))
    else:
        a.add(revolve([(0.09, 0), (0.16, 0.16), (0, 0.2)], 24), look, (0, 0, height + 0.02))
        if kind == "king":
            a.add(box((0.04, 0.04, 0.18)), look, (0, 0, height + 0.2))
            a.add(box((0.04, 0.14, 0.04)), look, (0, 0, height + 0.28))
        else:
            a.add_around(
                ellipsoid((0.03,) * 3, rows=6, segments=8), look, 8, (0.15, 0, height + 0.2)
            )
            a.add(ellipsoid((0.045,) * 3), look, (0, 0, height + 0.26))
    return Description(("chess piece", f"chess {kind}", kind), look)


FAMILIES = (
    trophy,
    bell,
    guitar,
    controller,
    chess_piece,
)
