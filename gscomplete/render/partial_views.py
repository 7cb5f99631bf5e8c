"""P in the views of a run: whatever depends only on P and the view is computed once per view.

The views of the target rings and of V are rendered many times while splats are fitted to them; P's
projection, depth order, tile lists and picture are the same each time (``render.PreparedFrozen``).

Conventions
-----------
* Batches of views are identified by their cameras' values. When all of them take more than
  ``max_bytes``, the least recently used are dropped; that costs time but never changes a result.
* Only the CPU renderer can use more than the picture: gsplat draws P anew.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence

from torch import Tensor

from gscomplete.render import (
    PreparedFrozen,
    Render,
    join_prepared,
    prepare_frozen,
    render,
)
from gscomplete.splats import Splats
from gscomplete.views import Cameras, join_cameras

MAX_BYTES = 512 * 2**20


class PartialViews:
    """Draw P alone, or together with other splats, from views that are used repeatedly."""

    def __init__(self, partial: Splats, max_bytes: int = MAX_BYTES) -> None:
        """Start with no view known.

        Args:
            partial: P in the object frame; never changes, takes no gradients.
            max_bytes: memory for what is kept.
        """
        self._partial = partial
        self._max_bytes = max_bytes
        self._known: OrderedDict[tuple[float, ...], PreparedFrozen] = OrderedDict()
        self._nbytes = 0

    @property
    def nbytes(self) -> int:
        """Memory that is kept now, in bytes."""
        return self._nbytes

    def alone(self, cameras: Cameras) -> Render:
        """Return r(P, c) over black for a batch of views; its alpha is M_c."""
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
            batches: views; P is prepared for each batch separately.
            screen_offsets: as in ``render``.
        """
        if self._partial.means.device.type == "cpu":
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
        )

    def _prepared(self, cameras: Cameras) -> PreparedFrozen:
        """Return P prepared for a batch, and forget others if there are too many."""
        key = _key(cameras)
        if key in self._known:
            self._known.move_to_end(key)
            return self._known[key]
        prepared = prepare_frozen(self._partial, cameras)
        self._known[key] = prepared
        self._nbytes += prepared.nbytes
        while len(self._known) > 1 and self._nbytes > self._max_bytes:
            self._nbytes -= self._known.popitem(last=False)[1].nbytes
        return prepared


def _key(cameras: Cameras) -> tuple[float, ...]:
    parts = (cameras.camera_from_world, cameras.focal_px, cameras.center_px)
    values = (number for part in parts for number in part.detach().flatten().tolist())
    return (cameras.width, cameras.height, *values)
