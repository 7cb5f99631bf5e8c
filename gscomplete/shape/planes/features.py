"""The upright planes that P may be mirrored through, and the evidence for each of them.

Conventions
-----------
* Plane (a, o) holds the points x with ``normal(a) . x = OFFSETS[o]``; its normal is horizontal, at
  azimuth ``pi a / ANGLES``.
* Everything is measured on samples of P and of its rim (where its surface ends, by a cut or by
  what a scanner saw), in the cells of ``voxels``: a copy's sample is on P if P fills its cell or
  one beside it, and new if there is nothing of P within two cells.
* Features are shares of samples or lengths in object sizes; ``FEATURES`` names them in order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gscomplete.shape.evidence import Evidence, kind_of
from gscomplete.shape.voxels import CELLS, HALF_SIDE, grown
from gscomplete.splats.geometry.neighbourhood import ON_RIM, one_sidedness
from gscomplete.util.arrays import Float32Array, IntArray
from gscomplete.util.kernels import HELPER, KERNEL

ANGLES = 36
OFFSETS = tuple(round(0.025 * k, 3) for k in range(-18, 19))
FEATURES = (
    "new",
    "near",  # two cells from P: the plane is slightly wrong
    "on",
    "exact",  # in a cell of P
    "color_error",  # of the exact ones, their mean times their share
    "aligned",  # of the exact ones: normals agree, their mean times their share
    "front",  # new, and seen to be empty
    "behind",  # new, and hidden behind P
    "beside",  # new, and on rays that miss P
    "outside_box",
    "outside_grid",
    "gap",  # between P and the plane
    "offset",  # of the plane from the frame's centre
    "edge",  # of the plane's place across P: 0 at its side, 0.5 in its middle
    "from_mean",  # of the plane from P's mean
    "width",  # of P across the plane
    "rim_on",  # of the rim's copy: it closes onto P
    "rim_on_afar",  # so it does, and from farther than a cell
    "rim_at_plane",  # the rim lies in the plane: P was cut there
    "rim_closed",  # one of the two
    "rim_share",  # of P's samples that are on the rim
)
_SAMPLES = 500
_RIM_TREE = 6000
_RIM_TESTED = 1500
_RIM_SAMPLES = 400
_FEWEST_RIM = 8
_RIM_NEIGHBOURS = 24
_BOX_SIDE = 0.53
_AT_PLANE = 0.03


@dataclass(frozen=True, slots=True)
class PartSamples:
    """The samples of P that planes are scored on."""

    points: Float32Array  # [N, 3]
    colors: Float32Array  # [N, 3]
    normals: Float32Array  # [N, 3] of either sign
    rim: Float32Array  # [R, 3]
    rim_share: float
    spread: Float32Array  # [M, 3] many points, for extents
    distance: NDArray[np.uint8]  # [C, C, C] cells to P, at most 3
    cell_colors: Float32Array  # [3, C, C, C]
    cell_normals: Float32Array  # [C, C, C, 3]


def part_samples(
    positions: Float32Array,  # [N, 3]
    tangents: Float32Array,  # [N, 2, 3]
    colors: Float32Array,  # [N, 3]
    volume: Float32Array,  # [4, C, C, C] of P
) -> PartSamples:
    """Draw samples of P and of its rim."""
    normals = np.cross(tangents[:, 0], tangents[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-12)
    chosen = _every(len(positions), _SAMPLES)
    spread = np.ascontiguousarray(positions[_every(len(positions), _RIM_TREE)])
    rim, share = _rim(spread)
    return PartSamples(
        np.ascontiguousarray(positions[chosen]),
        np.ascontiguousarray(colors[chosen]),
        np.ascontiguousarray(normals[chosen], dtype=np.float32),
        rim,
        share,
        spread,
        _cells_to_surface(volume[0]),
        np.ascontiguousarray(volume[1:]),
        _cell_normals(positions, normals.astype(np.float32)),
    )


def plane_normals() -> Float32Array:  # [ANGLES, 2]
    """Return the planes' normals, x and y."""
    angles = math.pi * np.arange(ANGLES) / ANGLES
    return np.stack([np.cos(angles), np.sin(angles)], axis=1).astype(np.float32)


