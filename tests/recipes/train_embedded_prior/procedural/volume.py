"""Signed volumes, by which closed shapes and the sense of their normals are checked."""

from __future__ import annotations

import numpy as np

from recipes.train_embedded_prior.procedural.quads import Quads


def volume(quads: Quads) -> float:
    """Signed volume enclosed by quads (split into triangles), in float64."""
    corners = quads.corners.astype(np.float64)
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    return float(np.linalg.det(triangles).sum() / 6)
