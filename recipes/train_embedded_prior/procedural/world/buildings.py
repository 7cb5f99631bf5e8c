"""Building families: houses, towers, tents and other small architecture."""

from __future__ import annotations

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import Assembly, Description, Look
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.primitives import box, cylinder, ellipsoid, prism
from recipes.train_embedded_prior.procedural.quads import Quads, join, turn_about
from recipes.train_embedded_prior.procedural.sweeps import revolve, rod

ROOF_COLORS = (
    "red",
    "dark red",
    "brown",
    "dark grey",
    "orange",
    "dark blue",
    "green",
    "grey",
    "black",
)
WALL_COLORS = (
    "white",
    "cream",
    "beige",
    "yellow",
    "light blue",
    "red",
    "light brown",
    "brown",
    "pink",
    "grey",
    "light grey",
    "green",
    "light green",
    "orange",
)


def gable(x: float, y: float, rise: float, over: float) -> Quads:
    """Return a saddle roof with its ridge along y, standing on z = 0."""
    slope = prism([(-0.5 * x - over, 0), (0.5 * x + over, 0), (0, rise)], y + 2 * over)
    return slope.moved([[1, 0, 0], [0, 0, -1], [0, 1, 0]], (0, 0.5 * y + over, 0))


def walls(a: Assembly) -> Look:
    """Draw a wall look: plastered, brick, wood or stone."""
    kind = a.integer(0, 3)
    if kind == 0:
        look = a.look("wooden")
    elif kind == 1:
        look = a.look("stone")
    else:
        look = a.look(colors=WALL_COLORS, patterns=("bricks",), pattern_chance=0.3)
        if look.material.pattern == "bricks":
            tone = (look.material.color * 0.55 + 0.3).astype(np.float32)
            look = brick(look, tone)
    return look


def brick(look: Look, mortar: np.ndarray) -> Look:
    """Return a brick look whose joints have a given colour; captions name one colour only."""
    material = type(look.material)(look.material.color, mortar, "bricks", 8.0)
    return Look(material, look.color, look.substance)


def tiled(a: Assembly, avoid: Look) -> Look:
    """Draw a roof look, often with rows of tiles."""
    look = a.look(colors=ROOF_COLORS, avoid=avoid)
    if a.chance(0.5):
        tone = (look.material.color * 0.6).astype(np.float32)
        material = type(look.material)(look.material.color, tone, "tiles", 8.0)
        return Look(material, look.color, look.substance)
    return look


def openings(
    a: Assembly,
    pane: Look,
    rim: Look,
    wall: tuple[np.ndarray, float],
    span: tuple[float, float],
    grid: tuple[int, int],
    door: Look | None,
) -> None:
    """Add windows (and a door in the middle of the lowest row) to a wall.

    Args:
        a: the assembly.
        pane: look of the panes.
        rim: look of the window frames.
        wall: its [3, 4] turn and position (local x is outward, y along it, z up), and its width.
        span: heights of the lowest sill and of the upper end of the top row.
        grid: windows in a row, and rows.
        door: look of the door, None = no door.
    """
    (face, width), (low, high), (columns, rows) = wall, span, grid
    step_y, step_z = width / columns, (high - low) / rows
    w, h = 0.5 * step_y, 0.6 * step_z
    turn, at = face[:, :3], face[:, 3]
    for row in range(rows):
        for column in range(columns):
            y, z = (column + 0.5) * step_y - 0.5 * width, low + (row + 0.2) * step_z
            if door is not None and row == 0 and column == columns // 2:
                tall = 0.85 * step_z + low
                part = box((0.06, min(w, 0.5 * tall) * 1.1, tall))
                a.add(part.moved(None, (0, y, 0)), door, at, turn)
                continue
            a.add(box((0.035, w * 1.25, h * 1.2)).moved(None, (0, y, z - 0.1 * h)), rim, at, turn)
            a.add(box((0.065, w, h)).moved(None, (0, y, z)), pane, at, turn)


def wall_frame(side: int, x: float, y: float) -> tuple[np.ndarray, float]:
    """Return the placement [3, 4] and the width of wall ``side`` (0 = +x, 1 = +y, ...)."""
    turn = turn_about("z", 90.0 * side)
    reach = 0.5 * (x if side % 2 == 0 else y)
    at = turn @ np.array([reach, 0, 0], np.float32)
    return np.concatenate([turn, at[:, None]], axis=1), (y if side % 2 == 0 else x)


