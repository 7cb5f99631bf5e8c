"""Fine alignment: ICP with scale on exact nearest points, which match in normal and colour too.

Conventions
-----------
* Candidates as in ``search``: part to complete cloud, in the latter's normalised frame.
* Partners are nearest in position, normal and colour together: the rim of a thin plate finds a rim
  rather than the plate's faces, and a stripe finds a stripe. Normals have no sign, so their outer
  products are compared.
* Only the part's points have partners: what the part lacks of the complete object costs nothing.
  The cost is the mean distance of all pairs, each at most ``_FARTHEST``, in the complete cloud's
  frame.
* Residuals are point-to-plane, so that a flat surface can slide along itself however it is sampled,
  plus a small share (``point_share``) of point-to-point residuals, through which colours can move
  it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gscomplete.splats.geometry.neighbourhood import normals_of
from gscomplete.util.arrays import Float64Array

_NORMAL_LENGTH, _COLOR_LENGTH = 0.035, 0.05
"""Lengths that differences stand for: of perpendicular normals (times the root of 2), and of black
and white."""
_FARTHEST = 0.06
"""Largest distance of a pair, in position, normal and colour, that counts."""
_AS_GOOD = 1.02
"""A later step replaces the best one if its cost is at most this many times as large: costs vary as
much with the sampling."""
_KERNEL = 3.0
"""Pairs farther apart than so many median distances get a decreasing weight."""
_LARGEST_GROWTH = 0.2
"""Largest change of the log scale in one step."""
_LARGEST_GAIN_STEP = 1.5
"""Largest factor on the brightness in one step."""
_NEIGHBOURS = 10
"""Points that a normal is fitted to, the point itself among them."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A similarity from part to complete cloud, and how well they meet."""

    scale: float
    rotation: Float64Array  # [3, 3]
    translation: Float64Array  # [3]
    cost: float = np.inf
    gain: float = 1.0
    """Brightness of the complete cloud over the part's."""

    def apply(self, points: Float64Array) -> Float64Array:  # [n, 3]
        """Take points of the part to the complete cloud."""
        return self.scale * points @ self.rotation.T + self.translation

    def undo(self, points: Float64Array) -> Float64Array:  # [n, 3]
        """Take points of the complete cloud to the part."""
        return (points - self.translation) @ self.rotation / self.scale

    def beside(self, place: Float64Array, offset: Float64Array, growth: float) -> Candidate:
        """Return the candidate with a changed position and scale.

        Args:
            place: point of the part that the change of scale leaves fixed.
            offset: shift, in the part's frame.
            growth: factor on the scale.
        """
        at = self.apply((place + offset)[None])[0]
        scale = growth * self.scale
        shift = at - scale * self.rotation @ place
        return Candidate(scale, self.rotation, shift, gain=self.gain)


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A cloud with normals and colours."""

    points: Float64Array  # [n, 3]
    normals: Float64Array  # [n, 3]
    colors: Float64Array  # [n, 3]

    def subset(self, rows: np.ndarray) -> Surface:
        """Return a choice of points with the normals that all of them gave."""
        return Surface(self.points[rows], self.normals[rows], self.colors[rows])


def surface_of(points: Float64Array, colors: Float64Array | None = None) -> Surface:  # [n, 3] both
    """Fit a normal to every point's neighbourhood; without colours all points get the same one."""
    _, near = cKDTree(points).query(points, k=min(_NEIGHBOURS, len(points)))
    normals = normals_of(points[near])
    return Surface(points, normals, np.ones_like(points) if colors is None else colors)


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """The complete cloud, ready to be searched for partners."""

    surface: Surface
    tree: cKDTree

    @staticmethod
    def of(surface: Surface) -> Target:
        """Index a cloud by place, normal and colour."""
        return Target(surface, cKDTree(_joint(surface.points, surface.normals, surface.colors)))

    def refine(
        self, start: Candidate, part: Surface, iterations: int, point_share: float = 0.3
    ) -> Candidate:
        """Take ICP steps from a candidate; return the last one about as good as the best."""
        current, best, lowest = start, start, np.inf
        for step in range(iterations + 1):
            moved = current.apply(part.points)
            normals = part.normals @ current.rotation.T
            joint = _joint(moved, normals, current.gain * part.colors)
            distance, row = self.tree.query(joint)
            cost = float(np.minimum(distance, _FARTHEST).mean())
            if cost <= _AS_GOOD * lowest:
                best = dataclasses.replace(current, cost=cost)
            lowest = min(lowest, cost)
            if step == iterations:
                break
            kernel = _KERNEL * float(np.median(distance)) + 1e-9
            weights = np.exp(-0.5 * (distance / kernel) ** 2) / len(distance)
            partners = self.surface.subset(row)
            gain = _gain(part.colors, partners.colors, weights, current.gain)
            current = _stepped(current, moved, partners, weights, gain, point_share)
        return best


