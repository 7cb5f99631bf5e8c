"""Solids and sheets: the vocabulary, with ``sweeps``, that families build objects from.

Conventions
-----------
* Those of ``quads``. Solids stand on z = 0 or are centred at the origin, as each says.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from gscomplete.util.arrays import Float32Array
from recipes.train_embedded_prior.procedural.quads import (
    Quads,
    arc_lengths,
    grid,
    join,
    seam_length,
)
from recipes.train_embedded_prior.procedural.sweeps import revolve


def cylinder(
    radius: float, height: float, top_radius: float | None = None, segments: int = 24
) -> Quads:
    """Return a closed cylinder or cone frustum standing on z = 0."""
    top = radius if top_radius is None else top_radius
    thin = max(radius, top)
    return revolve([(0, 0), (radius, 0), (top, height), (0, height)], segments, feature=thin)


def ellipsoid(
    radii: Sequence[float],  # (x, y, z)
    *,
    roundness: tuple[float, float] = (1.0, 1.0),
    rows: int = 10,
    segments: int = 20,
) -> Quads:
    """Return a superellipsoid centred at the origin.

    Args:
        radii: half sizes.
        roundness: exponents (vertical, horizontal); 1 = round, 0.2 = box with round edges,
            2 = double cone.
        rows: quads from pole to pole.
        segments: quads around.
    """

    def signed_power(a: Float32Array, exponent: float) -> Float32Array:
        return a if exponent == 1.0 else np.sign(a) * np.abs(a) ** np.float32(exponent)

    phi = np.linspace(-0.5 * math.pi, 0.5 * math.pi, rows + 1, dtype=np.float32)
    theta = np.linspace(0.0, 2 * math.pi, segments + 1, dtype=np.float32)
    ring = signed_power(np.cos(phi).clip(0), roundness[0])[:, None]
    vertices = np.empty((rows + 1, segments + 1, 3), np.float32)
    vertices[..., 0] = radii[0] * ring * signed_power(np.cos(theta), roundness[1])
    vertices[..., 1] = radii[1] * ring * signed_power(np.sin(theta), roundness[1])
    vertices[..., 2] = radii[2] * signed_power(np.sin(phi), roundness[0])[:, None]
    uv = np.empty((rows + 1, segments + 1, 2), np.float32)
    around = seam_length(math.pi * (radii[0] + radii[1]))
    uv[..., 0] = theta * np.float32(around / (2 * math.pi))
    uv[..., 1] = (phi * np.float32(0.5 * (radii[2] + max(radii[:2]))))[:, None]
    return grid(vertices, uv, sorted(radii)[1])


_BOX_FACES = np.array(
    [
        [(0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0)],  # bottom
        [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],  # top
        [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)],  # -y
        [(1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1)],  # +y
        [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)],  # +x
        [(0, 1, 0), (0, 0, 0), (0, 0, 1), (0, 1, 1)],  # -x
    ],
    np.float32,
)

_FACE_UV = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)


def box(
    size: Sequence[float],  # (x, y, z)
    *,
    taper: Sequence[float] = (1.0, 1.0),
    shear: Sequence[float] = (0.0, 0.0),
) -> Quads:
    """Return a box standing on z = 0, centred in x and y.

    Args:
        size: edge lengths.
        taper: size of the top over the bottom in x and y.
        shear: shift of the top in x and y.
    """
    unit = _BOX_FACES.copy()
    top = unit[..., 2:]
    xy = (unit[..., :2] - 0.5) * (1 + top * (np.asarray(taper, np.float32) - 1))
    corners = np.concatenate([xy, top], axis=-1) * np.asarray(size, np.float32)
    corners[..., :2] += top * np.asarray(shear, np.float32)
    across = np.array(
        [[size[1], size[0]], [size[0], size[1]]]
        + [[size[0], size[2]]] * 2
        + [[size[1], size[2]]] * 2,
        np.float32,
    )
    return Quads(corners, _FACE_UV * across[:, None], 0.5 * sorted(size)[1])


def tray(size: Sequence[float], wall: float, taper: float = 1.0) -> Quads:
    """Return a box open at the top, with inner walls; ``taper`` is top over bottom size."""
    x, y, z = size
    levels = [(1.0, 0.0, 0.0), (taper, z, 0.0), (taper, z, wall), (1.0, wall, wall)]
    base = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5)])
    rings = np.empty((4, 5, 3), np.float32)
    for row, (scale, height, inset) in enumerate(levels):
        rings[row, :, 0] = base[:, 0] * (x * scale - 2 * inset)
        rings[row, :, 1] = base[:, 1] * (y * scale - 2 * inset)
        rings[row, :, 2] = height
    around = np.array([0, x, x + y, 2 * x + y, 2 * x + 2 * y], np.float32)
    uv = np.empty((4, 5, 2), np.float32)
    uv[..., 0] = around
    uv[..., 1] = np.array([0, z, z, 0], np.float32)[:, None]
    floor = np.stack([rings[3, k] for k in (0, 1, 2, 3)])[None]
    foot = np.stack([rings[0, k] for k in (0, 3, 2, 1)])[None]
    flat = np.concatenate([floor, foot])
    return join([grid(rings, uv, None), Quads(flat, flat[..., :2].copy(), None)])


def polygon_fan(outline: Float32Array, height: float, up: bool) -> Quads:
    """Fill a polygon [P, 2] that is star-shaped about its mean with a fan of quads."""
    ring = np.concatenate([outline, outline[:1]])
    start, end = (ring[:-1], ring[1:]) if up else (ring[1:], ring[:-1])
    middle = np.broadcast_to(outline.mean(axis=0), start.shape)
    flat = np.stack([middle, start, end, middle], axis=1).astype(np.float32)
    level = np.full((len(start), 4, 1), height, np.float32)
    return Quads(np.concatenate([flat, level], axis=-1), flat, None)


def prism(
    outline: ArrayLike,  # [P, 2] anticlockwise, star-shaped about its mean
    height: float,
    *,
    top_scale: float = 1.0,
) -> Quads:
    """Extrude a polygon from z = 0 to ``height``; ``top_scale`` shrinks the top about its mean."""
    base = np.asarray(outline, np.float32)
    top = base.mean(axis=0) + (base - base.mean(axis=0)) * np.float32(top_scale)
    rings = np.empty((2, len(base) + 1, 3), np.float32)
    rings[0, :, :2] = np.concatenate([base, base[:1]])
    rings[1, :, :2] = np.concatenate([top, top[:1]])
    rings[:, :, 2] = np.array([[0.0], [height]], np.float32)
    uv = np.empty((2, len(base) + 1, 2), np.float32)
    uv[..., 0] = arc_lengths(rings[0])
    uv[..., 1] = rings[..., 2]
    sides = [grid(rings, uv, None), polygon_fan(base, 0.0, up=False)]
    if top_scale > 1e-3:
        sides.append(polygon_fan(top, height, up=True))
    extents = [*np.ptp(base, axis=0).tolist(), height]
    return replace(join(sides), feature=0.5 * sorted(extents)[1])


def sheet(
    size: Sequence[float],  # (x, y)
    heights: Float32Array,  # [R, C]
    feature: float | None = None,
) -> Quads:
    """Return a height field over a centred rectangle, facing up."""
    rows, columns = heights.shape
    x = np.linspace(-0.5 * size[0], 0.5 * size[0], columns, dtype=np.float32)
    y = np.linspace(-0.5 * size[1], 0.5 * size[1], rows, dtype=np.float32)
    vertices = np.stack([*np.meshgrid(x, y), heights.astype(np.float32)], axis=-1)
    return grid(vertices, vertices[..., :2].copy(), feature)


def disc(radius: float, segments: int = 20) -> Quads:
    """Return a flat disc at z = 0 facing up."""
    return revolve([(radius, 0), (0, 0)], segments)


def regular_polygon(sides: int, radius: float, *, star: float = 1.0) -> Float32Array:
    """Return an anticlockwise polygon [sides, 2]; ``star`` < 1 pulls in every second corner."""
    count = sides if star == 1.0 else 2 * sides
    angle = np.linspace(0.0, 2 * math.pi, count, endpoint=False)
    reach = np.where(np.arange(count) % 2 == 0, 1.0, star) * radius
    return np.stack([reach * np.cos(angle), reach * np.sin(angle)], axis=1).astype(np.float32)
