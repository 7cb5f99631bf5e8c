"""Poses of known shapes improved, all at once: P's points come nearer to the shapes' surfaces.

The objective is the sum of P's distances from the shape, each at most ``FAR``, plus a penalty on
turning and stretching. It is minimised by iteratively reweighted least squares with
Levenberg-Marquardt damping: a step is taken if it lowers the objective.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gscomplete.shape.bank.pose import MARGIN, Pose
from gscomplete.shape.bank.store import BANK_CELLS
from gscomplete.splats.rotations import turn_about_z
from gscomplete.util.arrays import Float64Array

FAR = 0.12
"""Larger distances of P's points from a shape count as this one, in units of P's largest side."""
_TURN_STEP, _SCALE_STEP, _STIFFNESS = 0.5, 0.2, 0.03
"""A turn by the first (radians), or a change of a log scale by the second, has a penalty of
``_STIFFNESS`` squared per point of P."""
_WEIGHT = 0.3
"""Weight of a point's distance in the objective."""
_STEPS = 24
_LEAST_DISTANCE = 0.02
"""Smaller distances get the weight of this one when least squares are reweighted: about a cell of
the bank, in units of the shape's side."""
_DAMPING, _LESS, _MORE = 1e-2, 0.3, 8.0
"""Initial damping; its factor after a step that is taken; its factor after one that is refused."""


def improve_poses(
    fields: Sequence[Float64Array],  # [F, F, F] each
    begun: Sequence[tuple[int, Pose]],
    points: Float64Array,  # [N, 3]
) -> list[tuple[float, Pose]]:
    """Improve poses of shapes.

    Args:
        fields: distances from each shape's surface (``pose.distance_field``).
        begun: for every pose the index of its shape's field, and the pose to start from.
        points: P's points, scaled so that P's largest side is 1.

    Returns:
        For every pose the mean distance of the points, at most ``FAR`` each, and the improved pose.
    """
    if not begun:
        return []
    problem = _Problem(fields, begun, points)
    change = np.zeros((len(begun), 7))
    damping = np.full(len(begun), _DAMPING)
    value = problem.value(change)
    for _ in range(_STEPS):
        step = problem.step(change, damping)
        tried = problem.value(change + step)
        better = tried < value
        change, value = change + step * better[:, None], np.where(better, tried, value)
        damping = np.clip(damping * np.where(better, _LESS, _MORE), 1e-6, 1e6)
    away = problem.distances(change).mean(axis=1)
    return [(float(a), problem.pose(k, change[k])) for k, a in enumerate(away)]


