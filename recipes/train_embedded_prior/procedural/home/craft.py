"""Craft families: what flies or floats, and carts. The front looks along +x."""

from __future__ import annotations

import numpy as np

from recipes.train_embedded_prior.procedural.assembly import (
    Assembly,
    Description,
)
from recipes.train_embedded_prior.procedural.captions import detail
from recipes.train_embedded_prior.procedural.primitives import box, cylinder, ellipsoid, prism
from recipes.train_embedded_prior.procedural.quads import join, turn_about
from recipes.train_embedded_prior.procedural.sweeps import loft, revolve, rod, smooth_profile, torus
from recipes.train_embedded_prior.procedural.world.vehicles import (
    PAINTS,
    SIDEWAYS,
    ring_of,
    wheels,
    wing,
)


def plane(a: Assembly) -> Description:
    """An aeroplane: jet, propeller plane or biplane."""
    look = a.look(
        "metal",
        "plastic",
        "painted",
        "wooden",
        colors=PAINTS,
        patterns=("bands", "stripes"),
        pattern_chance=0.12,
    )
    trim = look if a.chance(0.3) else a.look("painted", avoid=look)
    r, jet = a.uniform(0.07, 0.12), a.chance(0.5)
    xs = np.array([0.5, 0.46, 0.36, 0.1, -0.2, -0.42, -0.52])
    size = np.array([0.1, 0.55, 0.9, 1.0, 0.95, 0.5, 0.22]) * r
    lift = np.array([0, 0, 0, 0, 0.1, 0.4, 0.55]) * r
    sections = np.stack([ring_of(x, s, s, z, 2.0) for x, s, z in zip(xs, size, lift, strict=True)])
    a.add(loft(sections[::-1]), look)
    sweep, span = (a.uniform(0.12, 0.3) if jet else a.uniform(0, 0.05)), a.uniform(0.42, 0.6)
    part = wing(a.uniform(0.2, 0.3), a.uniform(0.07, 0.2), span, sweep, 0.03)
    height = a.choose([-0.6, 0.0, 0.8]) * r
    a.add_mirrored(part, trim, (0.08, 0, height))
    if not jet and a.chance(0.35):
        a.add_mirrored(part, trim, (0.08, 0, height + 0.22))
        a.add_mirrored(
            rod((0.08, 0.6 * span, height), (0.08, 0.6 * span, height + 0.22), 0.012),
            trim,
            (0, 0, 0),
        )
    a.add_mirrored(wing(0.12, 0.07, 0.2, 0.3 * sweep + 0.02, 0.02), trim, (-0.44, 0, 0.5 * r))
    fin = prism([(0.08, 0), (-0.05, 0.2), (-0.12, 0.2), (-0.08, 0)], 0.02)
    a.add(fin, trim, (-0.42, 0.01, 0.6 * r), SIDEWAYS)
    glass = a.look("glass", colors=("black", "dark blue", "light blue"), avoid=look)
    a.add(ellipsoid((0.1, 0.55 * r, 0.45 * r)), glass, (0.3 if jet else 0.12, 0, 0.75 * r))
    details = [detail(trim, "wings", plural=True)] if trim is not look else ["wings"]
    if jet:
        for y in (0.35, 0.65)[: a.integer(1, 2)]:
            engine = cylinder(0.04, 0.16, 0.035, segments=12)
            a.add_mirrored(
                engine,
                a.look("metal"),
                (0.1 - sweep * y, y * span, height - 0.05),
                turn_about("y", 90),
            )
    else:
        blade = a.look("wooden", "metal")
        a.add(box((0.015, 0.3, 0.035)), blade, (0.52, 0, -0.02), turn_about("x", a.uniform(0, 90)))
        a.add(ellipsoid((0.05, 0.04, 0.04)), blade, (0.51, 0, 0))
        details.append("a propeller")
    nouns = (
        ("plane", "airplane", "jet")
        if jet
        else ("plane", "airplane", "propeller plane", "aeroplane")
    )
    return Description(nouns, look, tuple(details))


