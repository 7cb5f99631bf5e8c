"""Shapes as small soups of quads: the vocabulary that families build objects from.

Conventions
-----------
* z is up. A quad's corners are (u0 v0), (u1 v0), (u1 v1), (u0 v1); d/du x d/dv points outward.
* Quads may be degenerate along one edge (poles, fans); the sampler spreads points evenly anyway.
* ``uv`` are surface coordinates in units of length, for patterns. Around closed sections u is
  stretched to a multiple of ``SEAM_UNIT``, so that patterns with a whole number of periods per
  seam unit close without a seam.
* ``feature`` is the half-thickness of a thin part (None: thick): discs are kept smaller than it.
  For solids it is the middle half size: rods are thin, plates are not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float32]

SEAM_UNIT = 0.25


@dataclass(frozen=True, slots=True)
class Quads:
    """Q quads with surface coordinates."""

    corners: FloatArray  # [Q, 4, 3]
    uv: FloatArray  # [Q, 4, 2]
    feature: float | None = None

    def moved(self, turn: ArrayLike | None, at: Sequence[float]) -> Quads:
        """Return the quads after ``x -> turn x + at``; ``turn`` is [3, 3] or None."""
        corners = self.corners
        if turn is not None:
            corners = corners @ np.asarray(turn, np.float32).T
        return replace(self, corners=corners + np.asarray(at, np.float32))

    def stretched(self, x: float, y: float, z: float) -> Quads:
        """Return the quads scaled along the axes by positive factors."""
        return replace(self, corners=self.corners * np.array([x, y, z], np.float32))


def join(parts: Sequence[Quads]) -> Quads:
    """Join quads into one soup with the smallest feature among them."""
    features = [part.feature for part in parts if part.feature is not None]
    return Quads(
        np.concatenate([part.corners for part in parts]),
        np.concatenate([part.uv for part in parts]),
        min(features) if features else None,
    )


def turn_about(axis: str, angle_deg: float) -> FloatArray:
    """Return the [3, 3] right-handed rotation about the x, y or z axis."""
    cos, sin = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    rows = {
        "x": [[1, 0, 0], [0, cos, -sin], [0, sin, cos]],
        "y": [[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]],
        "z": [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]],
    }
    return np.array(rows[axis], np.float32)


def grid(vertices: FloatArray, uv: FloatArray, feature: float | None = None) -> Quads:
    """Turn a vertex grid [R+1, C+1, 3] (v along rows, u along columns) into R x C quads."""

    def corners_of(a: FloatArray) -> FloatArray:
        quads = np.stack([a[:-1, :-1], a[:-1, 1:], a[1:, 1:], a[1:, :-1]], axis=2)
        return quads.reshape(-1, 4, a.shape[-1])

    return Quads(corners_of(vertices), corners_of(uv), feature)


def seam_length(length: float) -> float:
    """Round a closed length to a whole number of seam units, at least one."""
    return max(1, round(length / SEAM_UNIT)) * SEAM_UNIT


def arc_lengths(path: FloatArray) -> FloatArray:  # [P, D] -> [P]
    """Return the distance travelled along a polyline at each of its points."""
    steps = np.sqrt(np.square(np.diff(path, axis=0)).sum(axis=1))
    return np.concatenate([np.zeros(1, np.float32), np.cumsum(steps)]).astype(np.float32)


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


def smooth_profile(points: ArrayLike, count: int = 16) -> FloatArray:
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


def shell_profile(outer: ArrayLike, wall: float, floor: float | None = None) -> FloatArray:
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

    def signed_power(a: FloatArray, exponent: float) -> FloatArray:
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


def polygon_fan(outline: FloatArray, height: float, up: bool) -> Quads:
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


def loft(sections: FloatArray, feature: float | None = None) -> Quads:
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
    return replace(join([grid(closed, uv), *caps]), feature=feature)


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


def _end_cap(ring: FloatArray, center: FloatArray, flip: bool) -> Quads:
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


def sheet(
    size: Sequence[float],  # (x, y)
    heights: FloatArray,  # [R, C]
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


def arc(
    start_deg: float, end_deg: float, radius: float, count: int = 9, *, plane: str = "xz"
) -> FloatArray:
    """Return points [count, 3] of a circle arc about the origin in the xz, yz or xy plane."""
    angle = np.radians(np.linspace(start_deg, end_deg, count))
    points = np.zeros((count, 3), np.float32)
    first, second = ("xyz".index(axis) for axis in plane)
    points[:, first] = radius * np.cos(angle)
    points[:, second] = radius * np.sin(angle)
    return points


def regular_polygon(sides: int, radius: float, *, star: float = 1.0) -> FloatArray:
    """Return an anticlockwise polygon [sides, 2]; ``star`` < 1 pulls in every second corner."""
    count = sides if star == 1.0 else 2 * sides
    angle = np.linspace(0.0, 2 * math.pi, count, endpoint=False)
    reach = np.where(np.arange(count) % 2 == 0, 1.0, star) * radius
    return np.stack([reach * np.cos(angle), reach * np.sin(angle)], axis=1).astype(np.float32)
