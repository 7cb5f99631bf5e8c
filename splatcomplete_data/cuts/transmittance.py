"""Which splats a scanner sees: those whose light the splats in front of them let through.

Conventions
-----------
* Camera axes: x right, y down, z forward. A splat is a disc in the plane of its two longest axes; a
  round splat faces the scanner.
* Light from a splat's centre is attenuated by every disc that it crosses on the way to the scanner,
  by the disc's opacity there, as in a renderer (``_seen``). Nothing is rasterised, so pixels do not
  hide their neighbours. A disc in front of the centre by less than the slack belongs to the same
  surface and is ignored.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from gscomplete.splats.geometry.neighbourhood import FLAT
from gscomplete.splats.record import Splats
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.util.arrays import BoolArray, Float64Array

_VISIBLE = 0.55
"""A splat is seen if the transmittance to it is at least this."""
_REACH_SIGMAS = 3.0
"""Radius of a disc in standard deviations."""
_LEAST_SLACK, _SLACK_SIZES = 0.003, 0.5
"""Slack perpendicular to a surface: a constant in object sizes, plus a multiple of the splat's
size."""
_ROUND_SIZES = 3.0
"""Additional multiple for round splats, which do not tell how the surface slants."""
_SQUARE = 0.15
"""Least cosine used for the slack along an oblique ray: at steeper angles it does not grow."""
_FAINT = 0.02
"""Splats with a lower opacity attenuate nothing."""
_MOST_OPAQUE = 0.999
_NEAR = 1e-4
"""Splats at most this far in front of the scanner hide nothing and are not seen."""

_ROUNDING = 1e-6
"""Cells by which a disc's extent is widened, because rays to its very edge are rounded."""


def seen_splats(
    splats: Splats,
    eye: Float64Array,  # [3]
    camera_from_object: Float64Array,  # [3, 3]
    grid: int,
    half_width: float,
) -> BoolArray:  # [N]
    """Mark the splats that a scanner sees.

    Args:
        splats: in the object frame.
        eye: where the scanner stands.
        camera_from_object: rotation into its axes.
        grid: cells along a side of the image, in which splats are looked up.
        half_width: of the image plane at depth 1; what lies beyond is not seen.
    """
    order = splats.scales.argsort(dim=1, descending=True)
    columns = (
        rotation_matrices(splats.quaternions)
        .transpose(1, 2)
        .gather(1, order[:, :, None].expand(-1, -1, 3))
    )
    axes = columns.double().numpy() @ camera_from_object.T  # [N, 3, 3] longest first
    scales = splats.scales.gather(1, order).double().numpy()
    local = (splats.means.double().numpy() - eye) @ camera_from_object.T
    distance = np.linalg.norm(local, axis=1)
    rays = local / np.maximum(distance, 1e-12)[:, None]
    is_round = scales[:, 2] >= FLAT * scales[:, 1]
    facing = np.cross(rays, np.array([0.0, 1.0, 0.0]))
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-12)
    axes[is_round] = np.stack([facing, np.cross(rays, facing), rays], axis=1)[is_round]
    typical = float(np.median(scales[:, 0]))
    cosine = np.abs((axes[:, 2] * rays).sum(axis=1))
    slack = max(_LEAST_SLACK, _SLACK_SIZES * typical) / np.maximum(cosine, _SQUARE)
    slack += np.where(is_round, _ROUND_SIZES * scales[:, 0], 0.0)
    # From this share of the way to the centre on, a disc belongs to the same surface.
    own_from = 1.0 - slack / np.maximum(distance, 1e-12)
    focal = 0.5 * grid / half_width
    sigmas = np.maximum(scales[:, :2], 1e-9)
    opacities = splats.opacities.double().numpy()
    seen: BoolArray = _seen(local, axes, sigmas, opacities, own_from, grid, focal)
    return seen


