"""The surface about a point, from the point's neighbours: its normal, and whether it ends there.

The places of neighbours tell the normal badly at rims, on thin walls, whose two sides they mix, and
where points are sparse. Flat splats tell it themselves, by the axis along which they are thin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.splats.record import Splats
from gscomplete.splats.rotations import thinnest_axes
from gscomplete.util.arrays import BoolArray, Float64Array

ON_RIM = 0.5
"""Points of which ``one_sidedness`` is larger are on the rim."""
_NORMAL_NEIGHBOURS = 16
FLAT = 0.5
"""A splat is flat if its least scale is smaller than this share of its middle one."""
_AGREE = 0.6
"""The axes of neighbours tell a normal if their mean squared part along it is larger: 1 if all are
parallel, 1/3 if they point anywhere."""


_SPREAD, _SAME_SURFACE, _FIT = 0.05, 0.02, 0.008
"""A surface is near within the first, its points are of the same part of it as a place within the
second across the place's normal, and the place lies on it within the third along the normal."""


def one_sidedness(ways: NDArray[np.floating]) -> NDArray[np.floating]:  # [N, K, 3] -> [N]
    """Return how much the neighbours of points lie to one side.

    Args:
        ways: offsets from each of N points to its K nearest neighbours.

    Returns:
        The length of the mean offset over the mean length of the offsets: near 0 within a surface,
        about 0.5 at a straight rim, up to 1 beyond it, and 0 without neighbours.
    """
    if ways.shape[1] == 0:
        return np.zeros(len(ways), ways.dtype)
    length = np.linalg.norm(ways, axis=2).mean(axis=1)
    return np.linalg.norm(ways.mean(axis=1), axis=1) / length.clip(1e-6)


def normals_of(
    neighbours: Float64Array,  # [N, K, 3]
) -> Float64Array:  # [N, 3]
    """Return unit normals, of either sign: the directions along which neighbours vary least.

    Args:
        neighbours: the K nearest points of each of N places.
    """
    offsets = neighbours - neighbours.mean(axis=1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))[1][:, :, 0]


def are_flat(splats: Splats) -> Tensor:  # [N] bool
    """Mark the splats that are much thinner along one axis than along the others."""
    ordered = splats.scales.sort(dim=1).values
    return ordered[:, 0] < FLAT * ordered[:, 1]


def flat_axes(splats: Splats) -> Float64Array:  # [N, 3]
    """Return the directions along which splats are thin, unit vectors; zero where not flat."""
    axes = thinnest_axes(splats.quaternions, splats.scales) * are_flat(splats)[:, None]
    return axes.double().cpu().numpy()


def normals_at(
    places: Float64Array,  # [K, 3]
    points: Float64Array,  # [N, 3]
    tree: cKDTree,
    axes: Float64Array | None = None,  # [N, 3]
) -> Float64Array:  # [K, 3]
    """Return unit normals of the surface of points, of either sign.

    Where the axes about a place agree, the normal is the direction nearest to them all, else that
    along which the points about it vary least.

    Args:
        places: where normals are asked for.
        points: of the surface.
        tree: holds the points.
        axes: of the points (``flat_axes``); None = unknown.
    """
    _, index = tree.query(places, k=_NORMAL_NEIGHBOURS + 1)
    if axes is None:
        return normals_of(points[index])
    near = axes[index]
    shares, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near) / near.shape[1])
    normals: Float64Array = vectors[:, :, 2]
    unsure = shares[:, 2] <= _AGREE
    normals[unsure] = normals_of(points[index[unsure]])
    return normals


def lie_on_surface(
    places: Float64Array,  # [K, 3]
    facing: Float64Array,  # [K, 3]
    tree: cKDTree,
    normals: Float64Array,  # [N, 3]
    neighbours: int,
    least_cosine: float,
) -> tuple[BoolArray, BoolArray]:  # [K], [K]
    """Compare oriented places with a surface that fills about one unit; normals are of either sign.

    Args:
        places: what is compared.
        facing: normals of the places.
        tree: holds the surface's points.
        normals: of these points.
        neighbours: how many of them are compared with each place.
        least_cosine: between the normals of a place and of the same part of the surface.

    Returns:
        Which places have the surface near, and which lie on a part of it that faces their way.
    """
    distance, found = tree.query(places, k=neighbours, distance_upper_bound=_SPREAD)
    near = np.isfinite(distance)
    found = np.where(near, found, 0)
    along = np.abs(((tree.data[found] - places[:, None]) * facing[:, None]).sum(axis=2))
    cosine = np.abs((normals[found] * facing[:, None]).sum(axis=2))
    across = np.sqrt((np.where(near, distance, 0.0) ** 2 - along**2).clip(0.0))
    is_same = near & (across <= _SAME_SURFACE) & (cosine >= least_cosine)
    return near[:, 0], np.where(is_same, along, np.inf).min(axis=1) < _FIT
