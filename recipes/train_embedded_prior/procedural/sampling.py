"""Surface points spread evenly over quads.

Conventions
-----------
* The spacing is the side of the square of surface one point stands for. Thin parts (``feature``)
  get a smaller spacing, so that their discs do not bulge beyond them.
* Large quads are first cut into cells of about one spacing, then one point is drawn in every
  equal slice of cumulative cell area: cells that hold a point each are jittered grids, small
  quads share points fairly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gscomplete.util.arrays import BoolArray, Float32Array, IntArray
from recipes.train_embedded_prior.procedural.quads import Quads


@dataclass(frozen=True, slots=True)
class SurfaceSamples:
    """N points on surfaces, in ascending order of the part they lie on."""

    points: Float32Array  # [N, 3]
    normals: Float32Array  # [N, 3] unit, outward
    uv: Float32Array  # [N, 2] surface coordinates of the quads
    spacing: Float32Array  # [N]
    part: IntArray  # [N] index into the list of parts

    def select(self, index: slice | IntArray | BoolArray) -> SurfaceSamples:
        """Return some of the samples."""
        return SurfaceSamples(
            self.points[index],
            self.normals[index],
            self.uv[index],
            self.spacing[index],
            self.part[index],
        )


THIN_SPACING = 1.1
"""Largest spacing on a thin part, in units of its half-thickness."""
FINEST = 0.4
"""Smallest spacing on a thin part, in units of the common spacing."""


def spacing_per_part(
    areas: Float32Array,  # [P]
    features: Float32Array,  # [P], inf where thick
    count: int,
) -> Float32Array:  # [P]
    """Choose spacings so that all parts together use about ``count`` points.

    The common spacing s solves sum(area / min(s, limit)^2) = count up to the clamp at ``FINEST``,
    by fixed-point iteration.
    """
    limit = THIN_SPACING * features
    common = np.sqrt(areas.sum() / count)
    for _ in range(4):
        spacing = np.clip(limit, FINEST * common, common)
        common = common * np.sqrt(max((areas / spacing**2).sum(), 1.0) / count)
    return np.clip(limit, FINEST * common, common).astype(np.float32)


def sample_quads(parts: list[Quads], count: int, rng: np.random.Generator) -> SurfaceSamples:
    """Draw exactly ``count`` points spread evenly over the surfaces of all parts.

    Raises:
        ValueError: there is no part, or no part has an area.
    """
    if not parts:
        raise ValueError("sample_quads: expected at least one part, found none")
    corners = np.concatenate([part.corners for part in parts])
    uv = np.concatenate([part.uv for part in parts])
    part_of_quad = np.repeat(np.arange(len(parts)), [len(part.corners) for part in parts])
    c0, c1, c2, c3 = (corners[:, k] for k in range(4))
    areas = _half_cross(c2 - c0, c3 - c1)
    features = np.array([np.inf if p.feature is None else p.feature for p in parts])
    part_areas = np.bincount(part_of_quad, areas, minlength=len(parts))
    if not part_areas.sum() > 0:
        raise ValueError("sample_quads: no part has a positive, finite area")
    spacing = spacing_per_part(part_areas, features, count)
    pitch = spacing[part_of_quad]

    edge = np.sqrt(np.square(np.stack([c1 - c0, c2 - c3, c3 - c0, c2 - c1])).sum(axis=-1))
    bottom, top, left, right = edge
    across = np.clip(np.round(0.5 * (bottom + top) / pitch), 1, 4096).astype(np.int64)
    along = np.clip(np.round(0.5 * (left + right) / pitch), 1, 4096).astype(np.int64)
    cells = across * along
    weight = areas / pitch**2 / cells  # points per cell
    cumulative = np.cumsum(np.repeat(weight, cells), dtype=np.float64)
    first_cell = np.cumsum(cells) - cells

    draw = rng.random((3, count), dtype=np.float32)
    position = (np.arange(count) + draw[0]) * (cumulative[-1] / count)
    cell = np.minimum(np.searchsorted(cumulative, position, side="right"), len(cumulative) - 1)
    quad = np.repeat(np.arange(len(cells)), cells)[cell]
    index = cell - first_cell[quad]
    u = ((index % across[quad] + draw[1]) / across[quad]).astype(np.float32)
    v = ((index // across[quad] + draw[2]) / along[quad]).astype(np.float32)
    u, v = _even(u, left[quad], right[quad]), _even(v, bottom[quad], top[quad])

    u, v = u[:, None], v[:, None]
    a, b, c, d = (corners[quad, k] for k in range(4))
    along_u = (b - a) + v * ((c - d) - (b - a))
    along_v = (d - a) + u * ((c - b) - (d - a))
    points = a + u * (b - a) + v * along_v
    normals = _cross(along_u, along_v)
    normals /= np.maximum(np.sqrt(np.einsum("ij,ij->i", normals, normals)), 1e-12)[:, None]
    ta, tb, tc, td = (uv[quad, k] for k in range(4))
    uv_at = ta + u * (tb - ta) + v * ((td - ta) + u * ((tc - tb) - (td - ta)))
    return SurfaceSamples(points, normals, uv_at, pitch[quad], part_of_quad[quad])


def _even(fraction: Float32Array, start: Float32Array, end: Float32Array) -> Float32Array:
    """Warp [0, 1] so that points are even on a strip whose width goes from start to end."""
    root = np.sqrt(start * start + fraction * (end * end - start * start))
    return fraction * (start + end) / np.maximum(start + root, 1e-12)


def _cross(a: Float32Array, b: Float32Array) -> Float32Array:  # [N, 3] x [N, 3]
    """Cross product; several times faster than numpy's on small rows."""
    out = np.empty_like(a)
    out[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    out[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    out[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return out


def _half_cross(a: Float32Array, b: Float32Array) -> Float32Array:  # [N]
    """Half the length of the cross product: a quad's area from its diagonals."""
    product = _cross(a, b)
    return 0.5 * np.sqrt(np.einsum("ij,ij->i", product, product))
