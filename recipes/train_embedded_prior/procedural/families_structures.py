"""Structures put together at random: seats, tables, racks, cases and figures of blocks.

``families_furniture`` and its like build the usual chair; here supports, tops, backs and arms come
in any combination and proportion, so that what is learned is how such parts continue each other.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    DECORATIONS,
    Assembly,
    Description,
    Look,
)
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.families_abstract import any_look, any_part
from recipes.train_embedded_prior.procedural.families_furniture import (
    chair_back,
    cushion,
    four_legs,
    pedestal,
)
from recipes.train_embedded_prior.procedural.primitives import (
    box,
    cylinder,
    ellipsoid,
    prism,
    regular_polygon,
    tray,
)
from recipes.train_embedded_prior.procedural.quads import Quads, turn_about
from recipes.train_embedded_prior.procedural.sweeps import (
    arc,
    ribbon,
    rod,
    smooth_profile,
    tube,
)


def sled(a: Assembly, look: Look, x: float, y: float, z: float) -> None:
    """Add runners: bars on the floor, bent up to the top at both ends or at one."""
    radius = a.uniform(0.012, 0.035)
    front, back = x + a.uniform(-0.05, 0.15), -x - a.uniform(-0.05, 0.15)
    foot, top = y + a.uniform(-0.1, 0.1), y * a.uniform(0.75, 1.0)
    points = [(0.8 * x, top, z), (front, foot, radius), (back, foot, radius), (-0.8 * x, top, z)]
    kept = a.choose([(0, 4), (0, 4), (0, 3), (1, 4)])
    path = points[kept[0] : kept[1]]
    for start, end in itertools.pairwise(path):
        a.add_mirrored(rod(start, end, radius), look, (0, 0, 0))
    for corner in (front, back):
        if a.chance(0.5):
            a.add(rod((corner, -foot, radius), (corner, foot, radius), radius), look)


def trestle(a: Assembly, look: Look, x: float, y: float, z: float) -> None:
    """Add two supports shaped like an A, a T or an X, and a bar between them."""
    thick, at = a.uniform(0.02, 0.05), y * a.uniform(0.6, 0.95)
    kind = a.choose(["A", "T", "X"])
    top = {"A": 0.0, "T": 0.0, "X": -x}[kind]
    if kind == "T":
        a.add_mirrored(box((0.9 * x, thick, z)), look, (0, at, 0))
        a.add_mirrored(box((2 * x, thick, 0.06)), look, (0, at, 0))
    else:
        for end in (-1.0, 1.0):
            a.add_mirrored(rod((end * x, at, 0), (end * top, at, z), thick), look, (0, 0, 0))
    height = a.uniform(0.2, 0.6) * z
    a.add(rod((0, -at, height), (0, at, height), 0.7 * thick), look)


def supports(a: Assembly, look: Look, x: float, y: float, z: float) -> None:
    """Put a top of half size (x, y) at height z on something."""
    kind = a.choose(["legs", "legs", "sled", "sled", "trestle", "boards", "pedestal", "plinth"])
    if kind == "legs":
        four_legs(a, look, x, y, z)
        for end in (-0.8, 0.8):
            if a.chance(0.3):
                height = a.uniform(0.15, 0.8) * z
                a.add(rod((end * x, -0.9 * y, height), (end * x, 0.9 * y, height), 0.018), look)
    elif kind == "sled":
        sled(a, look, x, y, z)
    elif kind == "trestle":
        trestle(a, look, x, y, z)
    elif kind == "boards":
        depth = 2 * x * a.uniform(0.4, 1.0)
        a.add_mirrored(box((depth, 0.04, z)), look, (0, y * a.uniform(0.6, 0.97), 0))
        if a.chance(0.5):
            a.add(box((0.03, 1.8 * y, z * a.uniform(0.3, 1.0))), look, (-0.9 * x, 0, 0))
    elif kind == "pedestal":
        pedestal(a, look, z, min(x, y) * a.uniform(0.7, 1.2))
    else:
        a.add(box((1.8 * x, 1.8 * y, z)), look)


def bent_seat(a: Assembly, look: Look, x: float, y: float, z: float) -> None:
    """Add seat and back as one bent board."""
    height, lean, thick = a.uniform(0.2, 0.8), a.uniform(0.02, 0.2), a.uniform(0.02, 0.08)
    knots = [(x, z - a.uniform(0, 0.06)), (0.2 * x, z), (-x, z), (-x - lean, z + height)]
    line = smooth_profile(knots, 16) if a.chance(0.7) else np.array(knots)
    path = np.stack([line[:, 0], np.zeros(len(line)), line[:, 1]], axis=1)
    a.add(ribbon(path, (0, 1, 0), 2 * y * a.uniform(0.8, 1.0), thick), look)


def wrapped_back(a: Assembly, look: Look, x: float, y: float, z: float) -> None:
    """Add a back that bends round the sides, as of a tub chair."""
    height, thick = a.uniform(0.2, 0.6), a.uniform(0.03, 0.12)
    reach = math.radians(a.uniform(60, 125))
    angle = np.linspace(math.pi - reach, math.pi + reach, 17)
    heights = np.full(17, z + 0.5 * height - 0.04)
    path = np.stack([1.05 * x * np.cos(angle), 1.05 * y * np.sin(angle), heights], axis=1)
    a.add(ribbon(path, (0, 0, 1), height, thick), look)


def arms(a: Assembly, look: Look, frame: Look, x: float, y: float, z: float) -> None:
    """Add arm rests: pads, boards or loops."""
    rise, kind = a.uniform(0.12, 0.3), a.choose(["pads", "boards", "loops"])
    if kind == "pads":
        pad = cushion(2 * x * a.uniform(0.7, 1.0), a.uniform(0.06, 0.2), rise + 0.1)
        a.add_mirrored(pad, look, (0, y, z - 0.1))
    elif kind == "boards":
        a.add_mirrored(box((1.8 * x, 0.06, 0.035)), frame, (0, y, z + rise))
        a.add_mirrored(rod((0.7 * x, y, z), (0.7 * x, y, z + rise), 0.02), frame, (0, 0, 0))
    else:
        loop = arc(0, 180, rise) * np.array([0.9 * x / rise, 1, 1]) + np.array([0, y, z])
        a.add_mirrored(tube(loop, 0.02), frame, (0, 0, 0))


def tops(a: Assembly, look: Look, x: float, y: float, z: float) -> None:
    """Add a top: board, pad, disc, slats or tray."""
    kind, thick = a.choose(["board", "board", "pad", "disc", "slats", "tray"]), a.uniform(0.02, 0.1)
    if kind == "disc":
        round_top = cylinder(1.0, thick).stretched(x, y, 1.0)
        a.add(round_top, look, (0, 0, z))
    elif kind == "pad":
        a.add(cushion(2 * x, 2 * y, 2 * thick), look, (0, 0, z - 0.02))
    elif kind == "tray":
        a.add(tray((2 * x, 2 * y, 2 * thick), 0.02), look, (0, 0, z))
    elif kind == "slats":
        count = a.integer(4, 7)
        for k in range(count):
            at = (2 * (k + 0.5) / count - 1) * x
            a.add(box((1.3 * x / count, 2 * y, 0.03)), look, (at, 0, z))
    else:
        a.add(box((2 * x, 2 * y, thick)), look, (0, 0, z))


def carpentry(a: Assembly) -> Description:
    """A seat, table or rack of any supports, tops, back and arms."""
    look = a.look(
        "wooden", "wooden", "metal", "plastic", "fabric", "leather", "glass", "marble",
        patterns=DECORATIONS, pattern_chance=0.1,
    )  # fmt: skip
    frame = look if a.chance(0.4) else a.look("wooden", "metal", "plastic", avoid=look)
    x, y, z = a.uniform(0.2, 0.4), a.uniform(0.2, 0.65), a.uniform(0.15, 0.9)
    supports(a, frame, x, y, z)
    kind = a.choose(["back", "bent", "wrapped", "none", "none"])
    if kind == "bent":
        bent_seat(a, look, x, y, z)
    else:
        tops(a, look, x, y, z)
    if kind == "back":
        chair_back(a, look, frame, 2 * x, 2 * y * a.uniform(0.5, 1.0), z + 0.04)
    if kind == "wrapped":
        wrapped_back(a, look, x, y, z)
    if kind != "none" and a.chance(0.35):
        arms(a, look, frame, x, y, z)
    if kind == "none":
        level = z
        for _ in range(a.integer(0, 3)):
            level += a.uniform(0.12, 0.4)
            a.add_mirrored(
                rod((0.8 * x, 0.9 * y, 0), (0.8 * x, 0.9 * y, level), 0.02), frame, (0, 0, 0)
            )
            a.add_mirrored(
                rod((-0.8 * x, 0.9 * y, 0), (-0.8 * x, 0.9 * y, level), 0.02), frame, (0, 0, 0)
            )
            tops(a, look, x, y, level)
    if a.chance(0.25):
        a.add(box((1.7 * x, 1.7 * y, 0.03)), look, (0, 0, z * a.uniform(0.15, 0.7)))
    if a.chance(0.15):
        a.add(any_part(a, 0.1), any_look(a, look), (0, a.uniform(-0.5, 0.5) * y, z + 0.1))
    details = () if frame is look else (detail(frame, "legs", plural=True),)
    nouns = ("table", "rack", "shelf", "stool", "bench") if kind == "none" else ("chair", "seat")
    return Description(nouns, look, details)


def upholstery(a: Assembly) -> Description:
    """Padded seats in a row, around a corner or around two, fat or thin, on low or high legs."""
    look = a.look(
        "fabric", "fabric", "leather", patterns=("stripes", "checks", "dots"), pattern_chance=0.1
    )
    frame = a.look("wooden", "metal", avoid=look)
    plan = a.choose(["one", "one", "row", "corner", "corner", "horseshoe"])
    long = a.integer(2, 4)
    cells = {
        "one": [(0, 0)],
        "row": [(0, k) for k in range(long)],
        "corner": [(0, k) for k in range(long)] + [(k, 0) for k in range(1, a.integer(2, 3))],
        "horseshoe": [(0, k) for k in range(long)]
        + [(k, end) for k in range(1, a.integer(2, 3)) for end in (0, long - 1)],
    }[plan]
    unit, leg, seat = a.uniform(0.45, 0.7), a.uniform(0.03, 0.4), a.uniform(0.08, 0.3)
    back, thick = a.uniform(0.2, 0.7), a.uniform(0.05, 0.22)
    pads = look if a.chance(0.7) else a.look("fabric", avoid=look)
    arm_chance = a.choose([0.0, 0.9])
    for row, column in cells:
        x, y = row * unit, column * unit
        a.add(box((unit, unit, 0.6 * seat)), look, (x, y, leg))
        a.add(cushion(0.97 * unit, 0.97 * unit, 0.7 * seat), pads, (x, y, leg + 0.4 * seat))
        for dx in (-0.4, 0.4):
            for dy in (-0.4, 0.4):
                at = (x + dx * unit, y + dy * unit)
                a.add(rod((*at, 0), (*at, leg), 0.025), frame)
        outer = (-0.5 * unit + 0.5 * thick, 0, leg)
        if row == 0:
            a.add(cushion(thick, unit, seat + back), look, (x + outer[0], y, leg))
        elif column == 0 or column == long - 1:
            side = -1.0 if column == 0 else 1.0
            a.add(cushion(unit, thick, seat + back), look, (x, y - side * outer[0], leg))
        ends = [e for e in (-1, 1) if (row, column + e) not in cells and row == 0]
        for end in ends:
            if a.chance(arm_chance):
                pad = cushion(unit, 0.6 * thick + 0.04, seat + a.uniform(0.1, 0.25))
                a.add(pad, look, (x, y + 0.5 * end * unit, leg))
    single = len(cells) == 1
    nouns = ("armchair", "lounge chair", "seat") if single else ("sofa", "couch", "corner sofa")
    return Description(nouns, look, (detail(frame, "legs", plural=True), "cushions"))


def case(a: Assembly) -> Description:
    """A machine, appliance or tool: bodies with panels, handles, feet and things on them."""
    look = a.look("plastic", "metal", "wooden", "plain", patterns=DECORATIONS, pattern_chance=0.1)
    second = any_look(a, look)
    x, y, z = a.uniform(0.15, 0.5), a.uniform(0.15, 0.5), a.uniform(0.15, 0.9)
    a.add(_body(a, x, y, z), look)
    if a.chance(0.5):
        top = _body(a, x * a.uniform(0.3, 1.0), y * a.uniform(0.3, 1.0), a.uniform(0.05, 0.4))
        a.add(top, look if a.chance(0.5) else second, (a.uniform(-0.5, 0.5) * x, 0, 0.98 * z))
    if a.chance(0.3):
        _jaw(a, look, second, x, y, z)
    if a.chance(0.5):
        rows, columns = a.integer(1, 4), a.integer(1, 2)
        for k in range(rows):
            for n in range(columns):
                at = ((n + 0.5) / columns * 2 - 1) * y
                panel = box((0.03, 1.8 * y / columns, 0.85 * z / rows))
                a.add(panel, second, (x, at, (k + 0.08) * z / rows))
                if a.chance(0.7):
                    a.add(box((0.05, 0.03, 0.2 * z)), second, (x + 0.03, at * 0.6, k * z / rows))
    if a.chance(0.35):
        handle = arc(0, 180, 1.0) * np.array([0.7 * x, 1, a.uniform(0.08, 0.25)])
        a.add(tube(handle, a.uniform(0.015, 0.04)), second, (0, 0, z))
    if a.chance(0.35):
        a.add_mirrored(any_part(a, a.uniform(0.06, 0.18)), second, (0, y, z * a.uniform(0.2, 1)))
    if a.chance(0.3):
        a.add(rod((0.8 * x, 0, 0.6 * z), (x + 0.3, 0, a.uniform(0.3, 1.0) * z), 0.05, 0.03), second)
    if a.chance(0.4):
        foot = a.uniform(0.03, 0.12)
        wheel = cylinder(foot, 0.05).moved(turn_about("x", 90), (0, 0.05, 0))
        for end in (-0.8, 0.8):
            a.add_mirrored(wheel, second, (end * x, 0.9 * y, 0))
    details = (f"{second.color} parts",)
    return Description(("machine", "unit", "cabinet", "box", "toy", "thing"), look, details)


def _body(a: Assembly, x: float, y: float, z: float) -> Quads:
    """Return a solid of half size (x, y) that stands on z = 0."""
    kind = a.integer(0, 4)
    if kind == 0:
        return box((2 * x, 2 * y, z), taper=(a.uniform(0.5, 1.0), a.uniform(0.5, 1.0)))
    if kind == 1:
        round_box = ellipsoid((x, y, 0.5 * z), roundness=(a.uniform(0.1, 0.6), a.uniform(0.1, 1)))
        return round_box.moved(None, (0, 0, 0.5 * z))
    if kind == 2:
        lying = cylinder(0.5 * z, 2 * y).moved(turn_about("x", 90), (0, y, 0.5 * z))
        return lying.stretched(2 * x / z, 1.0, 1.0)
    if kind == 3:
        return prism(regular_polygon(a.integer(5, 9), 1.0), z).stretched(x, y, 1.0)
    return box((2 * x, 2 * y, z))


def _jaw(a: Assembly, look: Look, second: Look, x: float, y: float, z: float) -> None:
    """Add a long arm hinged behind, above the body, as of a stapler, a press or a lid."""
    length, open_deg = x * a.uniform(1.4, 2.2), a.uniform(0, 40)
    thick = a.uniform(0.04, 0.15)
    arm = box((length, 2 * y * a.uniform(0.5, 1.0), thick), taper=(a.uniform(0.6, 1), 1))
    arm = arm.moved(None, (0.5 * length, 0, 0)).moved(turn_about("y", -open_deg), (-x, 0, z + 0.02))
    a.add(arm, look if a.chance(0.6) else second)
    hinge = cylinder(0.5 * thick + 0.03, 2.1 * y).moved(turn_about("x", 90), (-x, 1.05 * y, z))
    a.add(hinge, second)


def lattice(a: Assembly) -> Description:
    """A figure of blocks on a lattice, as in voxel games, with a few that are not mirrored."""
    looks = [any_look(a)]
    looks += [any_look(a, looks[0]) for _ in range(a.integer(1, 3))]
    height = 0
    for _ in range(a.integer(3, 6)):
        low = max(0, height - a.integer(0, 2))
        size = (a.integer(1, 5), a.integer(1, 4), a.integer(1, 5))
        at = (float(a.integer(-1, 1)), 0.0, float(low))
        a.add(box((size[0], 2 * size[1], size[2])), a.choose(looks), at)
        height = low + size[2]
    for _ in range(a.integer(2, 6)):
        size = (a.integer(1, 3), a.integer(1, 3), a.integer(1, 5))
        at = (float(a.integer(-3, 3)), float(a.integer(2, 4)), float(a.integer(0, max(height, 1))))
        if a.chance(0.75):
            a.add_mirrored(box(size), a.choose(looks), at)
        else:
            a.add(box(size), a.choose(looks), at)
    details = (f"{looks[-1].color} parts",)
    return Description(("toy", "character", "figure", "thing", "knight"), looks[0], details)


FAMILIES = (carpentry, upholstery, case, lattice)