def helicopter(a: Assembly) -> Description:
    """A helicopter."""
    look = a.look(
        "metal", "plastic", "painted", colors=PAINTS, patterns=("two_tone",), pattern_chance=0.2
    )
    trim = a.look("metal", "plastic", avoid=look)
    glass = a.look("glass", colors=("light blue", "dark blue", "black"), avoid=look)
    a.add(ellipsoid((0.32, 0.2, 0.2)), look, (0, 0, 0.32))
    a.add(ellipsoid((0.2, 0.17, 0.16)), glass, (0.15, 0, 0.35))
    a.add(rod((-0.2, 0, 0.36), (-0.75, 0, 0.45), 0.07, 0.03), look)
    a.add(
        prism([(0.05, 0), (-0.02, 0.18), (-0.1, 0.18), (-0.06, 0)], 0.03),
        look,
        (-0.72, 0.015, 0.44),
        SIDEWAYS,
    )
    a.add(rod((0, 0, 0.5), (0, 0, 0.62), 0.025), trim)
    angle, count = a.uniform(0, 90), a.integer(2, 4)
    a.add_around(box((0.6, 0.06, 0.015)), trim, count, (0.3, 0, 0.61), angle)
    a.add_mirrored(rod((-0.28, 0.17, 0.03), (0.32, 0.17, 0.03), 0.018), trim, (0, 0, 0))
    for x in (-0.14, 0.16):
        a.add_mirrored(rod((x, 0.17, 0.03), (x, 0.1, 0.2), 0.014), trim, (0, 0, 0))
    return Description(("helicopter", "toy helicopter"), look, (detail(trim, "rotor"), "a rotor"))


def boat(a: Assembly) -> Description:
    """A sailing boat, a rowing boat, or a ship."""
    look = a.look(
        "wooden",
        "painted",
        "plastic",
        colors=(*PAINTS, "brown", "light brown"),
        patterns=("two_tone", "bands"),
        pattern_chance=0.2,
    )
    length, width, depth = 1.0, a.uniform(0.28, 0.42), a.uniform(0.16, 0.26)
    xs = np.linspace(-0.5, 0.5, 9) * length
    beam = width * np.array([0.62, 0.8, 0.92, 1.0, 1.0, 0.92, 0.74, 0.45, 0.04])
    rows = np.array(
        [(0.0, 0.0), (0.55, 0.12), (0.85, 0.5), (1.0, 1.0), (0.88, 1.0), (0.8, 0.6), (0.0, 0.55)]
    )
    sheer = 1 + 0.35 * (xs / length * 2) ** 2
    right = np.stack(
        [
            np.stack(
                [
                    np.broadcast_to(xs, (9,)) * (1 - 0.12 * (1 - t)),
                    0.5 * beam * s,
                    depth * t * sheer,
                ],
                axis=1,
            )
            for s, t in rows
        ],
        axis=1,
    )
    left = right[:, -2:0:-1] * np.array([1, -1, 1])
    a.add(loft(np.concatenate([right, left], axis=1)), look)
    kind = a.choose(["sail", "sail", "row", "ship"])
    if kind == "sail":
        mast, tall = a.look("wooden", "metal"), a.uniform(0.7, 1.1)
        sail = a.look("fabric", avoid=look, patterns=("bands", "diagonal"), pattern_chance=0.25)
        a.add(rod((0.05, 0, 0.1), (0.05, 0, tall + 0.2), 0.018), mast)
        main = prism([(0.0, 0.0), (0.0, tall - 0.05), (-0.45, 0.02)], 0.015)
        a.add(main, sail, (0.02, 0, 0.22), turn_about("z", a.uniform(-15, 15)) @ SIDEWAYS)
        if a.chance(0.7):
            a.add(
                prism([(0.0, 0.0), (0.36, 0.02), (0.0, 0.75 * tall)], 0.015),
                sail,
                (0.08, 0, 0.22),
                SIDEWAYS,
            )
        return Description(
            ("boat", "sailboat", "boat", "toy boat"),
            look,
            (f"a {sail.color} sail", f"{sail.color} sails"),
        )
    if kind == "row":
        bench = a.look("wooden", avoid=look)
        for x in (-0.25, 0.08):
            a.add(box((0.09, 0.85 * width, 0.025)), bench, (x, 0, 0.75 * depth))
        return Description(("boat", "rowboat", "canoe"), look, (detail(bench, "seat"),))
    house = a.look(
        "painted", "metal", colors=("white", "cream", "light grey", "yellow"), avoid=look
    )
    dark = a.look("glass", colors=("black", "dark blue"))
    z = 0.9 * depth
    for k in range(a.integer(1, 3)):
        size = 0.5 - 0.13 * k
        a.add(box((size, width * (0.7 - 0.12 * k), 0.14)), house, (-0.08, 0, z))
        a.add(box((size * 0.8, width * (0.7 - 0.12 * k) * 1.04, 0.05)), dark, (-0.08, 0, z + 0.05))
        z += 0.14
    funnel = a.look(
        "painted", "metal", colors=("red", "black", "yellow", "blue", "orange"), avoid=house
    )
    for x in (-0.18, 0.02)[: a.integer(1, 2)]:
        a.add(cylinder(0.055, 0.22), funnel, (x, 0, z))
    return Description(
        ("ship", "boat", "toy ship", "toy boat"), look, (f"a {funnel.color} chimney", "a cabin")
    )