def house(a: Assembly) -> Description:
    """A house with windows, door, roof and perhaps a chimney."""
    look = walls(a)
    roof, door = tiled(a, look), a.look("wooden", "painted", avoid=look)
    pane = a.look(
        "glass", colors=("light blue", "dark blue", "black", "yellow", "white"), avoid=look
    )
    rim = a.look(colors=("white", "brown", "cream", "dark brown"), avoid=look)
    x, y, height = a.uniform(0.5, 0.8), a.uniform(0.6, 1.1), a.uniform(0.4, 0.8)
    rows = 2 if height > 0.6 else 1
    a.add(box((x, y, height)), look)
    columns = a.integer(2, 3)
    for side in range(4):
        face, width = wall_frame(side, x, y)
        has_door = door if side == 0 else None
        count = 3 if side == 0 and rows == 1 else columns
        wall = (face, 0.9 * width)
        openings(a, pane, rim, wall, (0.1, height * 0.95), (count, rows), has_door)
    rise, over = a.uniform(0.2, 0.5), a.uniform(0.03, 0.1)
    kind = a.choose(["gable", "gable", "gable", "hip", "flat"])
    if kind == "gable":
        a.add(gable(x, y, rise, 0.0), look, (0, 0, height - 0.01))
        top = gable(x, y, rise * 1.04, over)
        a.add(top, roof, (0, 0, height))
    elif kind == "hip":
        a.add(
            box((x + 2 * over, y + 2 * over, rise), taper=(0.02, a.uniform(0.02, 0.5))),
            roof,
            (0, 0, height),
        )
    else:
        a.add(box((x + 2 * over, y + 2 * over, 0.07)), roof, (0, 0, height))
    details = [detail(roof, "roof"), detail(door, "door"), "windows"]
    if a.chance(0.5) and kind != "flat":
        chimney = a.look("stone", colors=("dark red", "grey", "brown", "white"), avoid=roof)
        a.add(box((0.1, 0.12, rise + 0.12)), chimney, (0.2 * x, 0.25 * y, height + 0.05))
        details.append("a chimney")
    if a.chance(0.25):
        a.add(box((0.5 * x, 0.45 * y, 0.6 * height)), look, (0.1, 0.6 * y, 0))
        a.add(gable(0.5 * x, 0.45 * y, 0.5 * rise, 0.04), roof, (0.1, 0.6 * y, 0.6 * height))
    if a.chance(0.3):
        a.add(box((x + 0.5, y + 0.5, 0.04)), a.look("leafy"), (0, 0, -0.04))
    return Description(
        ("house", "house", "cottage", "toy house", "building", "home"), look, tuple(details)
    )


def tower_block(a: Assembly) -> Description:
    """A tall building with rows of windows."""
    look = a.look("stone", "metal", "plain", colors=(*WALL_COLORS, "dark grey", "blue"))
    pane = a.look("glass", colors=("light blue", "dark blue", "black", "blue"), avoid=look)
    x, y, height = a.uniform(0.3, 0.45), a.uniform(0.3, 0.5), a.uniform(0.9, 1.4)
    rows, columns = a.integer(4, 8), a.integer(2, 4)
    a.add(box((x, y, height)), look)
    for side in range(4):
        face, width = wall_frame(side, x, y)
        wall = (face, 0.92 * width)
        openings(a, pane, look, wall, (0.06, height * 0.97), (columns, rows), None)
    a.add(box((x * 0.5, y * 0.5, 0.08)), look, (0, 0, height))
    return Description(
        ("skyscraper", "building", "tower", "office building"),
        look,
        ("windows", detail(pane, "windows", plural=True)),
        ("tall",),
    )


