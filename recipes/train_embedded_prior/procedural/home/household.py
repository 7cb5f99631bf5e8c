"""Household families: lights, clocks, barrels and bins."""

from __future__ import annotations

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import DECORATIONS, Assembly, Description
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

FACE_X = turn_about("y", 90)
"""Turns what looks up into what looks along +x."""
WARM = ("cream", "white", "yellow", "beige", "red", "orange", "green", "light blue", "pink")


def lamp(a: Assembly) -> Description:
    """A table lamp, floor lamp or desk lamp."""
    kind = a.choose(["table", "table", "floor", "desk"])
    shade = a.look("fabric", colors=WARM, patterns=DECORATIONS, pattern_chance=0.2)
    base = a.look("ceramic", "metal", "wooden", avoid=shade)
    if kind == "desk":
        metal = a.look("metal", "plastic")
        a.add(cylinder(0.2, 0.05), metal)
        elbow, head = (-0.15, 0, 0.5), (a.uniform(0.15, 0.3), 0, a.uniform(0.75, 0.95))
        a.add(rod((0, 0, 0.03), elbow, 0.022), metal)
        a.add(rod(elbow, head, 0.022), metal)
        cone = revolve(shell_profile([(0.06, 0), (0.09, 0.08), (0.19, 0.25)], 0.015), 20)
        a.add(cone, metal, head, turn_about("y", a.uniform(110, 150)))
        return Description(("desk lamp", "lamp", "office lamp"), metal, ("a round base",))
    height = a.uniform(1.0, 1.5) if kind == "floor" else a.uniform(0.35, 0.6)
    if kind == "floor":
        if a.chance(0.3):
            a.add_around(rod((0.3, 0, 0), (0.02, 0, 0.9 * height), 0.02), base, 3, (0, 0, 0))
        else:
            a.add(cylinder(0.2, 0.04, 0.17), base)
            a.add(cylinder(0.022, height), base)
    else:
        knots = a.rng.uniform(0.04, 0.2, 4)
        line = np.stack([knots, np.linspace(0, height, 4)], axis=1)
        line[0, 0], line[-1, 0] = a.uniform(0.12, 0.2), 0.025
        a.add(revolve(np.concatenate([[(0, 0)], smooth_profile(line, 14).clip(0.02)]), 24), base)
    low, high = a.uniform(0.22, 0.36), a.uniform(0.1, 0.3)
    tall, style = a.uniform(0.22, 0.42), a.integer(0, 2)
    if style == 2:
        line = np.array([(low, 0), (0.9 * low, 0.4 * tall), (0.55 * low, 0.85 * tall), (0.1, tall)])
    else:
        line = np.array([(low, 0), (min(low, high), tall)])
    inner = line[::-1] - np.array([0.015, 0])
    segments = a.choose([28, 28, 6, 8, 4])
    a.add(revolve(np.concatenate([line, inner]), segments), shade, (0, 0, height - 0.05))
    a.add(ellipsoid((0.05, 0.05, 0.07)), a.look(colors=("cream", "yellow")), (0, 0, height + 0.08))
    nouns = (
        ("floor lamp", "lamp", "standing lamp")
        if kind == "floor"
        else ("lamp", "table lamp", "bedside lamp")
    )
    return Description(nouns, shade, (detail(base, "base"), "a shade"))


def lantern(a: Assembly) -> Description:
    """A lantern: lit body between a base and a roof, with a ring to hang it by."""
    frame = a.look("metal", "wooden", "plastic")
    body = a.look("glass", "paper", colors=WARM, avoid=frame)
    height, radius = a.uniform(0.4, 0.7), a.uniform(0.2, 0.3)
    segments = a.choose([24, 24, 4, 6, 8])
    a.add(cylinder(radius * 1.15, 0.1, radius * 1.05, segments), frame)
    belly = a.uniform(0.85, 1.25)
    line = smooth_profile(
        [(radius * 0.9, 0), (radius * belly, 0.5 * height), (radius * 0.9, height)], 9
    )
    a.add(revolve(line, segments), body, (0, 0, 0.1))
    posts = segments if segments <= 8 else 4
    post = rod((radius * 1.0, 0, 0.08), (radius * 1.0, 0, height + 0.12), 0.02)
    if a.chance(0.7) and belly < 1.1:
        a.add_around(post, frame, posts, (0, 0, 0))
    roof = a.uniform(0.1, 0.25)
    a.add(
        revolve([(radius * 1.25, 0), (radius * 1.2, 0.03), (0.05, roof), (0, roof)], segments),
        frame,
        (0, 0, height + 0.1),
    )
    ring = torus(a.uniform(0.07, 0.16), 0.015, sides=6)
    a.add(ring, frame, (0, 0, height + roof + 0.18), turn_about("x", 90))
    return Description(
        ("lantern", "lamp", "toy lamp"), body, (detail(frame, "frame"), detail(frame, "roof"))
    )


