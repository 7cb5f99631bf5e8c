"""Mirror images of P that may show what is missing.

Most objects have an upright plane of symmetry, and many have two. On real objects P's mirror image
through one well-chosen plane holds most of what is missing. ``planes.proposals`` finds likely
planes and ``symmetry_choice`` chooses among them. The shape network is given P's images through two
differing planes and through both in turn, and decides what to take from them.

Conventions
-----------
* A map takes x to ``matrix x + shift`` in the object frame.
* A map's score is the belief in its plane and those near it, in [0, 1].
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from gscomplete.splats import Splats
from gscomplete.splats.transform import multiply_quaternions, quaternion_from_rotation
from gscomplete.util.arrays import Float32Array

COPIES = 3
SOURCES = 1 + COPIES
"""Number of mirror images, and of sources: P and its mirror images."""
_ALIKE = 0.08
"""Two maps are alike if they carry P's points to places at most this far apart on average, object
sizes."""


@dataclass(frozen=True, slots=True)
class SymmetryMap:
    """A rigid map of P onto what it may lack."""

    matrix: Float32Array  # [3, 3] orthogonal
    shift: Float32Array  # [3]
    score: float

    def apply(self, points: Float32Array) -> Float32Array:  # [N, 3] -> [N, 3]
        """Map points."""
        return np.ascontiguousarray(points @ self.matrix.T + self.shift, dtype=np.float32)

    def is_like(self, other: SymmetryMap, points: Float32Array) -> bool:  # points [N, 3] of P
        """Tell whether two maps carry P to nearly the same place."""
        apart = np.linalg.norm(self.apply(points) - other.apply(points), axis=1)
        return bool(apart.mean() <= _ALIKE)

    def undo(self, points: Float32Array) -> Float32Array:  # [N, 3] -> [N, 3]
        """Map points back."""
        return np.ascontiguousarray((points - self.shift) @ self.matrix, dtype=np.float32)


def second_symmetry(
    planes: Sequence[SymmetryMap], first: int, points: Float32Array
) -> SymmetryMap:  # points [N, 3] of P
    """Return the first other plane that is not like the first one, or else simply the next."""
    others = [plane for index, plane in enumerate(planes) if index != first]
    for other in others:
        if not other.is_like(planes[first], points):
            return other
    return others[0]


def with_composition(one: SymmetryMap, other: SymmetryMap) -> tuple[SymmetryMap, ...]:
    """Return the shape network's maps: two mirror images, and one followed by the other."""
    both = SymmetryMap(
        other.matrix @ one.matrix,
        other.matrix @ one.shift + other.shift,
        0.5 * (one.score + other.score),
    )
    return one, other, both


def no_symmetries() -> tuple[SymmetryMap, ...]:  # COPIES
    """Return the shape network's maps if no mirror image is right: the identity, score 0."""
    nothing = SymmetryMap(np.eye(3, dtype=np.float32), np.zeros(3, np.float32), 0.0)
    return (nothing,) * COPIES


def plane_of(symmetry: SymmetryMap) -> tuple[float, float]:
    """Return the plane of a mirror image: its normal's azimuth in radians, and its offset.

    Undoes :func:`mirror` up to half a turn of the normal, which changes the offset's sign.
    """
    (a, b), _ = symmetry.matrix[:2, :2].tolist()
    angle = 0.5 * math.atan2(-b, -a)
    x, y, _ = symmetry.shift.tolist()
    return angle, 0.5 * (x * math.cos(angle) + y * math.sin(angle))


def mirror(angle: float, offset: float, score: float) -> SymmetryMap:
    """Return the mirror image through a plane."""
    normal = np.array([math.cos(angle), math.sin(angle), 0.0])
    matrix = np.eye(3) - 2 * np.outer(normal, normal)
    shift = 2 * offset * normal
    return SymmetryMap(matrix.astype(np.float32), shift.astype(np.float32), score)


def mirror_image(splats: Splats, symmetry: SymmetryMap) -> Splats:
    """Return the image of splats under a map.

    An ellipsoid is symmetric about its centre, so its mirror image is a rotation of it: by the
    map's matrix, or by the negative of that if it mirrors. Only base colours are kept, because
    highlights are not mirrored with an object.

    Args:
        splats: N splats in the object frame.
        symmetry: the map.

    Returns:
        N splats in the object frame, SH degree 0.
    """
    matrix = torch.from_numpy(symmetry.matrix).double()
    turn = matrix if float(torch.linalg.det(matrix)) > 0 else -matrix
    quaternion = quaternion_from_rotation(turn).to(splats.quaternions)
    plain = splats.with_sh_degree(0)
    return dataclasses.replace(
        plain,
        means=torch.from_numpy(symmetry.apply(splats.means.numpy())),
        quaternions=multiply_quaternions(quaternion, plain.quaternions),
    )
