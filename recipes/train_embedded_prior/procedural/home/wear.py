"""Wearable families: hats, shoes, glasses, headphones, umbrellas."""

from __future__ import annotations

import math

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import DECORATIONS, Assembly, Description
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.primitives import box, cylinder, ellipsoid
from recipes.train_embedded_prior.procedural.quads import Quads, grid, turn_about
from recipes.train_embedded_prior.procedural.sweeps import (
    arc,
    loft,
    revolve,
    rod,
    smooth_profile,
    torus,
    tube,
)


def hat(a: Assembly) -> Description:
    """A cap, top hat, cowboy hat, beanie, party hat, helmet or crown."""
    look = a.look("fabric", "straw", "leather", patterns=DECORATIONS, pattern_chance=0.2)
    band = a.look("fabric", "leather", avoid=look)
    kind = a.choose(["cap", "top", "cowboy", "sun", "beanie", "cone", "helmet", "crown"])
    if kind in ("cap", "helmet"):
        if kind == "helmet":
            look = a.look("plastic", "metal", patterns=("stripes", "two_tone"), pattern_chance=0.15)
        dome = smooth_profile([(0.42, 0), (0.41, 0.18), (0.28, 0.36), (0, 0.42)], 12).clip(0)
        inner = dome[::-1] * np.array([0.94, 0.94])
        a.add(revolve(np.concatenate([dome, inner]), 28).stretched(1.1, 0.95, 1), look)
        a.add(ellipsoid((0.03, 0.03, 0.02)), band, (0, 0, 0.42))
        peak = ellipsoid((0.38, 0.33, 0.025))
        brim = look if a.chance(0.5) else band
        a.add(peak, brim, (0.42, 0, 0.02), turn_about("y", a.uniform(0, 14)))
        nouns = ("cap", "baseball cap", "hat") if kind == "cap" else ("helmet", "hard hat")
        return Description(nouns, look, (detail(brim, "brim"),))
    if kind == "crown":
        gold = a.look("golden", "metal", colors=("golden", "silver"))
        theta = np.linspace(0, 2 * math.pi, 49)
        points = a.integer(5, 8)
        rise = 0.3 + 0.2 * np.abs(((theta * points / (2 * math.pi)) % 1.0) - 0.5) * 2
        ring = np.stack([0.4 * np.cos(theta), 0.4 * np.sin(theta), rise], axis=1)
        rings = np.stack(
            [ring * [0.9, 0.9, 0], ring, ring * [0.95, 0.95, 1], ring * [0.85, 0.85, 0]]
        )
        a.add(grid(rings.astype(np.float32), rings[..., :2].astype(np.float32)), gold)
        jewel = a.look("glass", colors=("red", "blue", "green", "purple"))
        a.add_around(ellipsoid((0.03, 0.05, 0.05)), jewel, points, (0.385, 0, 0.17))
        return Description(
            ("crown", "golden crown" if gold.color == "golden" else "crown"),
            gold,
            (detail(jewel, "gem"),),
        )
    if kind == "cone":
        a.add(revolve([(0.32, 0), (0, 0.85), (0.0, 0.8), (0.3, 0)], 24), look)
        a.add(ellipsoid((0.07, 0.07, 0.07)), band, (0, 0, 0.86))
        if a.chance(0.4):
            a.add(revolve([(0.34, -0.01), (0.58, 0.0), (0.34, 0.02)], 28), look)
            return Description(("witch hat", "hat", "pointed hat"), look, ("a brim",))
        return Description(("party hat", "hat", "cone hat"), look, (detail(band, "ball"),))
    if kind == "beanie":
        dome = smooth_profile([(0.38, 0.1), (0.38, 0.25), (0.25, 0.5), (0, 0.56)], 12).clip(0)
        a.add(revolve(dome, 40, lobes=18, lobe_depth=0.05), look)
        a.add(revolve([(0.36, 0), (0.41, 0.02), (0.41, 0.15), (0.36, 0.16), (0.35, 0)], 28), band)
        if a.chance(0.7):
            a.add(ellipsoid((0.11, 0.11, 0.1)), band, (0, 0, 0.62))
        return Description(("beanie", "hat", "cap"), look, (detail(band, "rim"),))
    tall = {"top": a.uniform(0.45, 0.7), "cowboy": 0.36, "sun": a.uniform(0.22, 0.34)}[kind]
    flare = a.uniform(0.95, 1.12) if kind == "top" else a.uniform(0.75, 0.95)
    top = 0.3 * flare
    line = [
        (0.3, 0.01),
        (0.3 * (0.5 + 0.5 * flare), 0.5 * tall),
        (top, tall * 0.96),
        (0.8 * top, tall),
        (0, tall),
    ]
    reach = {"top": a.uniform(0.42, 0.5), "cowboy": 0.56, "sun": a.uniform(0.5, 0.65)}[kind]
    crown = revolve(line, 28).stretched(1.15, 0.92, 1)
    brim = revolve([(0.28, -0.01), (reach, 0.0), (reach, 0.02), (0.28, 0.03)], 32).stretched(
        1.1, 1, 1
    )
    if kind == "cowboy":
        corners = brim.corners.copy()
        corners[..., 2] += 0.85 * np.abs(corners[..., 1]) ** 2
        corners[..., 1] *= 0.82
        brim = Quads(corners, brim.uv, brim.feature)
        dent = crown.corners.copy()
        lift = (dent[..., 2] > 0.9 * tall) & (np.abs(dent[..., 1]) < 0.1)
        dent[..., 2] -= 0.09 * lift
        crown = Quads(dent, crown.uv, crown.feature)
    a.add(crown, look)
    a.add(brim, look)
    a.add(revolve([(0.308, 0.02), (0.308, 0.1)], 28).stretched(1.15, 0.94, 1), band)
    nouns = {
        "top": ("top hat", "hat"),
        "cowboy": ("cowboy hat", "hat"),
        "sun": ("hat", "straw hat" if look.substance == "straw" else "hat"),
    }[kind]
    return Description(nouns, look, (detail(band, "ribbon"), f"a {band.color} ribbon", "a brim"))


