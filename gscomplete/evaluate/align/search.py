"""Coarse alignment of a complete cloud to a part: all rotations, several scales, then ICP.

Conventions
-----------
* Two clouds in their own normalised frames (``nearest_grid``): ``part`` and ``complete``. A
  candidate maps the first to the second: ``x -> scale * rotation @ x + translation``.
* Pairs of both directions count: the nearest 90 % of those from the part to the complete cloud, and
  the nearest ``covered`` share of those from the complete cloud to the part, the share that the
  part is assumed to cover. The second kind keeps the part from shrinking into a small region of the
  complete cloud, where everything is near.
* Scales follow Horn's symmetric form, the ratio of the two spreads: with one-sided least squares,
  wrong pairs would shrink the scale.
"""

from __future__ import annotations

import numba
import numpy as np

from gscomplete.evaluate.align.nearest_grid import CELLS, REACH, NearestGrid
from gscomplete.splats.rotations import matrix_rows
from gscomplete.util.arrays import Float64Array

KEPT = 0.9
"""Share of the part's points that pairs are made of; the result may lack the rest of the part."""


def even_rotations(count: int) -> Float64Array:  # [count, 3, 3]
    """Return rotations spread evenly over SO(3): the super-Fibonacci spiral (Alexa 2022)."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, big = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    x, y, z, w = r * np.sin(alpha), r * np.cos(alpha), big * np.sin(beta), big * np.cos(beta)
    return np.moveaxis(np.array(matrix_rows(w, x, y, z)), 2, 0)


def improve(
    part: Float64Array,  # [n, 3]
    complete: Float64Array,  # [m, 3]
    part_grid: NearestGrid,
    complete_grid: NearestGrid,
    rotations: Float64Array,  # [S, 3, 3]
    scales: Float64Array,  # [S]
    translations: Float64Array,  # [S, 3]
    *,
    covered: float,
    iterations: int,
    scale_range: tuple[float, float],
) -> Float64Array:  # [S]
    """Take ICP steps from every candidate, in place; return the costs afterwards.

    A cost is the mean squared distance of the pairs, of both clouds' points, in units of the
    complete cloud's frame.
    """
    costs = np.empty(len(scales))
    _improve(
        np.ascontiguousarray(part), np.ascontiguousarray(complete),
        part_grid.index, part_grid.points, complete_grid.index, complete_grid.points,
        rotations, scales, translations, costs, covered, iterations, *scale_range,
    )  # fmt: skip
    return costs


@numba.njit(cache=True, nogil=True)
def _look_up(index, x, y, z):
    """Row of the point nearest to a place, by its cell."""
    factor = CELLS / (2.0 * REACH)
    i = min(max(int((x + REACH) * factor), 0), CELLS - 1)
    j = min(max(int((y + REACH) * factor), 0), CELLS - 1)
    k = min(max(int((z + REACH) * factor), 0), CELLS - 1)
    return index[i, j, k]


@numba.njit(cache=True, nogil=True)
def _pair(part, complete, pi, pp, wi, wp, rotation, scale, shift, source, target, squared):
    """Pair both clouds: rows of ``source`` (part's frame) and ``target`` (the other's)."""
    n, m = len(part), len(complete)
    for a in range(n):
        x = rotation @ part[a] * scale + shift
        row = _look_up(wi, x[0], x[1], x[2])
        d = 0.0
        for c in range(3):
            source[a, c] = part[a, c]
            target[a, c] = wp[row, c]
            d += (x[c] - wp[row, c]) ** 2
        squared[a] = d
    for b in range(m):
        x = rotation.T @ (complete[b] - shift) / scale
        row = _look_up(pi, x[0], x[1], x[2])
        d = 0.0
        for c in range(3):
            source[n + b, c] = pp[row, c]
            target[n + b, c] = complete[b, c]
            d += (x[c] - pp[row, c]) ** 2
        squared[n + b] = d * scale * scale


@numba.njit(cache=True, nogil=True)
def _kth_smallest(values, k):
    """Select a value by its rank from 0 on; ``values`` are reordered (Hoare's quickselect).

    ``np.partition`` does the same, but takes seven seconds to compile.
    """
    low, high = 0, len(values) - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return values[k]


@numba.njit(cache=True, nogil=True)
def _improve(
    part, complete, pi, pp, wi, wp, rotations, scales, shifts, costs, covered, iterations, low, high
):
    """Take steps from every start: pair, trim, solve for a similarity by Horn's form."""
    n, m = len(part), len(complete)
    source, target = np.empty((n + m, 3)), np.empty((n + m, 3))
    squared, weight = np.empty(n + m), np.empty(n + m)
    n_kept, m_kept = max(4, int(KEPT * n)), max(4, int(covered * m))
    for start in range(len(scales)):
        rotation, scale = rotations[start].copy(), scales[start]
        shift = shifts[start].copy()
        for step in range(iterations + 1):
            _pair(part, complete, pi, pp, wi, wp, rotation, scale, shift, source, target, squared)
            far_n = _kth_smallest(squared[:n].copy(), n_kept - 1)
            far_m = _kth_smallest(squared[n:].copy(), m_kept - 1)
            cost, total = 0.0, 0.0
            for a in range(n + m):
                kept = squared[a] <= (far_n if a < n else far_m)
                weight[a] = (1.0 / n_kept if a < n else 1.0 / m_kept) if kept else 0.0
                cost += weight[a] * squared[a]
                total += weight[a]
            costs[start] = cost
            if step == iterations:
                break
            a_mean, b_mean = np.zeros(3), np.zeros(3)
            for a in range(n + m):
                for c in range(3):
                    a_mean[c] += weight[a] * source[a, c] / total
                    b_mean[c] += weight[a] * target[a, c] / total
            moment = np.zeros((3, 3))
            a_spread, b_spread = 0.0, 0.0
            for a in range(n + m):
                if weight[a] > 0.0:
                    for c in range(3):
                        dc = target[a, c] - b_mean[c]
                        b_spread += weight[a] * dc * dc
                        a_spread += weight[a] * (source[a, c] - a_mean[c]) ** 2
                        for e in range(3):
                            moment[c, e] += weight[a] * dc * (source[a, e] - a_mean[e])
            if not (a_spread > 0.0 and b_spread > 0.0):
                costs[start] = np.inf
                break
            u, _, v = np.linalg.svd(moment)
            if np.linalg.det(u) * np.linalg.det(v) < 0.0:
                u[:, 2] = -u[:, 2]
            rotation = u @ v
            scale = min(max(np.sqrt(b_spread / a_spread), low), high)
            shift = b_mean - scale * (rotation @ a_mean)
        rotations[start], scales[start] = rotation, scale
        shifts[start] = shift
