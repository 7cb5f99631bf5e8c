"""Where a completion changes P's appearance, seen from c and from the bounds of V.

Conventions
-----------
* Object frame; errors are those of ``error_picture``, as insets of the paper's figures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gscomplete.evaluate.pictures import LIGHT_GREY, error_picture, errors_on
from gscomplete.render import render
from gscomplete.splats import Splats, concatenate
from gscomplete.views import Cameras, ViewDistribution

_SURFACE = 0.03
"""A splat is seen where the depth of P's render is its own, up to this, in object sizes."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewErrors:
    """How far P with what was added differs from P alone."""

    pictures: list[NDArray[np.uint8]]
    """From every camera: white = not at all, red = much. [H, W, 3]."""
    on_splats: Tensor  # [N] in [0, 1]
    """On P's splats: the largest of the views that see it."""


def bounds_of(views: ViewDistribution, size_px: int) -> Cameras:
    """Return the cameras at the corners and at the midpoints of the sides of V."""
    grid = [(a, e) for a in (-1, 0, 1) for e in (-1, 0, 1) if (a, e) != (0, 0)]
    azimuths, elevations = np.array(grid, np.float64).T
    limits = np.clip(views.elevation_deg + elevations * views.elevation_range_deg, -89.0, 89.0)
    return views.cameras((views.azimuth_deg + azimuths * views.azimuth_range_deg, limits), size_px)


def view_errors(partial: Splats, added: Splats, cameras: Cameras) -> ViewErrors:
    """Compare P with what was added with P alone.

    Args:
        partial: P.
        added: new splats.
        cameras: from where.
    """
    alone, new = partial.with_sh_degree(0), added.with_sh_degree(0)
    ground = alone.means.new_tensor(LIGHT_GREY)
    with torch.no_grad():
        theirs = render(alone, cameras, ground)
        ours = render(concatenate([alone, new]), cameras, ground)
    triples = list(zip(ours.color, theirs.color, theirs.alpha, strict=True))
    errors = torch.stack([errors_on(*triple) for triple in triples])
    pictures = [np.asarray(error_picture(*triple)) for triple in triples]
    return ViewErrors(pictures, _on_splats(partial.means, errors, theirs.depth, cameras))


def _on_splats(
    means: Tensor,  # [N, 3]
    errors: Tensor,  # [V, H, W]
    depth: Tensor,  # [V, H, W]
    cameras: Cameras,
) -> Tensor:  # [N]
    """Return the largest error of the pixels at which a splat is seen; 0 where none sees it."""
    found = means.new_zeros(len(means))
    for view in range(len(cameras)):
        moved = means @ cameras.camera_from_world[view, :3, :3].T
        x, y, z = (moved + cameras.camera_from_world[view, :3, 3]).T
        focal, center = cameras.focal_px[view], cameras.center_px[view]
        column = (focal[0] * x / z + center[0]).floor().long()
        row = (focal[1] * y / z + center[1]).floor().long()
        inside = (z > 0) & (column >= 0) & (row >= 0)
        inside &= (column < cameras.width) & (row < cameras.height)
        place = row.clamp(0, cameras.height - 1), column.clamp(0, cameras.width - 1)
        seen = inside & ((depth[view][place] - z).abs() < _SURFACE)
        found = torch.where(seen, torch.maximum(found, errors[view][place]), found)
    return found
