"""Find the upright axis about which P is n-fold symmetric: barrels, cans and towers of flat sides.

The axis is first found by normals, as for surfaces of revolution, which flat sides bias. It is then
moved to where P, turned by an nth of a full turn, meets P best.

Conventions
-----------
* Points are z up; the axis is upright. Limits are in sides of P's box. Arithmetic is float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gscomplete.splats.geometry.axis_coordinates import in_box_sides, off_plane
from gscomplete.splats.geometry.neighbourhood import lie_on_surface, normals_at
from gscomplete.splats.geometry.revolution import ALONG_AXIS, upright_axis
from gscomplete.splats.rotations import turn_about_z
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import BoolArray, Float64Array

_MOST_POINTS = 6000
_FOLDS = range(5, 17)
"""Mirror images do as well for fewer; with more, things are round."""
_ROUGHLY, _FINELY = (300, 5), (1500, 10)
"""Points that are turned and steps of refinement, for all numbers of folds and for the best."""
_AXIS_POINTS = 2500
_REACHES = (0.06, 0.03)
"""Turned points are matched with P's within these distances, the first in the first half of the
steps."""
_ROBUST = 0.01
_LARGEST_STEP = 0.03
_NEIGHBOURS, _SAME_NORMAL = 6, 0.9
_NEARLY_BEST = 0.95
"""The largest number of folds counts whose fit is at least this share of the best one: what is
symmetric by eighths is so by quarters, too."""
_ROUND = 0.8
"""Round things fit nearly as well with any number of folds; of these, copied sectors would show."""
_LEAST_ROUGH_FIT, _LEAST_FIT, _LEAST_MET = 0.7, 0.85, 0.4
_LEAST_WIDTH, _LEAST_HEIGHT = 0.2, 0.1
"""P is symmetric if so many turned points meet it and then fit it, and if it is no stick and not
flat: level surfaces fit however they are turned."""


@dataclass(frozen=True, slots=True)
class NFold:
    """An n-fold symmetry about an upright axis."""

    folds: int
    center: Float64Array  # [2] x and y of the axis, in the coordinates of the points given
    is_body: BoolArray  # [N] which points have an image on P: no handle

    def rotation(self, step: int) -> Float64Array:  # [3, 3]
        """Return the turn by whole steps of the symmetry, about the z axis."""
        return turn_about_z(step * 2 * math.pi / self.folds)

    def turned(self, points: Float64Array, step: int) -> Float64Array:  # [N, 3] -> [N, 3]
        """Turn points by whole steps of the symmetry."""
        about = np.array([*self.center, 0.0])
        return (points - about) @ self.rotation(step).T + about

    def box(self, points: Float64Array) -> tuple[Float64Array, float]:  # [N, 3] -> [3]
        """Return the centre and the largest side of the box of P and its whole body."""
        body = points[self.is_body]
        whole = [points, *(self.turned(body, k) for k in range(self.folds))]
        low = np.min([part.min(axis=0) for part in whole], axis=0)
        high = np.max([part.max(axis=0) for part in whole], axis=0)
        return (low + high) / 2, float((high - low).max())


def find_n_fold(
    points: Float64Array,  # [N, 3] z up
    axes: Float64Array | None = None,  # [N, 3]
    cut: tuple[float, float] | None = None,
) -> NFold | None:
    """Return P's symmetry with the most folds, five at least; None = none, or P is better mirrored.

    Args:
        points: centres of P's splats, in any unit.
        axes: of these splats (``neighbourhood.flat_axes``); None = unknown.
        cut: as for ``revolution.find_revolution``.
    """
    within = in_box_sides(points, axes, _MOST_POINTS)
    if within is None or np.ptp(within[0][:, 2]) < _LEAST_HEIGHT:
        return None
    chosen, axes, middle, side = within
    surface = _Surface(chosen, axes)
    start = upright_axis(*surface.thinned(_AXIS_POINTS))
    if start is None:
        return None
    rough = [surface.symmetric(start.point[:2], folds, *_ROUGHLY) for folds in _FOLDS]
    fits = [found.fit for found in rough]
    best = max(fits)
    if best < _LEAST_ROUGH_FIT or min(fits) > _ROUND * best:
        return None
    likely = [found for found in rough if found.fit >= _NEARLY_BEST * best][-1]
    found = surface.symmetric(likely.center, likely.folds, *_FINELY)
    if found.fit < _LEAST_FIT or found.met < _LEAST_MET:
        return None
    placed = (points - middle) / side
    normals = normals_at(placed, chosen, surface.tree, axes)
    is_body = surface.has_image(placed, normals, found)
    radii = np.hypot(*(placed[is_body, :2] - found.center).T)
    if not is_body.any() or 2 * np.quantile(radii, 0.99) < _LEAST_WIDTH:
        return None
    fold = NFold(found.folds, found.center * side + middle[:2], is_body)
    if cut is not None and off_plane(fold.center, *cut) <= ALONG_AXIS * fold.box(points)[1]:
        return None
    return fold


@dataclass(frozen=True, slots=True)
class _Found:
    folds: int
    center: Float64Array  # [2]
    met: float
    """Share of the turned points that have P near."""
    fit: float
    """How many of those fit P's surface."""


