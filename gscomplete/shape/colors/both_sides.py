"""Whether P shows both sides of a plane of symmetry, in like colours.

Then what P lacks has its mirror image's colours, patterns included. A face that P shows only once
is no such case: its mirror image lies where P shows nothing.

Conventions
-----------
* Colours are compared in Oklab; lengths are object sizes.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from gscomplete.shape.symmetry import SymmetryMap
from gscomplete.splats import Splats
from gscomplete.splats.geometry.nearest import query_nearest
from gscomplete.splats.oklab import oklab_from_srgb
from gscomplete.splats.thinning import every_nth

_MOST_COMPARED = 8000
"""About how many of P's splats are compared with those on the other side."""
_REACH, _AWAY = 0.02, 0.06
"""P shows both sides of a splat if another is this near to its mirror image, which is at least the
second distance from the splat itself: what is near the plane tells nothing."""
_NEIGHBOURS = 4
"""The colour on the other side is the mean of so many splats'."""
_LEAST_SHARE = 0.3
"""Least share of P whose other side P shows, too."""
_MOST_UNLIKE = 0.8
"""Largest mean squared difference between the colours of both sides, as a multiple of their
variance; of unrelated colours it is 2."""
_FEWEST = 30


def shows_both_sides(partial: Splats, symmetry: SymmetryMap) -> bool:
    """Say whether P shows both sides of a symmetry, in like colours.

    Args:
        partial: P in the object frame.
        symmetry: a mirror image.
    """
    chosen = every_nth(np.arange(len(partial)), _MOST_COMPARED)
    points = partial.means.float().numpy()[chosen]
    colors = oklab_from_srgb(partial.base_colors.float().clamp(0, 1)).numpy()[chosen]
    images = symmetry.apply(points)
    nearest = range(1, min(_NEIGHBOURS, len(points)) + 1)
    distance, index = query_nearest(cKDTree(points), images, nearest)
    away = np.linalg.norm(points - images, axis=1) > _AWAY
    both = away & (distance[:, 0] < _REACH)
    if both.sum() < max(_FEWEST, _LEAST_SHARE * len(points)):
        return False
    seen, opposite = colors[both], colors[index[both]].mean(axis=1)
    unlike = float(((seen - opposite) ** 2).sum(axis=1).mean())
    return unlike <= _MOST_UNLIKE * float(seen.var(axis=0).sum())
