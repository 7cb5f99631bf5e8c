"""P in the views of a run: what depends on P and the view alone is worked out once per view.

Rings of targets and views of V come back many times while splats are fitted to them; P's
projection, depth order, tile lists and picture are the same each time (``render.PreparedFrozen``).

Conventions
-----------
* Batches of views are known by their cameras' values. The batches used longest ago are forgotten
  when all of them take more than ``max_bytes``; forgetting costs time, never changes a result.
* Only the CPU's renderer can use more of it than the picture: gsplat draws P anew.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence

import torch
from torch import Tensor

from gscomplete.completion.settings import SkipSettings
from gscomplete.render import (
    PreparedFrozen,
    Render,
    RenderSettings,
    join_prepared,
    prepare_frozen,
    render,
)
from gscomplete.splats import Splats, concatenate
from gscomplete.views import Cameras, join_cameras

MAX_BYTES = 512 * 2**20


class PartialViews:
    """Draw P alone, or together with other splats, from views that come back."""

    def __init__(
        self, partial: Splats, skips: SkipSettings | None = None, max_bytes: int = MAX_BYTES
    ) -> None:
        """Start with no view known.

        Args:
            partial: P in the object frame; never changes.
            skips: what is left out of the work; None = all that can be.
            max_bytes: memory for what is kept.
        """
        chosen = skips or SkipSettings()
        self._partial = partial
        self._takes_gradients = not chosen.partial_gradients
        self._keeps = chosen.prepared_partial and chosen.partial_gradients
        self._max_bytes = max_bytes
        self._settings = render_settings(chosen)
        self._known: OrderedDict[tuple[float, ...], PreparedFrozen] = OrderedDict()

    @property
    def nbytes(self) -> int:
        """Memory that is kept now, in bytes."""
        return sum(prepared.nbytes for prepared in self._known.values())

    def alone(self, cameras: Cameras) -> Render:
        """Return r(P, c) over black for a batch of views; its alpha is M_c."""
        if not self._keeps:
            return render(self._partial, cameras, settings=self._settings)
        return self._prepared(cameras).picture()

    def together(
        self,
        splats: Splats,
        batches: Sequence[Cameras],
        screen_offsets: Tensor | None = None,  # [V, N, 2], V views in all batches
    ) -> Render:
        """Render P and other splats over black from batches of one image size, in order.

        Args:
            splats: the others; gradients reach them alone.
            batches: views; each batch is known for itself.
            screen_offsets: as in ``render``.
        """
        if self._takes_gradients:
            return self._as_one_set(splats, join_cameras(batches), screen_offsets)
        if self._keeps and self._partial.means.device.type == "cpu":
            frozen: Splats | PreparedFrozen
            frozen = join_prepared([self._prepared(cameras) for cameras in batches])
            views = frozen.cameras
        else:
            frozen, views = self._partial, join_cameras(batches)
        return render(
            splats,
            views,
            frozen=frozen,
            screen_offsets=screen_offsets,
            settings=self._settings,
        )

    def _as_one_set(
        self, splats: Splats, cameras: Cameras, screen_offsets: Tensor | None
    ) -> Render:
        """Render P and other splats with gradients for both; P's lead nowhere."""
        leaves = {name: value.clone().requires_grad_() for name, value in self._partial.fields()}
        if screen_offsets is not None:
            unmoved = screen_offsets.new_zeros(len(cameras), len(self._partial), 2)
            screen_offsets = torch.cat([unmoved, screen_offsets], dim=1)
        return render(
            concatenate([Splats(**leaves), splats]),
            cameras,
            screen_offsets=screen_offsets,
            settings=self._settings,
        )

    def _prepared(self, cameras: Cameras) -> PreparedFrozen:
        """Return P prepared for a batch, and forget others if there are too many."""
        key = _key(cameras)
        if key in self._known:
            self._known.move_to_end(key)
            return self._known[key]
        prepared = prepare_frozen(self._partial, cameras, self._settings)
        self._known[key] = prepared
        while len(self._known) > 1 and self.nbytes > self._max_bytes:
            self._known.popitem(last=False)
        return prepared


def render_settings(skips: SkipSettings) -> RenderSettings:
    """Return the renderer's settings with its skips on or off."""
    usual = RenderSettings()
    return RenderSettings(
        transmittance_min=usual.transmittance_min if skips.early_stop else 0.0,
        skip_idle_tiles=skips.idle_tiles,
        exact_tile_lists=skips.exact_tile_lists,
    )


def _key(cameras: Cameras) -> tuple[float, ...]:
    parts = (cameras.camera_from_world, cameras.focal_px, cameras.center_px)
    values = (number for part in parts for number in part.detach().flatten().tolist())
    return (cameras.width, cameras.height, *values)