class _Surface:
    """P's points and normals."""

    def __init__(self, points: Float64Array, axes: Float64Array | None) -> None:
        self.points, self.tree = points, cKDTree(points)
        self.normals = normals_at(points, points, self.tree, axes)

    def thinned(self, count: int) -> tuple[Float64Array, Float64Array]:
        """Return some points and their normals."""
        return every_nth(self.points, count), every_nth(self.normals, count)

    def symmetric(self, center: Float64Array, folds: int, count: int, steps: int) -> _Found:
        """Move an axis to where P meets itself best (Gauss-Newton, point to plane, robust)."""
        points, normals = self.thinned(count)
        for step in range(steps):
            reach = _REACHES[0 if 2 * step < steps else 1]
            system, right = 1e-6 * len(points) * np.eye(2), np.zeros(2)
            for way in (1, -1):
                there, facing, rotation = _turn(points, normals, center, way, folds)
                distance, index = self.tree.query(there, distance_upper_bound=reach)
                index = np.where(np.isfinite(distance), index, 0)
                alike = np.abs((self.normals[index] * facing).sum(axis=1)) > _SAME_NORMAL
                used = np.isfinite(distance) & alike
                gap = ((self.points[index] - there) * facing).sum(axis=1)[used]
                slopes = facing[used, :2] @ (np.eye(2) - rotation)
                weights = slopes / (1.0 + (gap / _ROBUST) ** 2)[:, None]
                system += weights.T @ slopes
                right += weights.T @ gap
            center = center + np.linalg.solve(system, right).clip(-_LARGEST_STEP, _LARGEST_STEP)
        met, fits = [], []
        for way in (1, -1, 2, -2):
            there, facing, _ = _turn(points, normals, center, way, folds)
            is_met, fit = self.compared(there, facing)
            met.append(is_met.mean())
            fits.append(float((fit & is_met).sum()))
        share = float(np.mean(met))
        return _Found(folds, center, share, sum(fits) / max(4 * share * len(points), 1.0))

    def compared(self, places: Float64Array, facing: Float64Array) -> tuple[BoolArray, BoolArray]:
        """Return which of N places have P near, and which lie on its surface."""
        return lie_on_surface(places, facing, self.tree, self.normals, _NEIGHBOURS, _SAME_NORMAL)

    def has_image(self, points: Float64Array, normals: Float64Array, found: _Found) -> BoolArray:
        """Mark the points that lie on P's surface after some turn."""
        marked = np.zeros(len(points), np.bool_)
        for way in range(1, found.folds):
            left = ~marked
            there, facing, _ = _turn(points[left], normals[left], found.center, way, found.folds)
            _, marked[left] = self.compared(there, facing)
        return marked


def _turn(
    points: Float64Array,  # [N, 3]
    normals: Float64Array,  # [N, 3]
    center: Float64Array,  # [2]
    way: int,
    folds: int,
) -> tuple[Float64Array, Float64Array, Float64Array]:  # [N, 3], [N, 3], [2, 2]
    """Turn points and normals by ``way`` steps; return them, and the rotation of x and y."""
    rotation = turn_about_z(way * 2 * math.pi / folds)[:2, :2]
    there, facing = points.copy(), normals.copy()
    there[:, :2] = (points[:, :2] - center) @ rotation.T + center
    facing[:, :2] = normals[:, :2] @ rotation.T
    return there, facing, rotation
