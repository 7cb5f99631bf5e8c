"""Shapes that follow a line: surfaces of revolution, tubes, rods and skins.

Conventions
-----------
* Those of ``quads``. Profiles are (radius, height) about the z axis; paths are [P, 3].
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


def revolve(
    profile: ArrayLike,  # [P, 2] (radius, z), outside seen on the right when walking along it
    segments: int = 24,
    *,
    lobes: int = 0,
    lobe_depth: float = 0.0,
    power: float = 2.0,
    feature: float | None = None,
) -> Quads:
    """Turn a profile about the z axis: up along the outside, down along the inside.

    Args:
        profile: radii and heights; a bottom starts at radius 0 and goes outward.
        segments: number of flat sides; 3 to 8 give prisms.
        lobes: number of bulges around the axis.
        lobe_depth: relative depth of the valleys between them.
        power: exponent of the superellipse section, 2 = round, 6 = a rounded square.
        feature: half-thickness of thin walls, None = thick.
    """
    line = np.asarray(profile, np.float32)
    theta = np.linspace(0.0, 2 * math.pi, segments + 1, dtype=np.float32)
    cos, sin = np.cos(theta), np.sin(theta)
    reach = np.ones_like(theta)
    if lobes:
        reach = 1 - lobe_depth * (1 - np.abs(np.sin(0.5 * lobes * theta)))
    if power != 2.0:
        reach = reach * (np.abs(cos) ** power + np.abs(sin) ** power) ** (-1.0 / power)
    vertices = np.empty((len(line), segments + 1, 3), np.float32)
    vertices[..., 0] = line[:, :1] * (cos * reach)
    vertices[..., 1] = line[:, :1] * (sin * reach)
    vertices[..., 2] = line[:, 1:]
    uv = np.empty((len(line), segments + 1, 2), np.float32)
    uv[..., 0] = theta * np.float32(seam_length(2 * math.pi * line[:, 0].max()) / (2 * math.pi))
    uv[..., 1] = arc_lengths(line)[:, None]
    return grid(vertices, uv, feature)


def smooth_profile(points: ArrayLike, count: int = 16) -> Float32Array:
    """Draw a smooth curve [count, D] through a few control points (Catmull-Rom)."""
    knots = np.asarray(points, np.float64)
    padded = np.concatenate([2 * knots[:1] - knots[1:2], knots, 2 * knots[-1:] - knots[-2:-1]])
    position = np.linspace(0.0, len(knots) - 1.0, count)
    first = np.minimum(position.astype(np.int64), len(knots) - 2)
    t = (position - first)[:, None]
    p0, p1, p2, p3 = (padded[first + k] for k in range(4))
    curve = p1 + 0.5 * t * (
        p2 - p0 + t * (2 * p0 - 5 * p1 + 4 * p2 - p3 + t * (3 * (p1 - p2) + p3 - p0))
    )
    return curve.astype(np.float32)


def shell_profile(outer: ArrayLike, wall: float, floor: float | None = None) -> Float32Array:
    """Close an outer profile [P, 2] (bottom rim upward) into an open vessel with a thick wall.

    Args:
        outer: (radius, z) from the foot to the rim.
        wall: wall thickness.
        floor: height of the inner bottom above the foot, None = ``wall``.
    """
    line = np.asarray(outer, np.float32)
    bottom = line[0, 1] + (wall if floor is None else floor)
    inner = line[::-1].copy()
    inner[:, 0] = np.maximum(inner[:, 0] - wall, 0.0)
    inner[:, 1] = np.maximum(inner[:, 1], bottom)
    start = np.array([[0.0, line[0, 1]]], np.float32)
    end = np.array([[0.0, bottom]], np.float32)
    return np.concatenate([start, line, inner, end])


def loft(sections: Float32Array) -> Quads:
    """Skin closed sections [R, C, 3] (anticlockwise about the direction of travel), with caps.

    A section's points are joined to the next section's and the first and last are filled.
    """
    closed = np.concatenate([sections, sections[:, :1]], axis=1).astype(np.float32)
    uv = np.empty((*closed.shape[:2], 2), np.float32)
    uv[..., 0] = arc_lengths(closed[len(closed) // 2])
    uv[..., 1] = arc_lengths(sections.mean(axis=1))[:, None]
    caps = []
    for ring, flip in ((closed[0], True), (closed[-1], False)):
        start, end = (ring[1:], ring[:-1]) if flip else (ring[:-1], ring[1:])
        middle = np.broadcast_to(ring[:-1].mean(axis=0), start.shape)
        corners = np.stack([middle, start, end, middle], axis=1)
        caps.append(Quads(corners, corners[..., :2].copy(), None))
    return join([grid(closed, uv), *caps])


def tube(
    path: ArrayLike,  # [P, 3]
    radius: ArrayLike,  # one number or [P]
    *,
    sides: int = 8,
    flatten: float = 1.0,
    closed: bool = False,
) -> Quads:
    """Sweep a circle along a path.

    Args:
        path: centre line.
        radius: radius, constant or at each point.
        sides: number of flat sides.
        flatten: ratio of the section's radius across the bend plane to that within it.
        closed: the last point equals the first (a ring): no ends are filled.
    """
    line = np.asarray(path, np.float32)
    radii = np.broadcast_to(np.asarray(radius, np.float32), (len(line),))
    tangent = np.gradient(line, axis=0) if len(line) > 2 else np.repeat(line[1:] - line[:1], 2, 0)
    if closed:
        tangent[0] = tangent[-1] = line[1] - line[-2]
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    bend = np.cross(tangent[:-1], tangent[1:]).sum(axis=0)
    if float(bend @ bend) < 1e-6:
        bend = np.eye(3, dtype=np.float32)[np.abs(tangent).sum(axis=0).argmin()]
    across = bend - tangent * (tangent @ bend)[:, None]
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    within = np.cross(across, tangent)
    phi = np.linspace(0.0, 2 * math.pi, sides + 1, dtype=np.float32)
    ring = np.cos(phi)[None, :, None] * within[:, None] + np.sin(phi)[None, :, None] * across[
        :, None
    ] * np.float32(flatten)
    vertices = line[:, None] + radii[:, None, None] * ring
    uv = np.empty((*vertices.shape[:2], 2), np.float32)
    uv[..., 0] = phi * np.float32(seam_length(2 * math.pi * radii.max()) / (2 * math.pi))
    uv[..., 1] = arc_lengths(line)[:, None]
    parts = [grid(vertices, uv, None)]
    if not closed:
        parts += [_end_cap(vertices[0], line[0], True), _end_cap(vertices[-1], line[-1], False)]
    return replace(join(parts), feature=float(radii.max()) * min(1.0, flatten))


def _end_cap(ring: Float32Array, center: Float32Array, flip: bool) -> Quads:
    """Fill the end of a tube whose ring [S+1, 3] is closed."""
    start, end = (ring[1:], ring[:-1]) if flip else (ring[:-1], ring[1:])
    middle = np.broadcast_to(center, start.shape)
    corners = np.stack([middle, start, end, middle], axis=1).astype(np.float32)
    return Quads(corners, corners[..., :2].copy(), None)


def rod(
    start: Sequence[float],
    end: Sequence[float],
    radius: float,
    end_radius: float | None = None,
    sides: int = 8,
) -> Quads:
    """Return a straight round bar between two points."""
    stop = radius if end_radius is None else end_radius
    return tube([start, end], [radius, stop], sides=sides)


def torus(radius: float, thickness: float, *, segments: int = 24, sides: int = 10) -> Quads:
    """Return a ring about the z axis; ``thickness`` is the radius of its section."""
    phi = np.linspace(-math.pi, math.pi, sides + 1)
    line = np.stack([radius + thickness * np.cos(phi), thickness * np.sin(phi)], axis=1)
    return replace(revolve(line, segments), feature=thickness)


def arc(
    start_deg: float, end_deg: float, radius: float, count: int = 9, *, plane: str = "xz"
) -> Float32Array:
    """Return points [count, 3] of a circle arc about the origin in the xz, yz or xy plane."""
    angle = np.radians(np.linspace(start_deg, end_deg, count))
    points = np.zeros((count, 3), np.float32)
    first, second = ("xyz".index(axis) for axis in plane)
    points[:, first] = radius * np.cos(angle)
    points[:, second] = radius * np.sin(angle)
    return points
