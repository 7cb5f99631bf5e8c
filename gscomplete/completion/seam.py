"""Match the colours of new splats to P's where the two meet, fading with the distance.

At the seam the mean colour of P's nearest splats is compared with that of the nearest new ones.
The differences, smoothed along the seam, are added to the new splats about it: hue, saturation and
lightness shift together, and the pattern of the new splats stays.

Conventions
-----------
* Lengths are in object sizes (object frame).
* Differences are taken in Oklab (``splats.oklab``).
* Only the base band changes: colours that depend on the direction keep what depends on it. P, and
  new splats that no seam reaches, come back as they are.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from gscomplete.splats import Splats, colors_to_sh
from gscomplete.splats.geometry.nearest import query_nearest
from gscomplete.splats.oklab import oklab_from_srgb, srgb_from_oklab
from gscomplete.util.arrays import Float64Array

_LEAST_SHARE = 0.01
"""Splats get no correction where it has faded below this share."""
_REACH = 0.05
"""New splats within this distance of one of P's are at the seam."""
_SMOOTHNESS = 0.05
"""Differences are smoothed along the seam over about this length."""
_FADE = 0.1
"""The correction falls to 61 % at this distance from the seam, and to 14 % at twice that."""
_NEIGHBOURS = 16
"""Colours are means over this many splats, so that patterns are not corrected away."""
_ANCHORS = 64
"""Most splats at the seam that the correction of one new splat is interpolated from."""
_BLOCK = 20_000
"""About so many new splats are corrected at a time: each takes room for its anchors."""
_LEAST_OPACITY = 0.1
"""Fainter splats take no part."""


@dataclass(frozen=True, slots=True)
class SeamColorReport:
    """What matching did."""

    seam_splats: int
    """New splats at the seam."""
    changed: int
    """New splats whose colour changed."""
    difference_before: float
    """Mean distance in Oklab of P's and the new splats' colours at the seam; 0 without a seam."""
    difference_after: float

    @property
    def summary(self) -> str:
        """Describe what was done in one line."""
        return (
            f"seam colours: {self.changed:,} new splats changed; at the seam ({self.seam_splats:,} "
            f"splats) the difference to P goes from {self.difference_before:.4f} to "
            f"{self.difference_after:.4f} (Oklab)"
        )


def match_seam_colors(new: Splats, partial: Splats) -> tuple[Splats, SeamColorReport]:
    """Return the new splats with colours that pass into P's at the seam.

    Args:
        new: N new splats, object frame.
        partial: P, object frame.
    """
    drawn = partial.select(partial.opacities >= _LEAST_OPACITY)
    visible = torch.nonzero(new.opacities >= _LEAST_OPACITY)[:, 0]
    if len(drawn) == 0 or len(visible) == 0:
        return new, SeamColorReport(0, 0, 0.0, 0.0)
    places = new.means.detach().double().cpu().numpy()
    known = _Colors(drawn)
    ours = _Colors(new.select(visible))
    at_seam = known.distance(places[visible.cpu().numpy()]) <= _REACH
    if not at_seam.any():
        return new, SeamColorReport(0, 0, 0.0, 0.0)
    anchors = places[visible.cpu().numpy()][at_seam]
    wanted = known.mean(anchors)
    gap = wanted - ours.mean(anchors)
    shift = _spread(gap, anchors, places)
    changed = torch.from_numpy(np.abs(shift).max(axis=1) > 0)
    base = new.base_colors.detach().double().cpu().clamp(0.0, 1.0)
    matched = srgb_from_oklab(oklab_from_srgb(base) + torch.from_numpy(shift)).clamp(0.0, 1.0)
    band = colors_to_sh(matched)[:, 0].to(new.sh)
    sh = new.sh.detach().clone()
    sh[:, 0] = torch.where(changed.to(sh.device)[:, None], band, sh[:, 0])
    result = dataclasses.replace(new, sh=sh)
    after = wanted - _Colors(result.select(visible)).mean(anchors)
    before_mean, after_mean = (float(np.linalg.norm(g, axis=1).mean()) for g in (gap, after))
    return result, SeamColorReport(len(anchors), int(changed.sum()), before_mean, after_mean)


class _Colors:
    """Oklab colours of splats, averaged about a point."""

    def __init__(self, splats: Splats) -> None:
        self._tree = cKDTree(splats.means.detach().double().cpu().numpy())
        base = splats.base_colors.detach().double().cpu().clamp(0.0, 1.0)
        self._lab = oklab_from_srgb(base).numpy()
        self._nearest = list(range(1, min(_NEIGHBOURS, len(splats)) + 1))

    def distance(self, points: Float64Array) -> Float64Array:  # [M, 3] -> [M]
        """Return the distance to the nearest splat."""
        return np.asarray(self._tree.query(points)[0])

    def mean(self, points: Float64Array) -> Float64Array:  # [M, 3] -> [M, 3]
        """Return the mean colour of the nearest splats."""
        _, index = self._tree.query(points, k=self._nearest)
        return np.asarray(self._lab[index].mean(axis=1))


def _spread(
    gap: Float64Array,  # [A, 3]
    anchors: Float64Array,  # [A, 3]
    points: Float64Array,  # [N, 3]
) -> Float64Array:  # [N, 3]
    """Smooth differences at the seam along it, and let them fade with the distance from it."""
    tree = cKDTree(anchors)
    nearest = list(range(1, min(_ANCHORS, len(anchors)) + 1))
    away, _ = query_nearest(tree, points)
    fading = np.exp(-0.5 * (away / _FADE) ** 2)
    result = np.zeros((len(points), gap.shape[1]))
    for rows in np.array_split(np.flatnonzero(fading >= _LEAST_SHARE), len(points) // _BLOCK + 1):
        distance, index = query_nearest(tree, points[rows], nearest)
        # Relative to the nearest anchor, so that weights do not vanish all at once far from it.
        beyond = distance**2 - distance[:, :1] ** 2
        weight = np.exp(-0.5 * beyond / _SMOOTHNESS**2)
        weight /= weight.sum(axis=1, keepdims=True)
        result[rows] = fading[rows, None] * (weight[:, :, None] * gap[index]).sum(axis=1)
    return result
