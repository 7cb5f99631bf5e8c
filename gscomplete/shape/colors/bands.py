"""Colours that go all round a surface of revolution, such as rims, stripes and plain walls.

Where P shows one colour at the same radius and height, whatever the azimuth, what P lacks there has
it, too. Beside P the colours from elsewhere stay, because captured walls are lit unevenly and would
get a seam.

Conventions
-----------
* Colours are sRGB in [0, 1] and are compared in Oklab; lengths are object sizes.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.splats import Splats
from gscomplete.splats.geometry.axis_coordinates import Axis, Turning
from gscomplete.splats.geometry.nearest import query_nearest
from gscomplete.splats.oklab import oklab_from_srgb
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import Float64Array

_MOST_POINTS = 20_000
_PROFILE_POINTS = 2000
"""About so many places along P's profile tell the colours."""
_ALIKE = 32
"""A colour is a mean over so many points that are alike in radius, height and normal."""
_SMOOTHED = 8
"""New splats take the mean over so many of these places, which else show as specks."""
_NORMAL_REACH = 0.05
"""Length of normals beside places: both walls of a cup are kept apart."""
_VARIES = 0.04
"""Root mean square difference of the colours of points alike, in Oklab, at which their mean has a
weight of 1/e."""
_SEAM = 0.15
"""The weight rises in proportion to the distance from P up to this one."""


def with_bands(
    colors: Tensor,  # [N, 3]
    points: Tensor,  # [N, 3]
    normals: Tensor,  # [N, 3] outward
    partial: Splats,
    body: Turning,
    axis: Axis,
) -> Tensor:  # [N, 3]
    """Give new splats on a turned surface the colours that go all round P.

    Args:
        colors: from elsewhere, in [0, 1].
        points: centres of the new splats, object frame.
        normals: of the surface at the centres.
        partial: P in the object frame.
        body: points of P that turn about the axis, normals outward.
        axis: of the surface.

    Returns:
        The new colours; a smooth mix where P's colours vary a little or are near.
    """
    means = every_nth(partial.means.double().numpy(), _MOST_POINTS)
    tree = cKDTree(means)
    base = every_nth(partial.base_colors.float().clamp(0, 1).numpy(), _MOST_POINTS)
    shown = base[query_nearest(tree, axis.from_axis(body.points))[1]]
    own = _profile(body)
    some = every_nth(own, _PROFILE_POINTS)
    _, alike = query_nearest(cKDTree(own), some, range(1, min(_ALIKE, len(own)) + 1))
    lab = oklab_from_srgb(torch.from_numpy(shown)).numpy()[alike]
    varies = ((lab - lab.mean(axis=1, keepdims=True)) ** 2).sum(axis=2).mean(axis=1)
    places = points.double().numpy()
    there = _profile(Turning.about(axis, places, normals.double().numpy()))
    _, nearest = query_nearest(cKDTree(some), there, range(1, min(_SMOOTHED, len(some)) + 1))
    away, _ = query_nearest(tree, places, within=_SEAM)
    beside = (away / _SEAM).clip(0.0, 1.0)
    weight = np.exp(-varies[nearest].mean(axis=1) / _VARIES**2) * beside
    mean = shown[alike].mean(axis=1)[nearest].mean(axis=1)
    weights = torch.from_numpy(weight).float()[:, None]
    return weights * torch.from_numpy(mean) + (1 - weights) * colors


def _profile(turning: Turning) -> Float64Array:  # [M, 4]
    """Return radius, height and, in lengths, the radial and upward parts of normals."""
    places = turning.radius, turning.points[:, 2]
    facing = _NORMAL_REACH * turning.radial, _NORMAL_REACH * turning.normals[:, 2]
    return np.stack([*places, *facing], axis=1)
