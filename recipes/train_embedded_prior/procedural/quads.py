"""Small soups of quads: what every part of a procedural object is.

Conventions
-----------
* z is up. A quad's corners are (u0 v0), (u1 v0), (u1 v1), (u0 v1); d/du x d/dv points outward.
* Quads may be degenerate along one edge (poles, fans); the sampler spreads points evenly anyway.
* ``uv`` are surface coordinates in units of length, for patterns. Around closed sections u is
  stretched to a multiple of ``SEAM_UNIT``, so that patterns with a whole number of periods per
  seam unit close without a seam.
* ``feature`` is the half-thickness of a thin part (None: thick): discs are kept smaller than it.
  For solids it is the middle half size: rods are thin, plates are not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from gscomplete.util.arrays import Float32Array

SEAM_UNIT = 0.25


@dataclass(frozen=True, slots=True)
class Quads:
    """Q quads with surface coordinates."""

    corners: Float32Array  # [Q, 4, 3]
    uv: Float32Array  # [Q, 4, 2]
    feature: float | None = None

    def moved(self, turn: ArrayLike | None, at: Sequence[float]) -> Quads:
        """Return the quads after ``x -> turn x + at``; ``turn`` is [3, 3] or None."""
        corners = self.corners
        if turn is not None:
            corners = corners @ np.asarray(turn, np.float32).T
        return replace(self, corners=corners + np.asarray(at, np.float32))

    def stretched(self, x: float, y: float, z: float) -> Quads:
        """Return the quads scaled along the axes by positive factors."""
        return replace(self, corners=self.corners * np.array([x, y, z], np.float32))


def join(parts: Sequence[Quads]) -> Quads:
    """Join quads into one soup with the smallest feature among them."""
    features = [part.feature for part in parts if part.feature is not None]
    return Quads(
        np.concatenate([part.corners for part in parts]),
        np.concatenate([part.uv for part in parts]),
        min(features) if features else None,
    )


def turn_about(axis: str, angle_deg: float) -> Float32Array:
    """Return the [3, 3] right-handed rotation about the x, y or z axis."""
    cos, sin = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    rows = {
        "x": [[1, 0, 0], [0, cos, -sin], [0, sin, cos]],
        "y": [[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]],
        "z": [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]],
    }
    return np.array(rows[axis], np.float32)


def grid(vertices: Float32Array, uv: Float32Array, feature: float | None = None) -> Quads:
    """Turn a vertex grid [R+1, C+1, 3] (v along rows, u along columns) into R x C quads."""

    def corners_of(a: Float32Array) -> Float32Array:
        quads = np.stack([a[:-1, :-1], a[:-1, 1:], a[1:, 1:], a[1:, :-1]], axis=2)
        return quads.reshape(-1, 4, a.shape[-1])

    return Quads(corners_of(vertices), corners_of(uv), feature)


def seam_length(length: float) -> float:
    """Round a closed length to a whole number of seam units, at least one."""
    return max(1, round(length / SEAM_UNIT)) * SEAM_UNIT


def arc_lengths(path: Float32Array) -> Float32Array:  # [P, D] -> [P]
    """Return the distance travelled along a polyline at each of its points."""
    steps = np.sqrt(np.square(np.diff(path, axis=0)).sum(axis=1))
    return np.concatenate([np.zeros(1, np.float32), np.cumsum(steps)]).astype(np.float32)
