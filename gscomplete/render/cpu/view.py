"""One view on the CPU: project, order, list by tile, composite; and the gradients of all that.

Conventions
-----------
* ``arrays`` are the fields of ``Splats`` in declaration order as contiguous float32.
* Frozen splats come first: where depths are equal they are drawn before the trainable ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.render.cpu import layout, merge, tiles
from gscomplete.render.cpu.composite import composite
from gscomplete.render.cpu.composite_backward import composite_backward
from gscomplete.render.cpu.depth_order import depth_order
from gscomplete.render.cpu.project import project
from gscomplete.render.cpu.project_backward import project_backward
from gscomplete.render.cpu.spherical_harmonics import used_bands
from gscomplete.render.settings import RenderSettings
from gscomplete.splats import Splats
from gscomplete.util.kernels import run_kernel
from gscomplete.views import Cameras

Arrays = tuple[Any, ...]
Picture = tuple[Any, Any, Any]
"""Colour [H, W, 3], expected depth [H, W] and alpha [H, W] of a view, or gradients of them."""
MAX_ENTRIES = 2**31 - 1
"""Most entries of all tile lists of a view: they are numbered with int32."""
SHARES = 64
"""Runs of tiles that are handed to threads; what is drawn does not depend on it."""
_PER_RUN = 1024
"""Fewest splats that are handed to a thread at once."""
_TILES_PER_RUN = 64
_TILE_WORK = 4
"""Of drawing a tile beside its entries, in entries."""
_SKIP_IDLE_TILES = True
"""Copy tiles of a prepared frozen set that no other splat can change, and visit in the backward
pass only tiles that receive a gradient and show a splat that takes one. False = walk every tile:
only slower, the same bits."""


@dataclass(frozen=True, slots=True)
class TileLists:
    """Which splats are drawn in which tile of one view, before compositing."""

    packed: Any  # [N, PACKED] rows of the trainable splats in their own order
    rows: Any  # [M, PACKED] rows of all visible splats in depth order
    keys: Any  # [M] uint64 depth keys, ascending
    tile_start: Any  # [tiles + 1]
    entries: Any  # [E] ranks, tile by tile
    slots: Any  # [E] gradient row of the entry, -1 for frozen splats; [0] where there are none
    slot_start: Any  # [N + 1]


@dataclass(frozen=True, slots=True)
class FrozenLists:
    """The splats of a frozen set that can be seen in one view, whatever is drawn with them."""

    rows: Any  # [F, PACKED] float32 in depth order
    keys: Any  # [F] uint64 depth keys, ascending
    tile_start: Any  # [tiles + 1] int32
    entries: Any  # [E] int32 rows, tile by tile
    done: Any  # [tiles] int32 entries drawn where nothing else is

    @property
    def nbytes(self) -> int:
        """Memory that the arrays take, in bytes."""
        kept = (self.rows, self.keys, self.tile_start, self.entries, self.done)
        return sum(array.nbytes for array in kept)


@dataclass(frozen=True, slots=True)
class DrawnView:
    """What the backward pass of one view needs from its forward pass."""

    camera: Any
    packed: Any
    frozen_rows: Any
    rows: Any
    tile_start: Any
    entries: Any
    slots: Any
    slot_start: Any
    active: Any  # [A] tiles that were drawn, not copied
    done: Any  # [tiles]
    contributes: Any  # [E] uint8 drawn entries that are not hidden; [0] without slots


def splat_arrays(splats: Splats) -> Arrays:
    """Return the fields as arrays that the kernels read."""
    return tuple(value.detach().contiguous().numpy() for _, value in splats.fields())


def camera_numbers(cameras: Cameras, settings: RenderSettings) -> list[tuple[float, ...]]:
    """Return every camera and the settings that projection needs, as ``layout`` lists them."""
    poses = cameras.camera_from_world[:, :3].flatten(1).tolist()
    lenses = torch.cat([cameras.focal_px, cameras.center_px], dim=1).tolist()
    size = float(cameras.width), float(cameras.height)
    rest = float(settings.near), float(settings.blur_px2), float(settings.alpha_min)
    return [(*pose, *lens, *size, *rest) for pose, lens in zip(poses, lenses, strict=True)]


def list_tiles(
    frozen: Arrays | None,
    trainable: Arrays,
    offsets: Any,  # [N, 2] pixels, or [0, 2] for none
    camera: Any,
    settings: RenderSettings,
    *,
    with_slots: bool,
) -> TileLists:
    """Project both sets, order them by depth and list them tile by tile.

    Args:
        frozen: splats that get no gradient; None = none.
        trainable: the others.
        offsets: added to the projected centres of the trainable ones.
        camera: as ``layout`` lists it.
        settings: constants of the image formation.
        with_slots: whether gradients will be asked for.

    Raises:
        UserError: the lists are longer than int32 can number.
    """
    first = 0 if frozen is None else frozen[0].shape[0]
    total = first + trainable[0].shape[0]
    packed = np.empty((total, layout.PACKED), np.float32)
    depths = np.empty(total, np.float64)
    visible = np.empty(total, np.uint8)
    no_offsets = np.empty((0, 2), np.float32)
    parts = [(trainable, offsets, slice(first, total))]
    if frozen is not None:
        parts.append((frozen, no_offsets, slice(0, first)))
    for arrays, shift, place in parts:
        bands = used_bands(arrays[4]) if arrays[4].shape[1] > 1 else 1
        written = packed[place], depths[place], visible[place]
        run_kernel(project, len(arrays[0]), _PER_RUN, *arrays, bands, shift, camera, *written)
    order, keys = depth_order(visible, depths.view(np.uint64))
    rows = np.empty((len(order), layout.PACKED), np.float32)
    run_kernel(tiles.gather_ranked, len(order), _PER_RUN, packed, order, rows)
    tiles_x, tiles_y = _grid(camera)
    shape = tiles_x, tiles_y, settings.exact_tile_lists
    cursor = np.zeros((tiles.CHUNKS, tiles_x * tiles_y), np.int32)
    spans = np.empty((len(order), tiles.SPAN), np.int32)
    tile_start = np.empty(tiles_x * tiles_y + 1, np.int64)
    slot_start = np.zeros(total - first + 1, np.int64)
    chunks = tiles.CHUNKS, max(1, tiles.CHUNKS * _PER_RUN // max(len(order), 1))
    counted = spans, cursor, slot_start
    run_kernel(tiles.count_entries, *chunks, rows, order, first, *shape, *counted)
    tiles.place_entries(cursor, tile_start, slot_start)
    if tile_start[-1] > MAX_ENTRIES:
        raise UserError(
            f"render: expected at most {MAX_ENTRIES:,} pairs of a splat and a tile that it "
            f"reaches in one view, found {tile_start[-1]:,} of {total:,} splats in "
            f"{int(camera[16])} x {int(camera[17])} pixels; draw fewer or smaller splats, or a "
            "smaller picture"
        )
    entries = np.empty(tile_start[-1], np.int32)
    slots = np.empty(tile_start[-1] if with_slots else 0, np.int32)
    listed = cursor, first, slot_start, entries, slots
    run_kernel(tiles.fill_entries, *chunks, rows, order, *shape, spans, *listed)
    return TileLists(packed[first:], rows, keys, tile_start, entries, slots, slot_start)


def draw(
    lists: TileLists,
    prepared: FrozenLists | None,
    camera: Any,
    settings: RenderSettings,
    picture: Picture,  # float32: the prepared one if there is one, else any values; written
) -> DrawnView:
    """Composite all tiles, or those that differ from the prepared picture."""
    if prepared is None:
        frozen_rows = np.empty((0, layout.PACKED), np.float32)
        tile_start, entries, slots = lists.tile_start, lists.entries, lists.slots
        active = np.arange(len(tile_start) - 1, dtype=np.int32)
    else:
        frozen_rows = prepared.rows
        tile_start, entries, slots, active = _join(lists, prepared, settings)
    tiles_x, _ = _grid(camera)
    done = np.zeros(len(tile_start) - 1, np.int32)
    contributes = np.zeros(len(slots), np.uint8)
    length = np.diff(tile_start)[active]
    run_kernel(
        composite,
        SHARES,
        1,
        frozen_rows,
        lists.rows,
        tile_start,
        entries,
        active,
        _shares(length),
        tiles_x,
        np.float32(settings.alpha_min),
        np.float32(settings.alpha_max),
        np.float32(settings.transmittance_min),
        *picture,
        done,
        contributes,
    )
    return DrawnView(
        camera,
        lists.packed,
        frozen_rows,
        lists.rows,
        tile_start,
        entries,
        slots,
        lists.slot_start,
        active,
        done,
        contributes,
    )


def prepare(
    frozen: Arrays,
    camera: Any,
    settings: RenderSettings,
    picture: Picture,  # written
) -> FrozenLists:
    """Draw the frozen set alone and keep what drawing others with it needs."""
    nothing = tuple(array[:0] for array in frozen)
    no_offsets = np.empty((0, 2), np.float32)
    lists = list_tiles(frozen, nothing, no_offsets, camera, settings, with_slots=False)
    done = draw(lists, None, camera, settings, picture).done
    entries, cut_start, ranks = merge.cut_lists(
        lists.tile_start, lists.entries, done, len(lists.rows)
    )
    return FrozenLists(lists.rows[ranks], lists.keys[ranks], cut_start, entries, done)


def differentiate(
    view: DrawnView,
    trainable: Arrays,
    settings: RenderSettings,
    picture: Picture,  # that was drawn
    upstream: Picture,  # gradients of it; [0, ...] for zeros
    grads: list[Any],  # of the trainable arrays, written or added to
    grad_offsets: Any,  # [N, 2] written, or [0, 2]
    *,
    is_first: bool,
) -> None:
    """Add the view's gradients of every trainable splat; the first view's overwrite."""
    summed = np.zeros(int(view.slot_start[-1]), np.uint8)
    sums = np.empty((len(summed), layout.SUMS), np.float32)
    run_kernel(
        composite_backward,
        SHARES,
        1,
        view.frozen_rows,
        view.rows,
        view.tile_start,
        view.entries,
        view.slots,
        view.active,
        _shares(view.done[view.active]),
        _SKIP_IDLE_TILES,
        _grid(view.camera)[0],
        np.float32(settings.alpha_min),
        np.float32(settings.alpha_max),
        *picture,
        view.done,
        view.contributes,
        *upstream,
        summed,
        sums,
    )
    read = is_first, *trainable, view.camera, view.packed, view.slot_start, summed, sums
    run_kernel(project_backward, len(trainable[0]), _PER_RUN, *read, *grads, grad_offsets)


def _grid(camera: Any) -> tuple[int, int]:
    """Return the number of tiles across and down."""
    return -(-int(camera[16]) // tiles.TILE), -(-int(camera[17]) // tiles.TILE)


def _shares(work: Any) -> Any:  # [A] -> [SHARES + 1] int64
    """Cut a sequence of tasks into runs of about equal work; a thread takes whole runs."""
    ends = np.cumsum(work + _TILE_WORK, dtype=np.int64)
    total = ends[-1] if len(ends) else 0
    cuts = np.searchsorted(ends, total * np.arange(1, SHARES) // SHARES, side="right")
    return np.concatenate([[0], cuts, [len(ends)]])


def _join(lists: TileLists, prepared: FrozenLists, settings: RenderSettings) -> tuple[Any, ...]:
    """Return tile_start, entries, slots and active tiles of both sets together."""
    in_front = merge.count_in_front(prepared.keys, lists.keys)
    active, tile_start = merge.choose_active(
        prepared.tile_start,
        prepared.entries,
        prepared.done,
        lists.tile_start,
        lists.entries,
        in_front,
        _SKIP_IDLE_TILES,
    )
    entries = np.empty(tile_start[-1], np.int32)
    with_slots = len(lists.slots) == len(lists.entries)
    slots = np.empty(tile_start[-1] if with_slots else 0, np.int32)
    run_kernel(
        merge.join_entries,
        len(active),
        _TILES_PER_RUN,
        prepared.tile_start,
        prepared.entries,
        len(prepared.rows),
        lists.tile_start,
        lists.entries,
        lists.slots,
        in_front,
        active,
        tile_start,
        entries,
        slots,
    )
    return tile_start, entries, slots, active