def plane_places(
    planes: NDArray[np.integer],  # [K, 2] angle, offset
) -> tuple[Float32Array, Float32Array]:  # [K] radians, [K] object sizes
    """Return the azimuths of planes' normals, and the planes' places along them."""
    angles = (math.pi / ANGLES * planes[:, 0]).astype(np.float32)
    return angles, np.array(OFFSETS, np.float32)[planes[:, 1]]


def plane_features(part: PartSamples, evidence: Evidence) -> Float32Array:  # [A, O, F]
    """Measure the evidence for and against each plane."""
    normals, offsets = plane_normals(), np.array(OFFSETS, np.float32)
    counted = np.zeros((len(normals), len(offsets), 11), np.float32)
    count_samples(
        part.points, part.colors, part.normals, part.distance, part.cell_colors,
        part.cell_normals, evidence.depth, evidence.camera_from_world, evidence.focal_px,
        normals, offsets, counted,
    )  # fmt: skip
    rim = _count_rim(part.rim, part.distance, normals, offsets)
    along = part.spread[:, :2] @ normals.T
    low, high = np.quantile(along, [0.005, 0.995], axis=0)[:, :, None].astype(np.float32)
    width = (high - low).clip(1e-6)
    share = ((offsets - low) / width).clip(0, 1)
    lengths = [
        np.maximum(np.maximum(low - offsets, offsets - high), 0),
        np.broadcast_to(np.abs(offsets), share.shape),
        np.minimum(share, 1 - share),
        np.abs(offsets - along.mean(axis=0)[:, None]),
        np.broadcast_to(width, share.shape),
    ]
    rim_share = np.full((*share.shape, 1), part.rim_share, np.float32)
    features = [counted, np.stack(lengths, axis=-1), rim, rim_share]
    return np.concatenate(features, axis=-1, dtype=np.float32)


