"""Where P shows solid surface, from views all around: there is nothing to add.

Centres alone do not tell: splats of trained captures are wide, clumped and partly inside, so what
they cover may be far from all of their centres, or beyond what seems to be their rim.

Conventions
-----------
* Object frame. Views look at the origin; depth is camera-space z, pixels as in ``views.cameras``.
* The surface of a scan is only known from its own side: behind it, close by, the object may have
  another. ``is_known_all_round`` says which parts can be asked.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import minimum_filter
from torch import Tensor

from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.views import Cameras, orbit_cameras, radius_to_fit

_ELEVATIONS_DEG, _AZIMUTHS = (-15.0, 25.0), 8
_FOV_DEG, _EXTENT = 40.0, 1.5
"""Field of view, and the length through the origin that fills it."""
_SIZE_PX = 128
_SOLID_ALPHA, _RIM_PX = 0.9, 3
"""Pixels are solid if all in a square of this side about them have at least this alpha."""
_HIDING_ALPHA = 0.5
"""Pixels of a larger alpha hide what lies behind."""
_NEAR = 0.03
"""A point lies on the surface that is seen if it is at most so far before or behind it."""
_LEAST_VIEWS = 0.3
"""A point is covered if so many of the views that it is not hidden from see it on solid surface."""
_POINTS_AT_ONCE = 16_384
_NEAREST = 1e-3
"""Points nearer to a camera, or behind it, are taken for this near: none of them lies on P."""
_MOST_SHOWN = 0.8
"""Parts that no view shows more of are pieces of an object that was seen from all around."""
_WIDE, _WIDE_QUANTILE = 1.5, 0.95
"""P was trained from photos if this quantile of its splats' widths is so many times their median:
1.9 to 2.8 times for 16 captures, 1 for scans and sampled meshes."""


@dataclass(frozen=True, slots=True)
class SolidViews:
    """What is seen of splats from views all around."""

    depth: Tensor  # [V, S, S] inf where nothing hides what is behind
    is_solid: Tensor  # [V, S, S] bool
    camera_from_world: Tensor  # [V, 4, 4]
    focal_px: float

    def cover(self, points: Tensor) -> Tensor:  # [N, 3] -> [N] bool
        """Mark the points that lie on solid surface."""
        parts = [self._cover(part) for part in points.float().split(_POINTS_AT_ONCE)]
        return torch.cat(parts)

    def _cover(self, points: Tensor) -> Tensor:  # [N, 3] -> [N] bool
        # Sums of products, not a matrix product, whose rounding may depend on threads.
        x, y, z = (
            sum(row[:, [k]] * points[:, k] for k in range(3)) + row[:, [3]]
            for row in self.camera_from_world[:, :3].unbind(dim=1)
        )
        ahead = z.clamp_min(_NEAREST)
        column, row = (
            (a / ahead * self.focal_px + _SIZE_PX / 2).clamp(0, _SIZE_PX - 1).long() for a in (x, y)
        )
        view = torch.arange(len(self.depth))[:, None]
        behind = z - self.depth[view, row, column]
        is_visible = behind < _NEAR
        is_on_it = is_visible & self.is_solid[view, row, column] & (behind > -_NEAR)
        seen, on_it = is_visible.sum(dim=0), is_on_it.sum(dim=0)
        return (on_it > 0) & (on_it >= _LEAST_VIEWS * seen)


def is_known_all_round(partial: Splats, shown_at_once: float, *, ends_in_plane: bool) -> bool:
    """Say whether P's surface is known from all sides, as far as it goes.

    Args:
        partial: P.
        shown_at_once: ``outline.one_view.best_view_share`` of P's points.
        ends_in_plane: whether P was cut along a plane, as far as ``framing.cut_plane`` finds.
    """
    widths = partial.scales.amax(dim=1).double().numpy()
    is_trained = np.quantile(widths, _WIDE_QUANTILE) >= _WIDE * np.median(widths)
    return bool(ends_in_plane or shown_at_once < _MOST_SHOWN or is_trained)


@torch.no_grad()
def solid_views(splats: Splats) -> SolidViews:
    """Draw splats from all around."""
    cameras = _cameras()
    drawn = render(splats.with_sh_degree(0), cameras)
    least = minimum_filter(drawn.alpha.float().numpy(), (1, _RIM_PX, _RIM_PX))
    return SolidViews(
        torch.where(drawn.alpha > _HIDING_ALPHA, drawn.depth, torch.inf).float(),
        torch.from_numpy(least >= _SOLID_ALPHA),
        cameras.camera_from_world.float(),
        float(cameras.focal_px[0, 0]),
    )


@functools.cache
def _cameras() -> Cameras:
    """Place the views; the azimuths at each elevation lie between those of the one before."""
    rows = torch.arange(len(_ELEVATIONS_DEG), dtype=torch.float64)[:, None]
    numbers = torch.arange(_AZIMUTHS, dtype=torch.float64)[None]
    azimuths = 360.0 / _AZIMUTHS * (numbers + 0.5 * rows)
    elevations = torch.tensor(_ELEVATIONS_DEG, dtype=torch.float64)
    return orbit_cameras(
        azimuths.reshape(-1),
        elevations.repeat_interleave(_AZIMUTHS),
        radius=radius_to_fit(_EXTENT, _FOV_DEG),
        fov_deg=_FOV_DEG,
        size_px=_SIZE_PX,
    )