class _Problem:
    """The objective; a change of a pose is the vector [yaw, shift (3), log scales (3)]."""

    def __init__(
        self,
        fields: Sequence[Float64Array],  # [F, F, F] each
        begun: Sequence[tuple[int, Pose]],
        points: Float64Array,  # [N, 3]
    ) -> None:
        self._fields = np.stack(fields)
        self._field = np.array([index for index, _ in begun])[:, None]
        self._poses = [pose for _, pose in begun]
        self._yaw = np.array([pose.yaw_rad for pose in self._poses])
        self._scales = np.array([pose.scales for pose in self._poses])
        self._shift = np.array([pose.shift for pose in self._poses])
        self._size = self._scales[:, :1]
        self._points = points
        self._stiffness = np.zeros(7)
        self._stiffness[[0, 4, 5, 6]] = 1 / np.array([_TURN_STEP, *(_SCALE_STEP,) * 3])
        self._stiffness *= _STIFFNESS * np.sqrt(len(points))

    def pose(self, k: int, change: Float64Array) -> Pose:  # [7]
        """Return the k-th pose after a change."""
        given = self._poses[k]
        scales = given.scales * _growth(change)
        return Pose(given.yaw_rad + float(change[0]), scales, given.shift + change[1:4])

    def value(self, change: Float64Array) -> Float64Array:  # [P, 7] -> [P]
        """Return the objective of every pose."""
        price = ((self._stiffness * change) ** 2).sum(axis=1)
        total: Float64Array = _WEIGHT * self.distances(change).sum(axis=1) + price
        return total

    def distances(self, change: Float64Array) -> Float64Array:  # [P, 7] -> [P, N]
        """Return the points' distances from the shapes, at most ``FAR``."""
        turned, scales = self._turned(change)
        at = scales[:, None] * turned + (self._shift + change[:, 1:4])[:, None]
        found, _ = self._looked_up(at)
        return np.minimum(found / self._size, FAR)

    def step(
        self, change: Float64Array, damping: Float64Array
    ) -> Float64Array:  # [P, 7], [P] -> [P, 7]
        """Return the damped step from a change."""
        turned, scales = self._turned(change)
        scaled = scales[:, None] * turned
        found, slope = self._looked_up(scaled + (self._shift + change[:, 1:4])[:, None])
        away = found / self._size
        slope = slope * ((away < FAR) / self._size)[..., None]
        across = np.stack([-turned[..., 1], turned[..., 0]], axis=-1) * scales[:, None, :2]
        by_yaw = (slope[..., :2] * across).sum(axis=-1, keepdims=True)
        jacobian = np.concatenate([by_yaw, slope, slope * scaled], axis=-1)  # [P, N, 7]
        weighted = jacobian * (_WEIGHT / np.maximum(away, _LEAST_DISTANCE))[..., None]
        price = 2 * self._stiffness**2
        gradient = (weighted * away[..., None]).sum(axis=1) + price * change
        square = np.einsum("pni,pnj->pij", weighted, jacobian) + np.diag(price)
        diagonal = np.einsum("pii->pi", square)
        damped = damping[:, None] * (diagonal + 1e-9)
        square[:, np.arange(7), np.arange(7)] += damped
        found_step: Float64Array = -np.linalg.solve(square, gradient[..., None])[..., 0]
        return found_step

    def _turned(self, change: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return turned points [P, N, 3] and scales [P, 3]."""
        turns = np.stack([turn_about_z(float(yaw)) for yaw in self._yaw + change[:, 0]])
        turned: Float64Array = np.einsum("pij,nj->pni", turns, self._points)
        return turned, self._scales * _growth(change)

    def _looked_up(self, at: Float64Array) -> tuple[Float64Array, Float64Array]:  # [P, N, 3]
        """Return distances [P, N] at places, by trilinear interpolation, and slopes [P, N, 3]."""
        last = self._fields.shape[1] - 1
        place = (at + 0.5 + MARGIN) * BANK_CELLS - 0.5
        inside = np.clip(place, 0.0, last - 1e-9)
        low = inside.astype(np.int64)
        x, y, z = np.moveaxis(inside - low, -1, 0)
        i, j, k = np.moveaxis(low, -1, 0)
        c = {
            (a, b, d): self._fields[self._field, i + a, j + b, k + d]
            for a in (0, 1)
            for b in (0, 1)
            for d in (0, 1)
        }
        by_z = {(a, b): c[a, b, 0] + z * (c[a, b, 1] - c[a, b, 0]) for a in (0, 1) for b in (0, 1)}
        by_y = {a: by_z[a, 0] + y * (by_z[a, 1] - by_z[a, 0]) for a in (0, 1)}
        value = by_y[0] + x * (by_y[1] - by_y[0])
        dx = by_y[1] - by_y[0]
        dy = _mixed(x, by_z[0, 1] - by_z[0, 0], by_z[1, 1] - by_z[1, 0])
        steep = {(a, b): c[a, b, 1] - c[a, b, 0] for a in (0, 1) for b in (0, 1)}
        dz = _mixed(x, *(_mixed(y, steep[a, 0], steep[a, 1]) for a in (0, 1)))
        slope = np.stack([dx, dy, dz], axis=-1) * BANK_CELLS
        return value, slope * (place == inside)


def _mixed(share: Float64Array, low: Float64Array, high: Float64Array) -> Float64Array:
    return low + share * (high - low)


def _growth(change: Float64Array) -> Float64Array:  # [..., 7] -> [..., 3]
    """Return the factors that a change scales by: logarithms change by at most 3."""
    factors: Float64Array = np.exp(np.clip(change[..., 4:], -3, 3))
    return factors