def rocket(a: Assembly) -> Description:
    """A rocket with fins and a port hole."""
    look = a.look(
        "metal", "plastic", "painted", patterns=("bands", "checks", "two_tone"), pattern_chance=0.3
    )
    trim = a.look("plastic", "painted", avoid=look)
    r, height = a.uniform(0.12, 0.2), a.uniform(0.55, 0.8)
    belly = r * a.uniform(1.0, 1.35)
    line = smooth_profile([(r * 0.8, 0.1), (belly, 0.4 * height), (r * 0.9, height)], 10)
    a.add(revolve(np.concatenate([[(0, 0.1)], line, [(0, height)]]), 24), look)
    nose = smooth_profile([(r * 0.92, 0), (r * 0.6, 0.16), (0.0, a.uniform(0.26, 0.4))], 8)
    a.add(revolve(nose.clip(0), 24), trim, (0, 0, height))
    a.add(cylinder(r * 0.65, 0.1, r * 0.5), trim, (0, 0, 0.02))
    fin = prism([(0, 0.1), (0.75 * r + 0.1, -0.1), (0.75 * r + 0.1, 0.05), (0, 0.38)], 0.03)
    a.add_around(fin.moved(SIDEWAYS, (0, 0.015, 0)), trim, a.integer(3, 4), (0.8 * r, 0, 0.1))
    glass = a.look("glass", colors=("light blue", "dark blue", "white", "yellow"), avoid=look)
    for z in (0.72, 0.5)[: a.integer(1, 2)]:
        at = float(np.interp(z * height, line[:, 1], line[:, 0]))
        a.add(
            torus(0.06, 0.018, segments=16, sides=6), trim, (at, 0, z * height), turn_about("y", 90)
        )
        a.add(ellipsoid((0.02, 0.055, 0.055)), glass, (at, 0, z * height))
    return Description(
        ("rocket", "toy rocket", "spaceship", "rocket"),
        look,
        (detail(trim, "fins", plural=True), detail(trim, "nose"), "a window"),
        ("tall",),
    )


def cart(a: Assembly) -> Description:
    """A tractor, a wagon or a wheelbarrow."""
    look = a.look("painted", "wooden", "metal", "plastic")
    if a.chance(0.5):
        glass = a.look("glass", colors=("light blue", "black"), avoid=look)
        a.add(box((0.55, 0.3, 0.24)), look, (0.25, 0, 0.22))
        a.add(box((0.3, 0.4, 0.4), taper=(0.9, 0.9)), glass, (-0.2, 0, 0.35))
        a.add(box((0.38, 0.44, 0.05)), look, (-0.2, 0, 0.74))
        a.add(box((0.4, 0.42, 0.2)), look, (-0.2, 0, 0.2))
        a.add(rod((0.3, 0.1, 0.46), (0.3, 0.1, 0.7), 0.025), a.look("metal"))
        tyre = wheels(a, [-0.25], 0.22, 0.27, 0.14)
        wheels(a, [0.38], 0.16, 0.15, 0.1, tyre)
        return Description(("tractor", "toy tractor"), look, ("black wheels",))
    x, y, z = a.uniform(0.7, 1.0), a.uniform(0.4, 0.6), a.uniform(0.2, 0.35)
    walls = join(
        [box((x, 0.03, z)).moved(None, (0, s * 0.5 * y, 0)) for s in (-1, 1)]
        + [box((0.03, y, z)).moved(None, (s * 0.5 * x, 0, 0)) for s in (-1, 1)]
        + [box((x, y, 0.03))]
    )
    a.add(walls, look, (0, 0, 0.2))
    tyre = wheels(a, [0.35 * x, -0.35 * x], 0.5 * y, a.uniform(0.14, 0.22), 0.06)
    grip = a.look("metal", "wooden")
    a.add(rod((0.5 * x, 0, 0.2), (0.5 * x + 0.45, 0, 0.5), 0.02), grip)
    a.add(rod((0.5 * x + 0.45, -0.1, 0.5), (0.5 * x + 0.45, 0.1, 0.5), 0.02), grip)
    return Description(
        ("wagon", "cart", "toy wagon"), look, (detail(tyre, "wheels", plural=True), "a handle")
    )


FAMILIES = (
    plane,
    helicopter,
    boat,
    rocket,
    cart,
)
