"""Fine alignment: trimmed ICP with scale, point to plane, on exact nearest points.

Conventions
-----------
* Candidates and costs as in ``search``: part to complete cloud, in the latter's normalised frame.
* Residuals are taken along that cloud's normals, so that flat surface slides freely over itself
  whatever the sampling; a small share of point-to-point keeps spheres and planes from drifting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gscomplete.evaluate.align.nearest_grid import FloatArray
from gscomplete.evaluate.align.search import KEPT

_POINT_SHARE = 0.03
"""Weight of point-to-point residuals."""
_LARGEST_GROWTH = 0.2
"""Of the scale's logarithm in one step."""
_NEIGHBOURS = 10
"""Points that a normal is fitted to, itself among them."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A similarity from part to complete cloud, and how well they meet."""

    scale: float
    rotation: FloatArray  # [3, 3]
    translation: FloatArray  # [3]
    cost: float = np.inf

    def apply(self, points: FloatArray) -> FloatArray:  # [n, 3]
        """Take points of the part to the complete cloud."""
        return self.scale * points @ self.rotation.T + self.translation

    def undo(self, points: FloatArray) -> FloatArray:  # [n, 3]
        """Take points of the complete cloud to the part."""
        return (points - self.translation) @ self.rotation / self.scale


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A cloud with normals, ready for nearest-point queries."""

    points: FloatArray  # [n, 3]
    normals: FloatArray  # [n, 3]
    tree: cKDTree

    def subset(self, rows: np.ndarray) -> Surface:
        """Return a choice of points with the normals that all of them gave."""
        return Surface(self.points[rows], self.normals[rows], cKDTree(self.points[rows]))


def surface_of(points: FloatArray) -> Surface:  # [n, 3]
    """Fit a normal to every point's neighbourhood."""
    tree = cKDTree(points)
    _, near = tree.query(points, k=min(_NEIGHBOURS, len(points)))
    offsets = points[near] - points[near].mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    return Surface(points, axes[:, :, 0], tree)


def refine(
    start: Candidate, part: Surface, complete: Surface, covered: float, iterations: int
) -> Candidate:
    """Take ICP steps from a candidate; return the best one met."""
    current, best = start, start
    for step in range(iterations + 1):
        pairs = _Pairs(current, part, complete, covered)
        if step == 0 or pairs.cost < best.cost:
            best = Candidate(current.scale, current.rotation, current.translation, pairs.cost)
        elif pairs.cost > 1.5 * best.cost:
            break
        if step < iterations:
            current = pairs.stepped(current)
    return best


class _Pairs:
    """Nearest points of both directions, the farthest left out."""

    def __init__(self, at: Candidate, part: Surface, complete: Surface, covered: float) -> None:
        moved = at.apply(part.points)
        there, row = complete.tree.query(moved)
        back, column = part.tree.query(at.undo(complete.points))
        back = back * at.scale
        kept = np.argsort(there)[: max(4, int(KEPT * len(there)))]
        seen = np.argsort(back)[: max(4, int(covered * len(back)))]
        self.cost = float((there[kept] ** 2).mean() + (back[seen] ** 2).mean())
        self.source = np.concatenate([moved[kept], moved[column[seen]]])
        target_rows = np.concatenate([row[kept], seen])
        self.target = complete.points[target_rows]
        self.normals = complete.normals[target_rows]
        weights = np.repeat([1.0 / len(kept), 1.0 / len(seen)], [len(kept), len(seen)])
        distance = np.concatenate([there[kept], back[seen]])
        spread = 3.0 * float(np.median(distance)) + 1e-9
        self.weights = weights * np.exp(-0.5 * (distance / spread) ** 2)

    def stepped(self, at: Candidate) -> Candidate:
        """Solve for a small rotation, growth and shift about the pairs' centre (Gauss-Newton)."""
        center = np.average(self.source, axis=0, weights=self.weights)
        arm, gap = self.source - center, self.target - self.source
        n, w = self.normals, self.weights
        rows = np.concatenate([np.cross(arm, n), (arm * n).sum(1, keepdims=True), n], axis=1)
        matrix = (rows * w[:, None]).T @ rows
        right = (rows * w[:, None]).T @ (gap * n).sum(1)
        full = np.zeros((len(arm), 3, 7))
        full[:, 0, 1], full[:, 0, 2] = arm[:, 2], -arm[:, 1]
        full[:, 1, 0], full[:, 1, 2] = -arm[:, 2], arm[:, 0]
        full[:, 2, 0], full[:, 2, 1] = arm[:, 1], -arm[:, 0]
        full[:, :, 3] = arm
        full[:, [0, 1, 2], [4, 5, 6]] = 1.0
        flat, heavy = full.reshape(-1, 7), np.repeat(_POINT_SHARE * w, 3)[:, None]
        matrix += (flat * heavy).T @ flat + 1e-12 * np.eye(7)
        right += (flat * heavy).T @ gap.reshape(-1)
        solved = np.linalg.solve(matrix, right)
        turn = _rotation(solved[:3])
        growth = float(np.exp(np.clip(solved[3], -_LARGEST_GROWTH, _LARGEST_GROWTH)))
        shift = growth * turn @ (at.translation - center) + center + solved[4:]
        return Candidate(growth * at.scale, turn @ at.rotation, shift)


def _rotation(vector: FloatArray) -> FloatArray:  # [3] -> [3, 3]
    """Return the rotation about an axis by its length in radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-9:
        return np.eye(3) + cross
    first, second = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    return np.eye(3) + first * cross + second * cross @ cross