def chandelier(a: Assembly) -> Description:
    """A hanging lamp: a wheel or arms with candles."""
    frame = a.look("metal", "wooden", "golden")
    light = a.look("wax", colors=("cream", "white", "yellow"))
    radius, count = a.uniform(0.35, 0.55), a.integer(4, 9)
    a.add(rod((0, 0, 0.05), (0, 0, a.uniform(0.5, 0.8)), 0.02), frame)
    if a.chance(0.5):
        a.add(torus(radius, a.uniform(0.02, 0.05)), frame)
        for k in range(4):
            spoke = rod((radius, 0, 0), (0, 0, 0.5), 0.012)
            a.add(spoke, frame, turn=turn_about("z", 90.0 * k))
    else:
        curve = smooth_profile([(0, 0, 0.15), (0.5 * radius, 0, -0.1), (radius, 0, 0.0)], 8)
        a.add_around(tube(curve, 0.02, sides=6), frame, count, (0, 0, 0))
        a.add(ellipsoid((0.08, 0.08, 0.12)), frame, (0, 0, 0.1))
    a.add_around(cylinder(0.05, 0.03, segments=10), frame, count, (radius, 0, 0.0))
    a.add_around(cylinder(0.03, 0.15, segments=8), light, count, (radius, 0, 0.02))
    return Description(("chandelier", "ceiling lamp", "hanging lamp"), frame, ("candles",))


def candle(a: Assembly) -> Description:
    """One or several candles, alone or in a holder."""
    look = a.look("wax")
    flame = a.look(colors=("yellow", "orange"))
    height, radius = a.uniform(0.4, 0.9), a.uniform(0.08, 0.2)
    spots = [(0.0, 0.0)] if a.chance(0.65) else [(0.0, 0.0), (0.3, 0.1), (0.1, 0.32)]
    details = ["a flame"]
    base = 0.0
    if len(spots) == 1 and a.chance(0.5):
        holder = a.look("metal", "ceramic", "golden", avoid=look)
        base = a.uniform(0.04, 0.3)
        a.add(
            revolve(
                [
                    (0, 0),
                    (0.28, 0),
                    (0.28, 0.03),
                    (0.06, 0.05),
                    (0.06, base),
                    (radius * 1.3, base),
                    (radius * 1.3, base + 0.05),
                    (0, base + 0.05),
                ],
                24,
            ),
            holder,
        )
        details.append(detail(holder, "holder"))
    for x, y in spots:
        tall = height * a.uniform(0.6, 1.0)
        a.add(cylinder(radius, tall), look, (x, y, base))
        a.add(rod((x, y, base + tall), (x, y, base + tall + 0.06), 0.01), a.look(colors=("black",)))
        drop = ellipsoid((0.03, 0.03, 0.07), roundness=(1.2, 1))
        a.add(drop, flame, (x, y, base + tall + 0.1))
    nouns = ("candle", "candle", "light") if len(spots) == 1 else ("candles", "three candles")
    return Description(
        nouns, look, tuple(details), ("tall",) if height > 4 * radius else ("thick",)
    )