def castle(a: Assembly) -> Description:
    """A tower, or a castle with four towers."""
    look = a.look("stone", "stone", "plain")
    if a.chance(0.6):
        material = type(look.material)(
            look.material.color, (look.material.color * 0.7), "bricks", 8.0
        )
        look = Look(material, look.color, look.substance)
    roof = tiled(a, look)
    dark = a.look(colors=("black", "dark brown", "dark grey"))
    single = a.chance(0.45)
    spire = a.chance(0.5)

    def tower(radius: float, height: float, at: tuple[float, float]) -> None:
        shaft = [
            (0, 0),
            (radius * 1.1, 0),
            (radius, 0.2 * height),
            (radius, 0.8 * height),
            (radius * 1.2, 0.85 * height),
            (radius * 1.2, height),
            (0, height),
        ]
        parts = [revolve(shaft, 20)]
        if not spire:
            part = box((0.3 * radius, 0.35 * radius, 0.3 * radius))
            for k in range(8):
                ring = part.moved(None, (radius * 1.05, 0, height)).moved(
                    turn_about("z", 45.0 * k), (0, 0, 0)
                )
                parts.append(ring)
        a.add(join(parts), look, (*at, 0))
        if spire:
            a.add(revolve([(radius * 1.35, 0), (0, radius * 2.6)], 20), roof, (*at, height))
        for k in range(3):
            window = box((0.05, 0.3 * radius, 0.5 * radius)).moved(None, (radius, 0, 0.35 * height))
            a.add(window.moved(turn_about("z", 120.0 * k), (*at, 0.1 * k)), dark)

    if single:
        tower(0.22, a.uniform(0.8, 1.1), (0.0, 0.0))
        nouns = ("tower", "castle tower", "stone tower")
    else:
        half, height = a.uniform(0.35, 0.45), a.uniform(0.35, 0.5)
        for sx in (-1, 1):
            for sy in (-1, 1):
                tower(0.13, height * a.uniform(1.35, 1.5), (sx * half, sy * half))
        for side in range(4):
            turn = turn_about("z", 90.0 * side)
            a.add(box((0.08, 2 * half, height)).moved(None, (half, 0, 0)), look, turn=turn)
            for k in range(5):
                merlon = box((0.08, 0.07, 0.06)).moved(None, (half, (k - 2) * 0.13, height))
                a.add(merlon, look, turn=turn)
        a.add(box((0.1, 0.2, 0.28)), dark, (half, 0, 0))
        if a.chance(0.6):
            a.add(box((0.4, 0.4, height * 1.5)), look)
            a.add(box((0.46, 0.46, 0.3), taper=(0.02, 0.02)), roof, (0, 0, height * 1.5))
        nouns = ("castle", "castle", "toy castle", "stone castle")
    return Description(nouns, look, (detail(roof, "roof"),) if spire else ("battlements",))


def lighthouse(a: Assembly) -> Description:
    """A lighthouse or windmill: a tapering round tower with a top."""
    look = a.look(
        "stone",
        "plain",
        colors=("white", "red", "cream", "grey", "brown", "beige"),
        patterns=("bands",),
        pattern_chance=0.6,
    )
    cap = a.look(colors=ROOF_COLORS, avoid=look)
    low, high, height = a.uniform(0.24, 0.32), a.uniform(0.13, 0.2), a.uniform(0.8, 1.1)
    segments = a.choose([24, 24, 8])
    a.add(cylinder(low, height, high, segments), look)
    door = a.look("wooden")
    a.add(box((0.06, 0.13, 0.2)), door, (low * 0.96, 0, 0))
    if a.chance(0.5):
        a.add(cylinder(high * 1.35, 0.04), cap, (0, 0, height))
        a.add(
            cylinder(high * 0.7, 0.16),
            a.look("glass", colors=("yellow", "light blue", "cream")),
            (0, 0, height + 0.04),
        )
        a.add(revolve([(high, 0), (0, 0.16)], segments), cap, (0, 0, height + 0.2))
        return Description(
            ("lighthouse", "tower", "lighthouse"), look, (detail(cap, "top"),), ("tall",)
        )
    a.add(revolve([(high * 1.15, 0), (high * 0.8, 0.14), (0, 0.22)], segments), cap, (0, 0, height))
    sail = a.look("wooden", "fabric", avoid=look)
    angle = a.uniform(0, 90)
    for k in range(4):
        blade = join(
            [box((0.02, 0.03, 0.5)), box((0.015, 0.14, 0.36)).moved(None, (0, 0.07, 0.13))]
        )
        a.add(blade, sail, (high + 0.08, 0, height + 0.02), turn_about("x", angle + 90.0 * k))
    a.add(rod((0, 0, height + 0.02), (high + 0.12, 0, height + 0.02), 0.03), sail)
    return Description(("windmill", "tower", "windmill"), look, ("four arms", detail(cap, "roof")))