def _every(count: int, most: int) -> IntArray:
    """Return indices of at most ``most`` of ``count``, evenly over them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def _rim(points: Float32Array) -> tuple[Float32Array, float]:  # [N, 3] -> [R, 3], share
    """Return the points whose neighbours lie to one side, at least the most one-sided few."""
    tested = points[_every(len(points), _RIM_TESTED)]
    neighbours = min(_RIM_NEIGHBOURS + 1, len(points))
    _, index = cKDTree(points).query(tested, k=range(1, neighbours + 1))
    one_sided = one_sidedness(points[index[:, 1:]] - tested[:, None])
    on_rim = one_sided > ON_RIM
    rim = tested[on_rim]
    if len(rim) < _FEWEST_RIM:
        rim = tested[np.argsort(-one_sided, kind="stable")[:_FEWEST_RIM]]
    return np.ascontiguousarray(rim[_every(len(rim), _RIM_SAMPLES)]), float(on_rim.mean())


@numba.njit(**HELPER)
def _cell(place: float) -> int:
    """Return the cell that a coordinate lies in; below 0 or from ``CELLS`` on outside the grid."""
    return math.floor((place + HALF_SIDE) * (CELLS / (2 * HALF_SIDE)))


@numba.njit(**KERNEL)
def count_samples(
    points: Float32Array,
    colors: Float32Array,
    normals: Float32Array,
    distance: NDArray[np.uint8],
    cell_colors: Float32Array,
    cell_normals: Float32Array,
    depth: Float32Array,
    camera_from_world: Float32Array,
    focal_px: float,
    plane_normals: Float32Array,
    offsets: Float32Array,
    out: Float32Array,  # [A, O, 11] zeros, written
) -> None:
    """Measure the first eleven features."""
    planes, places, samples = len(plane_normals), len(offsets), len(points)
    views = depth.shape[0]
    for a in range(planes):
        nx, ny = plane_normals[a, 0], plane_normals[a, 1]
        for o in range(places):
            row = out[a, o]
            for n in range(samples):
                shift = 2 * (offsets[o] - points[n, 0] * nx - points[n, 1] * ny)
                x, y = points[n, 0] + shift * nx, points[n, 1] + shift * ny
                z = points[n, 2]
                i = _cell(x)
                j = _cell(y)
                k = _cell(z)
                inside = 0 <= i < CELLS and 0 <= j < CELLS and 0 <= k < CELLS
                far = distance[i, j, k] if inside else 3
                if max(abs(x), abs(y), abs(z)) > _BOX_SIDE:
                    row[9] += 1
                if not inside:
                    row[10] += 1
                if far <= 1:
                    row[2] += 1
                    if far == 0:
                        row[3] += 1
                        error = np.float32(0)
                        for c in range(3):
                            error += abs(colors[n, c] - cell_colors[c, i, j, k])
                        row[4] += error / 3
                        turned = normals[n, 0] * nx + normals[n, 1] * ny
                        agree = normals[n, 2] * cell_normals[i, j, k, 2]
                        agree += (normals[n, 0] - 2 * turned * nx) * cell_normals[i, j, k, 0]
                        agree += (normals[n, 1] - 2 * turned * ny) * cell_normals[i, j, k, 1]
                        row[5] += abs(agree)
                    continue
                row[0] += 1
                if far == 2:
                    row[1] += 1
                front = behind = 0
                for v in range(views):
                    kind = kind_of(x, y, z, depth[v], camera_from_world[v], focal_px)
                    front += kind == 0
                    behind += kind == 1
                row[6] += front / views
                row[7] += behind / views
                row[8] += (views - front - behind) / views
            for feature in range(11):
                row[feature] /= samples


def _cells_of(places: NDArray[np.floating]) -> IntArray:
    """Return ``_cell`` of every coordinate."""
    places = places.astype(np.float64)
    return np.floor((places + HALF_SIDE) * (CELLS / (2 * HALF_SIDE))).astype(np.int64)


def _count_rim(
    rim: Float32Array,  # [R, 3]
    distance: NDArray[np.uint8],
    plane_normals: Float32Array,  # [A, 2]
    offsets: Float32Array,  # [O]
) -> Float32Array:  # [A, O, 4]
    """Measure the features of the rim's copy, ``rim_on`` to ``rim_closed``."""
    nx, ny = plane_normals.T[:, :, None, None]
    away = offsets[:, None] - rim[:, 0] * nx - rim[:, 1] * ny  # [A, O, R]
    twice = 2 * away.astype(np.float64)
    i, j, k = np.broadcast_arrays(
        _cells_of(rim[:, 0] + twice * nx), _cells_of(rim[:, 1] + twice * ny), _cells_of(rim[:, 2])
    )
    on = (np.minimum(np.minimum(i, j), k) >= 0) & (np.maximum(np.maximum(i, j), k) < CELLS)
    on[on] = distance[i[on], j[on], k[on]] <= 1
    close = np.abs(away) < _AT_PLANE
    counts = [kind.sum(axis=-1) for kind in (on, on & ~close, close, on | close)]
    return (np.stack(counts, axis=-1) / len(rim)).astype(np.float32)


def _cell_normals(positions: Float32Array, normals: Float32Array) -> Float32Array:  # [C, C, C, 3]
    """Return the normal of the last splat in every cell; zero where there is none."""
    out = np.zeros((CELLS, CELLS, CELLS, 3), np.float32)
    cells = _cells_of(positions)
    inside = ((cells >= 0) & (cells < CELLS)).all(axis=1)
    out[tuple(cells[inside].T)] = normals[inside]
    return out


def _cells_to_surface(occupancy: Float32Array) -> NDArray[np.uint8]:  # [C, C, C]
    """Return the distance to P in cells (largest coordinate difference), at most 3."""
    near = (torch.from_numpy(occupancy) > 0.2).float()[None]
    distance = 3 - near
    for _ in range(2):
        near = grown(near)
        distance -= near
    return distance[0].to(torch.uint8).numpy()
