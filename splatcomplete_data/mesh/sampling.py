"""Points on a mesh by chance: uniform ones, and blue noise by way of MeshLab's Poisson disks.

Conventions
-----------
* A point is a triangle and barycentric weights; random numbers are a function of the seed.
* ``point_frames`` gives points the tangent frame and colour look-ups that ``cells.Cells`` has.
"""

from __future__ import annotations

import math

import numpy as np

from gscomplete.util.arrays import Float32Array, Float64Array, IntArray

CANDIDATES_PER_SAMPLE = 10
"""Uniform points from which one Poisson-disk sample is chosen; fewer leave gaps."""

RADIUS_OF_DENSEST = 0.75
"""Poisson-disk radius over the distance of points in the densest (hexagonal) packing; a maximal
set at this radius has the wanted number of points within 5 %."""


def uniform_points(
    areas: Float64Array,  # [T]
    count: int,
    seed: int,
) -> tuple[IntArray, Float32Array]:  # [N], [N, 3]
    """Draw points uniformly from the surface; return their triangles and weights."""
    rng = np.random.default_rng(seed)
    edges = np.cumsum(areas)
    triangle = np.searchsorted(edges, rng.random(count) * edges[-1], side="right")
    triangle = np.minimum(triangle, len(areas) - 1)
    a, b = rng.random((2, count))
    folded = a + b > 1
    a, b = np.where(folded, 1 - a, a), np.where(folded, 1 - b, b)
    return triangle, np.stack([1 - a - b, a, b], axis=1).astype(np.float32)


def poisson_points(
    vertices: Float32Array,  # [T, 3, 3]
    areas: Float64Array,  # [T]
    count: int,
    seed: int,
) -> tuple[IntArray, Float32Array]:  # [N], [N, 3]
    """Draw about ``count`` points that keep their distance; return triangles and weights.

    Raises:
        UserError: pymeshlab is missing or failed.
    """
    from splatcomplete_data.mesh.meshlab import prune_to_poisson_disk

    triangle, weights = uniform_points(areas, count * CANDIDATES_PER_SAMPLE, seed)
    points = np.einsum("nk,nkc->nc", weights.astype(np.float64), vertices[triangle])
    densest = math.sqrt(2.0 / math.sqrt(3.0) * float(areas.sum()) / count)
    chosen = prune_to_poisson_disk(points, RADIUS_OF_DENSEST * densest)
    return triangle[chosen], weights[chosen]


def point_frames(
    vertices: Float32Array,  # [T, 3, 3]
    triangle: IntArray,  # [N]
    side: float,
) -> tuple[Float32Array, Float32Array]:  # [N, 2, 3] axes, [N, 2, 3] steps
    """Return unit tangent axes, and the weights' change over a quarter of ``side`` along each."""
    corners = vertices[triangle].astype(np.float64)
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.maximum(np.linalg.norm(edge, axis=1), 1e-30)
    x = edge / length[:, None]
    y = np.cross(np.cross(edge, other), x)
    y /= np.maximum(np.linalg.norm(y, axis=1, keepdims=True), 1e-30)
    along, height = np.einsum("nc,nc->n", other, x), np.einsum("nc,nc->n", other, y)
    height = np.maximum(height, 1e-30)
    change = np.zeros((len(triangle), 2, 3))
    change[:, 0, 1] = 1.0 / length
    change[:, 1, 1], change[:, 1, 2] = -along / (height * length), 1.0 / height
    change[:, :, 0] = -change.sum(axis=2)
    change *= side / 4.0
    # within small triangles the look-ups stay near: beyond them the texture is another place's
    largest = np.abs(change).max(axis=2, keepdims=True)
    change *= np.minimum(1.0, 0.25 / np.maximum(largest, 1e-30))
    return np.stack([x, y], axis=1).astype(np.float32), change.astype(np.float32)