def tent(a: Assembly) -> Description:
    """A ridge tent, a round tent or a pyramid."""
    look = a.look("fabric", patterns=("stripes", "bands", "diagonal"), pattern_chance=0.4)
    kind = a.choose(["ridge", "round", "pyramid"])
    if kind == "ridge":
        x, y, rise = a.uniform(0.7, 1.0), a.uniform(0.8, 1.2), a.uniform(0.5, 0.8)
        a.add(gable(x, y, rise, 0), look)
        dark = a.look(colors=("black", "dark grey", "dark brown", "cream"), avoid=look)
        door = prism([(-0.2 * x, 0), (0.2 * x, 0), (0, 0.75 * rise)], 0.02)
        a.add(door, dark, (0, 0.5 * y + 0.01, 0), [[-1, 0, 0], [0, 0, 1], [0, 1, 0]])
        return Description(("tent", "tent"), look, ("an open door",))
    if kind == "pyramid":
        stone = a.look("stone")
        levels = a.integer(1, 6)
        if levels == 1:
            a.add(box((1, 1, a.uniform(0.5, 0.8)), taper=(0.01, 0.01)), stone)
        else:
            for k in range(levels):
                size = 1.0 - k / levels
                a.add(box((size, size, 0.6 / levels)), stone, (0, 0, 0.6 * k / levels))
        return Description(("pyramid", "temple", "stone pyramid"), stone)
    radius, height = 0.5, a.uniform(0.25, 0.45)
    a.add(cylinder(radius, height, segments=a.choose([24, 8, 12])), look)
    top = look if a.chance(0.5) else a.look("fabric", avoid=look)
    a.add(
        revolve([(radius * 1.08, 0), (0.25, 0.3), (0, a.uniform(0.45, 0.6))], 24),
        top,
        (0, 0, height),
    )
    flag = a.look("fabric")
    a.add(rod((0, 0, height + 0.4), (0, 0, height + 0.75), 0.012), flag)
    a.add(box((0.01, 0.15, 0.1)), flag, (0, 0.08, height + 0.64))
    a.add(ellipsoid((0.02, 0.02, 0.02)), flag, (0, 0, height + 0.76))
    return Description(("tent", "round tent", "fabric tent"), look, ("a flag", detail(top, "roof")))


def column(a: Assembly) -> Description:
    """A column, monument, well or fountain of stone."""
    look = a.look("stone", "marble", "stone")
    kind = a.choose(["column", "fountain", "well", "obelisk"])
    if kind == "column":
        height, radius = a.uniform(0.8, 1.2), a.uniform(0.1, 0.17)
        a.add(box((radius * 3, radius * 3, 0.08)), look)
        flutes = a.choose([0, 12, 16])
        a.add(
            revolve(
                [(0, 0), (radius, 0), (radius * 0.85, height)], 48, lobes=flutes, lobe_depth=0.08
            ),
            look,
            (0, 0, 0.08),
        )
        a.add(cylinder(radius, 0.08, radius * 1.4), look, (0, 0, height + 0.06))
        a.add(box((radius * 3, radius * 3, 0.06)), look, (0, 0, height + 0.14))
        return Description(("column", "pillar", "stone column"), look, ("a base",), ("tall",))
    if kind == "obelisk":
        a.add(box((0.45, 0.45, 0.12)), look)
        a.add(box((0.28, 0.28, 0.9), taper=(0.65, 0.65)), look, (0, 0, 0.12))
        a.add(box((0.19, 0.19, 0.12), taper=(0.02, 0.02)), look, (0, 0, 1.01))
        return Description(("obelisk", "monument", "column"), look, ("a base",), ("tall",))
    wall = revolve(
        [(0, 0), (0.5, 0), (0.5, 0.3), (0.42, 0.3), (0.42, 0.08), (0, 0.08)], a.choose([24, 8])
    )
    a.add(wall, brick(look, look.material.color * np.float32(0.7)))
    if kind == "well":
        wood, roof = a.look("wooden"), tiled(a, look)
        a.add_mirrored(box((0.06, 0.06, 0.75)), wood, (0, 0.46, 0))
        a.add(gable(0.7, 1.0, 0.3, 0.03), roof, (0, 0, 0.75))
        a.add(rod((0, -0.46, 0.6), (0, 0.46, 0.6), 0.03), wood)
        return Description(("well", "water well", "stone well"), look, (detail(roof, "roof"),))
    water = a.look(colors=("light blue", "blue", "turquoise"))
    a.add(revolve([(0.42, 0), (0, 0)], 24), water, (0, 0, 0.22))
    a.add(cylinder(0.08, 0.5, 0.05), look)
    a.add(revolve([(0.05, 0), (0.26, 0.1), (0.22, 0.1), (0, 0.04)], 24), look, (0, 0, 0.5))
    a.add(revolve([(0.22, 0), (0, 0)], 24), water, (0, 0, 0.59))
    a.add(ellipsoid((0.06, 0.06, 0.1)), look, (0, 0, 0.66))
    return Description(("fountain", "stone fountain", "water fountain"), look, ("water",))


FAMILIES = (house, tower_block, castle, lighthouse, tent, column)