def foot_section(x: float, width: float, low: float, high: float) -> np.ndarray:
    """Return a rounded section [16, 3] of a shoe at x, between two heights."""
    angle = np.linspace(0, 2 * math.pi, 16, endpoint=False)
    cos, sin = np.cos(angle), np.sin(angle)
    reach = (np.abs(cos) ** 3 + np.abs(sin) ** 3) ** (-1 / 3)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return np.stack(
        [np.full(16, x), 0.5 * width * reach * cos, middle + half * reach * sin], axis=1
    )


def shoe(a: Assembly) -> Description:
    """A shoe, sneaker, boot, slipper or high heel."""
    look = a.look(
        "leather",
        "fabric",
        "plastic",
        "rubber",
        patterns=("two_tone", "stripes", "dots"),
        pattern_chance=0.15,
    )
    sole = a.look(
        "rubber", colors=("white", "black", "brown", "dark grey", "beige", "red"), avoid=look
    )
    kind = a.choose(["shoe", "sneaker", "boot", "boot", "slipper"])
    xs = np.array([-0.5, -0.46, -0.3, -0.1, 0.1, 0.3, 0.44, 0.5])
    width = np.array([0.14, 0.24, 0.29, 0.28, 0.3, 0.34, 0.26, 0.1]) * a.uniform(0.9, 1.15)
    thick = a.uniform(0.04, 0.1)
    ankle = {"shoe": 0.32, "sneaker": 0.36, "boot": 0.36, "slipper": 0.2}[kind]
    tops = np.array([0.8, 1.0, 1.0, 0.92, 0.72, 0.5, 0.4, 0.2]) * ankle
    body = np.stack(
        [
            foot_section(x, w, thick * 0.8, thick + t)
            for x, w, t in zip(xs, width, tops, strict=True)
        ]
    )
    a.add(loft(body), look)
    base = np.stack(
        [foot_section(1.03 * x, 1.08 * w, 0, thick) for x, w in zip(xs, width, strict=True)]
    )
    a.add(loft(base), sole)
    opening = (-0.26, 0, thick + ankle)
    if kind == "boot":
        shaft = a.uniform(0.3, 0.55)
        leg = revolve(
            [(0.145, -0.15), (0.155, shaft), (0.125, shaft), (0.125, -0.05), (0, -0.05)], 20
        )
        a.add(leg.stretched(1.25, 1, 1), look, opening)
        a.add(
            torus(0.15, 0.02, sides=6).stretched(1.25, 1, 1),
            sole,
            (*opening[:2], opening[2] + shaft),
        )
    else:
        a.add(
            ellipsoid((0.17, 0.095, 0.02)), a.look(colors=("black", "dark grey", "beige")), opening
        )
        if kind == "slipper":
            a.add(torus(0.12, 0.03).stretched(1.4, 0.85, 1), sole, opening)
    if kind in ("sneaker", "shoe"):
        for k in range(a.integer(2, 4)):
            x = 0.08 * k
            z = thick + float(np.interp(x, xs, tops)) + 0.005
            a.add(rod((x, -0.07, z), (x, 0.07, z), 0.014), sole)
    if kind != "slipper" and a.chance(0.4):
        a.add(box((0.2, 0.22, 0.07)), sole, (-0.36, 0, -0.06))
    nouns = {
        "shoe": ("shoe", "leather shoe"),
        "sneaker": ("sneaker", "sports shoe", "shoe"),
        "boot": ("boot", "boot", "shoe"),
        "slipper": ("slipper", "shoe"),
    }[kind]
    return Description(
        nouns, look, (detail(sole, "sole"), "laces" if kind in ("shoe", "sneaker") else "a sole")
    )


