"""Kitchen families: cups, bottles, bowls, vases, plates and pots to pour from.

Every family is a function of an ``Assembly`` that adds parts and returns a ``Description``.
"""

from __future__ import annotations

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    DECORATIONS,
    Assembly,
    Description,
    Look,
)
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.materials import Mark
from recipes.train_embedded_prior.procedural.primitives import cylinder, ellipsoid
from recipes.train_embedded_prior.procedural.quads import turn_about
from recipes.train_embedded_prior.procedural.sweeps import (
    arc,
    revolve,
    rod,
    shell_profile,
    smooth_profile,
    tube,
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
        knots = [
            (0, 0, low),
            (reach, 0, low + (0.1 if style == 1 else 0.3) * height),
            (reach * a.uniform(0.8, 1.1), 0, high - 0.1 * height),
            (0, 0, high),
        ]
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
        label = Mark(
            (0, 0, 0.5 * height),
            (0, a.choose([-1, 1]), 0.0),
            (0.5 * radius, a.uniform(0.15, 0.3) * height),
            a.look(avoid=look).material.color,
            a.choose(["disc", "star", "label", "ring"]),
        )
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
    return Description(
        nouns, look, tuple(details), ("tall",) if height > 2.2 * radius else ("wide",)
    )


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
    return Description(
        ("cup", "tumbler", "paper cup", "drinking cup", "beaker"), look, tuple(details)
    )


def bottle(a: Assembly) -> Description:
    """A bottle with cap and perhaps a label."""
    look = a.look(
        "glass", "plastic", "plastic", "metal", "ceramic", patterns=DECORATIONS, pattern_chance=0.25
    )
    radius, body = a.uniform(0.16, 0.32), a.uniform(0.45, 0.75)
    neck, neck_height = radius * a.uniform(0.3, 0.6), a.uniform(0.08, 0.3)
    shoulder = a.uniform(0.08, 0.3)
    knots = [
        (radius, 0.0),
        (radius, body),
        (radius * 0.85, body + 0.5 * shoulder),
        (neck, body + shoulder),
        (neck, body + shoulder + neck_height),
    ]
    outer = (
        np.array(knots)
        if a.chance(0.3)
        else np.concatenate([[(radius * 0.9, 0), (radius, 0.04)], smooth_profile(knots[1:], 12)])
    )
    if a.chance(0.2):
        waist = radius * a.uniform(0.75, 0.9)
        outer = np.concatenate(
            [
                [(radius, 0), (radius, 0.3 * body), (waist, 0.5 * body), (radius, 0.7 * body)],
                smooth_profile(knots[1:], 10),
            ]
        )
    power = a.choose([2.0, 2.0, 2.0, 5.0])
    details = []
    if a.chance(0.55):
        label = a.look("paper", avoid=look)
        band = revolve(
            [(radius * 1.015, body * 0.25), (radius * 1.015, body * 0.8)], 24, power=power
        )
        tone = label.marked(side_label(a, radius, 0.52 * body, 0.35 * body, label))
        a.add(band, tone if a.chance(0.7) else label)
        details.append(detail(label, "label"))
    a.add(revolve(np.concatenate([[(0, 0)], outer]), 24, power=power), look)
    top = body + shoulder + neck_height
    cap = a.look("plastic", "metal", avoid=look)
    a.add(cylinder(neck * a.uniform(1.1, 1.4), a.uniform(0.05, 0.14)), cap, (0, 0, top - 0.02))
    details.append(detail(cap, "cap"))
    nouns = (
        "bottle",
        "bottle",
        "water bottle",
        "wine bottle",
        "juice bottle",
        "soda bottle",
        "flask",
    )
    return Description(nouns, look, tuple(details), ("tall",) if top > 4 * radius else ("short",))


def bowl(a: Assembly) -> Description:
    """An open bowl, ramekin or dish."""
    look = a.look(
        "ceramic", "porcelain", "wooden", "metal", "plastic", "clay", patterns=DECORATIONS
    )
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
    look = a.look(
        "ceramic",
        "porcelain",
        "plastic",
        patterns=("stripes", "dots", "patches"),
        pattern_chance=0.2,
    )
    rise, foot = a.uniform(0.04, 0.14), a.uniform(0.25, 0.36)
    outer = [(foot, 0), (0.38, 0.3 * rise), (0.5, rise)]
    segments = a.choose([32, 32, 32, 4, 8])
    inner_edge = a.uniform(0.3, 0.4)
    profile = [
        (0, 0),
        *outer,
        (0.49, rise + 0.02),
        (inner_edge, 0.45 * rise),
        (foot, 0.03),
        (0, 0.03),
    ]
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
    knots = [
        (radius * 0.6, 0),
        (radius, 0.4 * height),
        (0.85 * radius, 0.75 * height),
        (top, height),
    ]
    a.add(revolve(np.concatenate([[(0, 0)], smooth_profile(knots, 14)]), 28), look)
    lid = look if a.chance(0.6) else a.look("ceramic", avoid=look)
    dome = a.uniform(0.06, 0.16)
    cap = [(top * 1.05, 0), (0.8 * top, 0.6 * dome), (0.3 * top, dome), (0, dome)]
    a.add(revolve(cap, 24), lid, (0, 0, height))
    knob = a.uniform(0.04, 0.075)
    a.add(ellipsoid((knob, knob, knob)), lid, (0, 0, height + dome + 0.7 * knob))
    start, reach = radius * 0.75, radius + a.uniform(0.25, 0.4)
    spout = smooth_profile(
        [
            (start, 0, 0.3 * height),
            (reach - 0.1, 0, 0.45 * height),
            (reach, 0, height * a.uniform(0.85, 1.05)),
        ],
        9,
    )
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
    corners[..., 0] *= 1 + a.uniform(0.3, 0.7) * lip * (
        1 - np.abs(corners[..., 1]) / (neck * 1.4)
    ).clip(0)
    a.add(type(part)(corners, part.uv, None), look)
    ear(a, neck + 0.02, 0.3, 0.92, look, a.uniform(0.22, 0.34), 180)
    return Description(("jug", "pitcher", "water jug", "milk jug", "carafe"), look, ("a handle",))


FAMILIES = (
    mug,
    tumbler,
    bottle,
    bowl,
    vase,
    plate,
    teapot,
    jug,
)
