"""mesh2splat's density: one splat per point of a grid on each triangle's dominant axis plane.

Conventions
-----------
* A triangle is projected along the axis its normal is closest to; grid points inside it, at odd
  multiples of half a step, give one cell each (mesh2splat's fragments).
* The Jacobian of a cell, surface per grid step, is a 3 x 2 matrix. Its singular values and left
  singular vectors are the cell's sizes and axes, so scales and orientation belong together
  (mesh2splat measures along the projection's axes and turns along the longest edge).
* A triangle that contains no grid point gets one cell at its centroid, and is counted.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from gscomplete.util.arrays import Float32Array, Float64Array, IntArray


def grid_cells(
    vertices: Float32Array,  # [T, 3, 3]
    normals: Float64Array,  # [T, 3]
    step: float,
) -> tuple[IntArray, Float32Array, Float32Array, Float32Array, Float32Array, int]:
    """Return triangle, weights, steps, axes and sizes as ``cells.Cells``, and the missed."""
    drop = np.abs(normals).argmax(axis=1)
    counts = np.zeros(len(vertices), np.int64)
    _visit(vertices, drop, step, counts, *_room(0))
    missed = counts == 0
    counts[missed] = 1
    room = _room(int(counts.sum()))
    _visit(vertices, drop, step, counts, *room)
    return (*room, int(missed.sum()))


def _room(
    count: int,
) -> tuple[IntArray, Float32Array, Float32Array, Float32Array, Float32Array]:
    """Make room for cells."""
    return (
        np.empty(count, np.int64),
        np.empty((count, 3), np.float32),
        np.empty((count, 2, 3), np.float32),
        np.empty((count, 2, 3), np.float32),
        np.empty((count, 2), np.float32),
    )


@numba.njit(cache=True)
def _visit(
    vertices: Float32Array,
    drop: IntArray,  # [T] axis to project along
    step: float,
    counts: IntArray,  # [T] filled in when there is no room, read otherwise
    triangle: IntArray,
    weights: Float32Array,
    steps: Float32Array,
    axes: Float32Array,
    sizes: Float32Array,
) -> None:
    """Count the grid points of every triangle, or fill in their cells."""
    counting = len(triangle) == 0
    made = 0
    for t in range(len(vertices)):
        p, q = (drop[t] + 1) % 3, (drop[t] + 2) % 3
        ax, ay = vertices[t, 0, p] / step, vertices[t, 0, q] / step
        bx, by = vertices[t, 1, p] / step - ax, vertices[t, 1, q] / step - ay
        cx, cy = vertices[t, 2, p] / step - ax, vertices[t, 2, q] / step - ay
        double = bx * cy - by * cx
        start = made
        if abs(double) > 1e-12:
            for row in range(
                math.ceil(ay + min(0.0, by, cy) - 0.5), math.floor(ay + max(0.0, by, cy) - 0.5) + 1
            ):
                for column in range(
                    math.ceil(ax + min(0.0, bx, cx) - 0.5),
                    math.floor(ax + max(0.0, bx, cx) - 0.5) + 1,
                ):
                    x, y = column + 0.5 - ax, row + 0.5 - ay
                    w1 = (x * cy - y * cx) / double
                    w2 = (bx * y - by * x) / double
                    if w1 >= 0 and w2 >= 0 and w1 + w2 <= 1:
                        if not counting:
                            triangle[made] = t
                            weights[made, 0] = 1.0 - w1 - w2
                            weights[made, 1], weights[made, 2] = w1, w2
                        made += 1
        if counting:
            counts[t] = made - start
            continue
        if made == start:
            triangle[made] = t
            weights[made] = 1.0 / 3.0
            made += 1
            _own_shape(vertices[t], steps[start], axes[start], sizes[start])
            continue
        _jacobian(vertices[t], bx, by, cx, cy, double, steps[start], axes[start], sizes[start])
        for n in range(start + 1, made):
            steps[n], axes[n], sizes[n] = steps[start], axes[start], sizes[start]


@numba.njit(cache=True)
def _jacobian(
    corners: Float32Array,  # [3, 3]
    bx: float,
    by: float,
    cx: float,
    cy: float,
    double: float,
    steps: Float32Array,  # [2, 3] out
    axes: Float32Array,  # [2, 3] out
    sizes: Float32Array,  # [2] out
) -> None:
    """Fill in axes and sizes from the singular values of surface per grid step."""
    jacobian = np.empty((3, 2))
    for axis in range(3):
        edge = float(corners[1, axis]) - float(corners[0, axis])
        other = float(corners[2, axis]) - float(corners[0, axis])
        jacobian[axis, 0] = (edge * cy - other * by) / double
        jacobian[axis, 1] = (other * bx - edge * cx) / double
    left, values, right = np.linalg.svd(jacobian, False)
    # weights (w1, w2) per grid step, turned into the singular directions
    weight = np.array([[cy, -cx], [-by, bx]]) / double
    for k in range(2):
        sizes[k] = values[k]
        w1 = weight[0, 0] * right[k, 0] + weight[0, 1] * right[k, 1]
        w2 = weight[1, 0] * right[k, 0] + weight[1, 1] * right[k, 1]
        steps[k, 0], steps[k, 1], steps[k, 2] = -0.25 * (w1 + w2), 0.25 * w1, 0.25 * w2
        for axis in range(3):
            axes[k, axis] = left[axis, k]


@numba.njit(cache=True)
def _own_shape(
    corners: Float32Array, steps: Float32Array, axes: Float32Array, sizes: Float32Array
) -> None:
    """Fill in the cell of a triangle as a whole: the spread of its corners about the centroid."""
    spread = np.empty((3, 3))
    for axis in range(3):
        middle = (corners[0, axis] + corners[1, axis] + corners[2, axis]) / 3.0
        for corner in range(3):
            spread[axis, corner] = corners[corner, axis] - middle
    left, values, _ = np.linalg.svd(spread, False)
    for k in range(2):
        # a uniform triangle's variance is a quarter of its corners'; a unit square's is 1/12
        sizes[k] = values[k] * math.sqrt(12.0 / 3.0 / 4.0)
        for axis in range(3):
            steps[k, axis] = 0.0
            axes[k, axis] = left[axis, k]