def _joint(
    points: Float64Array, normals: Float64Array, colors: Float64Array
) -> Float64Array:  # [n, 12]
    """Return vectors whose distances combine position, normal (without sign) and colour."""
    x, y, z = normals.T
    root = np.sqrt(2.0)
    outer = np.stack([x * x, y * y, z * z, root * x * y, root * x * z, root * y * z], axis=1)
    return np.concatenate([points, _NORMAL_LENGTH * outer, _COLOR_LENGTH * colors], axis=1)


def _gain(mine: Float64Array, theirs: Float64Array, weights: Float64Array, before: float) -> float:
    """Return the brightness of the partners over the part's, by least squares."""
    ours = float((weights[:, None] * mine**2).sum())
    found = float((weights[:, None] * mine * theirs).sum()) / max(ours, 1e-12)
    return float(np.clip(found, before / _LARGEST_GAIN_STEP, before * _LARGEST_GAIN_STEP))


def _stepped(
    at: Candidate,
    moved: Float64Array,
    partners: Surface,
    weights: Float64Array,
    gain: float,
    point_share: float,
) -> Candidate:
    """Solve for a small rotation, growth and shift about the pairs' centre (Gauss-Newton)."""
    center = np.average(moved, axis=0, weights=weights)
    arm, gap = moved - center, partners.points - moved
    n = partners.normals
    rows = np.concatenate([np.cross(arm, n), (arm * n).sum(1, keepdims=True), n], axis=1)
    matrix = (rows * weights[:, None]).T @ rows
    right = (rows * weights[:, None]).T @ (gap * n).sum(1)
    full = np.zeros((len(arm), 3, 7))
    full[:, 0, 1], full[:, 0, 2] = arm[:, 2], -arm[:, 1]
    full[:, 1, 0], full[:, 1, 2] = -arm[:, 2], arm[:, 0]
    full[:, 2, 0], full[:, 2, 1] = arm[:, 1], -arm[:, 0]
    full[:, :, 3] = arm
    full[:, [0, 1, 2], [4, 5, 6]] = 1.0
    flat, heavy = full.reshape(-1, 7), np.repeat(point_share * weights, 3)[:, None]
    matrix += (flat * heavy).T @ flat + 1e-12 * np.eye(7)
    right += (flat * heavy).T @ gap.reshape(-1)
    solved = np.linalg.solve(matrix, right)
    turn = _rotation(solved[:3])
    growth = float(np.exp(np.clip(solved[3], -_LARGEST_GROWTH, _LARGEST_GROWTH)))
    shift = growth * turn @ (at.translation - center) + center + solved[4:]
    return Candidate(growth * at.scale, turn @ at.rotation, shift, gain=gain)


def _rotation(vector: Float64Array) -> Float64Array:  # [3] -> [3, 3]
    """Return the rotation about an axis by its length in radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-9:
        return np.eye(3) + cross
    first, second = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    return np.eye(3) + first * cross + second * cross @ cross
