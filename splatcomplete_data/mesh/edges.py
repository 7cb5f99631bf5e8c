"""Find the edges of a triangle soup past which splats must not bulge: borders and folds.

Conventions
-----------
* Corners at one place are one vertex, whatever their texture coordinates say.
* An edge is a border when one triangle has it, a fold when the normals of its two triangles
  differ by more than an angle; edges of three and more triangles count as folds.
* Answers are bits per triangle: bit e for the edge from corner e to corner e + 1, and bit k for
  corner k unless the surface goes on all round it, and flatly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FLAT_DEG = 5.0
"""Two triangles whose planes differ by less lie in one surface as flat as a cap's."""


def marked_edges(
    vertices: NDArray[np.float32],  # [T, 3, 3]
    normals: NDArray[np.float64],  # [T, 3] any length
    fold_deg: float,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:  # [T], [T]
    """Mark borders and folds, and the corners that the surface does not surround flatly.

    Args:
        vertices: the soup.
        normals: one per triangle; their sign does not matter.
        fold_deg: angle between two triangles' planes from which their edge is a fold.
    """
    corner = _merge(vertices.reshape(-1, 3)).reshape(-1, 3)
    following = np.roll(corner, -1, axis=1)
    low, high = np.minimum(corner, following), np.maximum(corner, following)
    key = (low.astype(np.int64) * (int(corner.max()) + 1) + high).ravel()
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    sizes = np.diff(np.append(starts, len(order)))
    sharp = sizes != 2
    pairs = starts[sizes == 2]
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    first, second = unit[order[pairs] // 3], unit[order[pairs + 1] // 3]
    cosine = np.abs(np.einsum("pc,pc->p", first, second))
    sharp[sizes == 2] = cosine < np.cos(np.radians(fold_deg))
    bent = sharp.copy()
    bent[sizes == 2] |= cosine < np.cos(np.radians(FLAT_DEG))
    flags = np.zeros((2, len(key)), np.bool_)
    flags[:, order] = np.repeat([sharp, bent], sizes, axis=1)
    edges, bends = flags.reshape(2, -1, 3)
    is_end = np.zeros(int(corner.max()) + 1, np.bool_)
    is_end[corner[bends]] = True
    is_end[following[bends]] = True
    return _bits(edges), _bits(is_end[corner])


def _bits(flags: NDArray[np.bool_]) -> NDArray[np.uint8]:  # [T, 3] -> [T]
    """Pack three flags, the first in the lowest bit."""
    return (flags * np.array([1, 2, 4], np.uint8)).sum(axis=1, dtype=np.uint8)


def _merge(points: NDArray[np.float32]) -> NDArray[np.int64]:  # [M, 3] -> [M]
    """Number the distinct points."""
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    step = max(float((high - low).max()), 1e-30) * 2.0**-20
    grid = np.rint((points - low) / step).astype(np.int64)
    keys = (grid[:, 0] << 42) | (grid[:, 1] << 21) | grid[:, 2]
    return np.unique(keys, return_inverse=True)[1].reshape(-1)