def clock(a: Assembly) -> Description:
    """A wall clock, alarm clock or mantel clock with a dial and hands."""
    look = a.look("wooden", "plastic", "metal")
    dial = a.look(colors=("white", "cream", "black", "light grey"), avoid=look)
    ink = a.look(colors=("black", "white", "red", "golden", "dark blue"), avoid=dial)
    radius, depth = 0.4, a.uniform(0.06, 0.25)
    kind = a.choose(["round", "round", "alarm", "square", "house"])
    z = 0.45
    details = ["a round face", detail(dial, "face")]
    if kind in ("square", "house"):
        a.add(box((depth, 0.9, 0.9)), look, (0, 0, 0))
        if kind == "house":
            roof = prism([(-0.5, 0), (0.5, 0), (0, 0.35)], depth)
            a.add(roof, look, (-0.5 * depth, 0, 0.9), np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]))
            details.append("a roof")
    else:
        a.add(cylinder(radius * 1.08, depth), look, (-0.5 * depth, 0, z), FACE_X)
        a.add(torus(radius * 1.05, 0.05), look, (0.5 * depth, 0, z), FACE_X)
    if kind == "alarm":
        bell = ellipsoid((0.13, 0.13, 0.09))
        a.add_mirrored(bell, look, (0, 0.22, z + 0.45), turn_about("x", -25))
        a.add_mirrored(rod((0, 0.25, 0.15), (0, 0.33, 0), 0.03), look, (0, 0, 0))
        details.append("a bell")
    front = 0.5 * depth + 0.012
    a.add(disc(radius), dial, (front, 0, z), FACE_X)
    for hour in range(12):
        angle = hour * np.pi / 6
        size = 0.05 if hour % 3 == 0 else 0.03
        at = (front, 0.84 * radius * np.sin(angle), z + 0.84 * radius * np.cos(angle))
        a.add(box((0.012, 0.03, size)), ink, at, turn_about("x", -np.degrees(angle)))
    for length, width in ((0.5, 0.03), (0.75, 0.02)):
        hand = box((0.02, width, length * radius)).moved(None, (0, 0, -0.03))
        a.add(hand, ink, (front + 0.01, 0, z), turn_about("x", a.uniform(0, 360)))
    nouns = ("alarm clock", "clock") if kind == "alarm" else ("clock", "clock", "wall clock")
    return Description(nouns, look, tuple(details), ("round",) if kind == "round" else ("old",))


def barrel(a: Assembly) -> Description:
    """A barrel or keg with hoops, or an oil drum."""
    steel = a.chance(0.25)
    look = (
        a.look("metal", colors=("red", "blue", "green", "grey", "black"))
        if steel
        else a.look("wooden")
    )
    hoop = a.look("metal", avoid=look, colors=("dark grey", "grey", "black", "golden", "silver"))
    height, radius = a.uniform(0.8, 1.2), a.uniform(0.32, 0.45)
    bulge = radius * (1.0 if steel else a.uniform(1.1, 1.3))
    line = smooth_profile([(radius, 0), (bulge, 0.5 * height), (radius, height)], 13)
    top = [(radius - 0.03, height), (radius - 0.03, height - 0.04), (0, height - 0.04)]
    a.add(revolve(np.concatenate([[(0, 0)], line, top]), 28), look)
    for share in a.choose([(0.08, 0.3, 0.7, 0.92), (0.15, 0.85), (0.05, 0.25, 0.5, 0.75, 0.95)]):
        at = float(np.interp(share, np.linspace(0, 1, 13), line[:, 0]))
        a.add(revolve([(at * 1.02, -0.03), (at * 1.02, 0.03)], 28), hoop, (0, 0, share * height))
    return Description(
        ("barrel", "barrel", "keg", "cask"), look, (f"{hoop.color} bands", f"{hoop.color} rings")
    )


def bucket(a: Assembly) -> Description:
    """A bucket with a bail, or a waste bin with or without lid."""
    look = a.look("plastic", "metal", "plastic", "straw", patterns=DECORATIONS, pattern_chance=0.15)
    height, radius = a.uniform(0.6, 1.0), a.uniform(0.32, 0.45)
    foot = radius * a.uniform(0.65, 0.95)
    power = a.choose([2.0, 2.0, 6.0])
    lid = a.chance(0.3)
    line = [(foot, 0), (radius, height), (radius + 0.03, height)]
    a.add(revolve(shell_profile(line, 0.035), 28, power=power), look)
    if lid:
        cover = look if a.chance(0.4) else a.look("plastic", avoid=look)
        dome = a.uniform(0.03, 0.25)
        a.add(
            revolve(
                [
                    (radius * 1.06, 0),
                    (radius * 1.06, 0.04),
                    (0.6 * radius, dome + 0.03),
                    (0, dome + 0.04),
                ],
                28,
                power=power,
            ),
            cover,
            (0, 0, height),
        )
        return Description(
            ("trash can", "bin", "waste bin", "container"), look, (detail(cover, "lid"),)
        )
    if a.chance(0.6):
        bail = a.look("metal", avoid=look)
        half = arc(0, 180, radius * 1.02, 13, plane="yz")
        lean = turn_about("y", a.uniform(-70, 10))
        a.add(tube(half, 0.02), bail, (0, 0, height - 0.05), lean)
        return Description(("bucket", "bucket", "pail"), look, ("a handle", detail(bail, "handle")))
    return Description(("bin", "waste bin", "bucket", "basket"), look)


FAMILIES = (
    lamp,
    lantern,
    chandelier,
    candle,
    clock,
    barrel,
    bucket,
)