def glasses(a: Assembly) -> Description:
    """Glasses, sunglasses, goggles or a VR headset."""
    frame = a.look(
        "plastic",
        "metal",
        colors=("black", "white", "red", "brown", "golden", "silver", "blue", "pink", "dark grey"),
    )
    lens = a.look(
        "glass", colors=("black", "dark blue", "dark grey", "light blue", "dark brown"), avoid=frame
    )
    face_x = turn_about("y", 90)
    if a.chance(0.35):
        a.add(ellipsoid((0.2, 0.45, 0.22), roundness=(0.5, 0.4)), frame, (0.1, 0, 0.22))
        strap = a.look("fabric", avoid=frame)
        half = arc(-100, 100, 0.42, 17, plane="xy") * np.array([-1.4, 1, 1], np.float32)
        a.add(tube(half, 0.05, flatten=0.35), strap, (0, 0, 0.22))
        pad = a.look("plastic", colors=("black", "dark grey", "grey"), avoid=frame)
        a.add(ellipsoid((0.06, 0.38, 0.17), roundness=(0.5, 0.4)), pad, (-0.08, 0, 0.22))
        a.add_mirrored(cylinder(0.1, 0.03), lens, (0.29, 0.18, 0.22), face_x)
        return Description(
            ("vr headset", "virtual reality headset", "headset", "goggles"),
            frame,
            (detail(strap, "strap"), detail(lens, "lenses", plural=True)),
        )
    r, tall = a.uniform(0.17, 0.21), a.uniform(0.75, 1.0)
    square = a.choose([1.0, 1.0, 0.5])
    z = r * tall
    rim = torus(r, a.uniform(0.018, 0.04), sides=8).stretched(tall, 1, 1)
    a.add_mirrored(rim, frame, (0, r + 0.05, z), face_x)
    pane = ellipsoid((tall * r, r, 0.012), roundness=(1, square))
    a.add_mirrored(pane, lens, (0, r + 0.05, z), face_x)
    a.add(rod((0, -0.06, z + 0.05), (0, 0.06, z + 0.05), 0.02), frame)
    side = smooth_profile(
        [
            (0, 2 * r + 0.05, z + 0.05),
            (-0.45, 2 * r + 0.06, z + 0.05),
            (-0.62, 2 * r + 0.05, z - 0.1),
        ],
        9,
    )
    a.add_mirrored(tube(side, 0.022), frame, (0, 0, 0))
    dark = lens.color not in ("light blue",)
    nouns = (
        ("sunglasses", "pair of sunglasses", "glasses") if dark else ("glasses", "pair of glasses")
    )
    return Description(
        nouns, frame, (detail(lens, "lenses", plural=True), "dark lenses" if dark else "lenses")
    )


def headphones(a: Assembly) -> Description:
    """Headphones with two cups and a band."""
    look = a.look(
        "plastic", "metal", colors=("black", "white", "red", "blue", "silver", "pink", "dark grey")
    )
    pad = a.look("leather", "fabric", avoid=look)
    half = arc(0, 180, 0.42, 19, plane="yz") * np.array([1, 1, 1.1], np.float32)
    a.add(tube(half, a.uniform(0.03, 0.05), flatten=a.uniform(0.5, 2.5)), look, (0, 0, 0.25))
    r = a.uniform(0.15, 0.21)
    sideways = turn_about("x", 90)
    a.add_mirrored(
        cylinder(r, 0.09, 0.8 * r).stretched(0.85, 1.1, 1),
        look,
        (0, 0.46, 0.2),
        turn_about("x", -90),
    )
    a.add_mirrored(torus(0.8 * r, 0.05).stretched(0.85, 1.1, 1), pad, (0, 0.42, 0.2), sideways)
    details = [detail(pad, "cushions", plural=True)]
    if a.chance(0.3):
        stick = smooth_profile([(0, 0.45, 0.15), (0.2, 0.44, 0.0), (0.32, 0.3, -0.02)], 8)
        a.add(tube(stick, 0.015), look)
        details.append("a microphone")
    return Description(("headphones", "headset", "headphones"), look, tuple(details))


def umbrella(a: Assembly) -> Description:
    """An open umbrella or a parasol."""
    look = a.look("fabric", patterns=("stripes", "dots", "bands", "rim"), pattern_chance=0.3)
    grip = a.look("wooden", "metal", "plastic", avoid=look)
    ribs, rise = a.integer(6, 10), a.uniform(0.18, 0.35)
    dome = smooth_profile([(0.6, 0), (0.42, 0.6 * rise), (0, rise)], 10).clip(0)
    under = dome[::-1] - np.array([0.0, 0.02])
    a.add(
        revolve(np.concatenate([dome, under]), ribs * 4, lobes=ribs, lobe_depth=-0.05),
        look,
        (0, 0, 0.8),
    )
    a.add(rod((0, 0, 0.1), (0, 0, 0.85 + rise), 0.018), grip)
    if a.chance(0.6):
        hook = smooth_profile([(0, 0, 0.12), (0.0, 0, 0.02), (0.07, 0, -0.05), (0.14, 0, 0.04)], 9)
        a.add(tube(hook, 0.03), grip)
        return Description(
            ("umbrella", "umbrella", "open umbrella"), look, (detail(grip, "handle"),)
        )
    a.add(cylinder(0.22, 0.06), grip, (0, 0, 0.06))
    return Description(("parasol", "umbrella", "beach umbrella"), look, (detail(grip, "base"),))


FAMILIES = (hat, shoe, glasses, headphones, umbrella)