@numba.njit(cache=True)
def _seen(
    local: Any,  # [N, 3]
    axes: Any,  # [N, 3, 3] tangents, normal
    sigmas: Any,  # [N, 2]
    opacities: Any,  # [N]
    own_from: Any,  # [N]
    grid: int,
    focal: float,
) -> Any:  # [N]
    """Attenuate the light of all centres by the discs in front of them; mark those still seen."""
    first, rows = _by_cell(local, grid, focal)
    light = np.ones(len(local))
    for n in range(len(local)):
        if opacities[n] < _FAINT:
            continue
        normal = axes[n, 2]
        offset = normal[0] * local[n, 0] + normal[1] * local[n, 1] + normal[2] * local[n, 2]
        left, right, top, bottom = _extent(local[n], axes[n], sigmas[n], grid, focal)
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                cell = row * grid + column
                for m in rows[first[cell] : first[cell + 1]]:
                    if m == n or light[m] <= _VISIBLE:
                        continue
                    slope = (
                        normal[0] * local[m, 0] + normal[1] * local[m, 1] + normal[2] * local[m, 2]
                    )
                    if abs(slope) < 1e-6:
                        continue
                    share = offset / slope  # of the way to m, where it meets the disc's plane
                    if 0.0 < share < own_from[m]:
                        away = _sigmas_away(share, local[m], local[n], axes[n], sigmas[n])
                        if away < _REACH_SIGMAS * _REACH_SIGMAS:
                            opaque = min(opacities[n] * math.exp(-0.5 * away), _MOST_OPAQUE)
                            light[m] *= 1.0 - opaque
    seen = light > _VISIBLE
    for n in range(len(local)):
        z = local[n, 2]
        inside = z > _NEAR and max(abs(local[n, 0]), abs(local[n, 1])) <= 0.5 * grid * z / focal
        seen[n] = seen[n] and inside
    return seen


@numba.njit(cache=True)
def _extent(middle: Any, axes: Any, sigmas: Any, grid: int, focal: float) -> Any:
    """Return the columns and rows that the part of a disc in front of the scanner reaches."""
    low_x, high_x, low_y, high_y = np.inf, -np.inf, np.inf, -np.inf
    a, b = _REACH_SIGMAS * sigmas[0] * axes[0], _REACH_SIGMAS * sigmas[1] * axes[1]
    start = middle - a - b
    for side in range(4):  # round the rectangle about it, clipped where it comes too near
        step = 2 * a if side == 0 else 2 * b if side == 1 else -2 * a if side == 2 else -2 * b
        end = start + step
        first, last = 0.0, 1.0
        if start[2] < _NEAR and end[2] < _NEAR:
            start = end
            continue
        if start[2] < _NEAR:
            first = (_NEAR - start[2]) / step[2]
        if end[2] < _NEAR:
            last = (_NEAR - start[2]) / step[2]
        for share in (first, last):
            z = max(start[2] + share * step[2], _NEAR)
            x = focal * (start[0] + share * step[0]) / z + 0.5 * grid
            y = focal * (start[1] + share * step[1]) / z + 0.5 * grid
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
        start = end
    if not (high_x >= 0.0 and high_y >= 0.0 and low_x < grid and low_y < grid):
        return 0, -1, 0, -1
    return (
        int(max(low_x - _ROUNDING, 0.0)), int(min(high_x + _ROUNDING, grid - 1.0)),
        int(max(low_y - _ROUNDING, 0.0)), int(min(high_y + _ROUNDING, grid - 1.0)),
    )  # fmt: skip


@numba.njit(cache=True)
def _sigmas_away(share: float, target: Any, middle: Any, axes: Any, sigmas: Any) -> float:
    """Return the squared distance from a disc's middle, in its standard deviations."""
    dx, dy, dz = (
        share * target[0] - middle[0], share * target[1] - middle[1], share * target[2] - middle[2]
    )  # fmt: skip
    u = (dx * axes[0, 0] + dy * axes[0, 1] + dz * axes[0, 2]) / sigmas[0]
    v = (dx * axes[1, 0] + dy * axes[1, 1] + dz * axes[1, 2]) / sigmas[1]
    return float(u * u + v * v)


@numba.njit(cache=True)
def _by_cell(local: Any, grid: int, focal: float) -> Any:  # [N, 3] -> [cells + 1], [N]
    """Sort rows by the cell of the image that their centres fall into; the nearest one outside."""
    cells = np.zeros(len(local), np.int64)
    first = np.zeros(grid * grid + 1, np.int64)
    for n in range(len(local)):
        z = max(local[n, 2], _NEAR)
        column = min(max(focal * local[n, 0] / z + 0.5 * grid, 0.0), grid - 1.0)
        row = min(max(focal * local[n, 1] / z + 0.5 * grid, 0.0), grid - 1.0)
        cells[n] = int(row) * grid + int(column)
        first[cells[n] + 1] += 1
    first = np.cumsum(first)
    place, rows = first.copy(), np.empty(len(local), np.int64)
    for n in range(len(local)):
        rows[place[cells[n]]] = n
        place[cells[n]] += 1
    return first, rows
