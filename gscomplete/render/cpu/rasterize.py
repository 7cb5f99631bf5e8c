"""The CPU renderer as one autograd function over a batch of views.

The trainable splats follow the frozen ones in the concatenated arrays (index >= ``first``). Depth
is the w-weighted sum here; ``dispatch`` turns it into the expected depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gscomplete.render.cpu import composite as comp
from gscomplete.render.cpu import layout, tiles
from gscomplete.render.cpu.project import project
from gscomplete.render.cpu.project_backward import project_backward
from gscomplete.render.settings import RenderSettings
from gscomplete.splats import Splats
from gscomplete.views import Cameras


@dataclass(frozen=True, slots=True)
class _View:
    """What the backward pass of one view needs from its forward pass."""

    camera: Any
    packed: Any
    ranked: Any
    tile_start: Any
    entries: Any
    slots: Any
    slot_start: Any
    image: Any
    done: Any


def camera_vector(cameras: Cameras, index: int, settings: RenderSettings) -> Any:  # [21]
    """Pack one camera and the settings that projection needs into a float64 vector."""
    vector = np.empty(layout.CAMERA_NUMBERS, np.float64)
    vector[:12] = cameras.camera_from_world[index, :3].double().numpy().reshape(-1)
    vector[12:14] = cameras.focal_px[index].double().numpy()
    vector[14:16] = cameras.center_px[index].double().numpy()
    vector[16:] = (
        cameras.width,
        cameras.height,
        settings.near,
        settings.blur_px2,
        settings.alpha_min,
    )
    return vector


def _draw_view(
    arrays: tuple[Any, ...], offsets: Any, camera: Any, first: int, settings: RenderSettings
) -> _View:
    """Project, order, bin and composite one view."""
    count = arrays[0].shape[0]
    width, height = int(camera[16]), int(camera[17])
    tiles_x, tiles_y = -(-width // tiles.TILE), -(-height // tiles.TILE)
    packed = np.empty((count, layout.PACKED), np.float32)
    depths = np.empty(count, np.float64)
    visible = np.empty(count, np.uint8)
    project(*arrays, offsets, camera, packed, depths, visible)
    order = tiles.depth_order(visible, depths.view(np.uint64))
    ranked = np.empty((len(order), layout.PACKED), np.float32)
    tiles.gather_ranked(packed, order, ranked)
    cursor = np.zeros((tiles.CHUNKS, tiles_x * tiles_y), np.int32)
    per_rank = np.empty(len(order), np.int32)
    tile_start = np.empty(tiles_x * tiles_y + 1, np.int64)
    slot_start = np.empty(count - first + 1, np.int64)
    tiles.count_entries(ranked, tiles_x, tiles_y, settings.alpha_min, cursor, per_rank)
    tiles.place_entries(cursor, per_rank, order, first, count - first, tile_start, slot_start)
    entries = np.empty(tile_start[-1], np.int32)
    slots = np.empty(tile_start[-1], np.int32)
    tiles.fill_entries(
        ranked,
        order,
        tiles_x,
        tiles_y,
        settings.alpha_min,
        cursor,
        first,
        slot_start,
        entries,
        slots,
    )
    image = np.empty((tiles_x * tiles_y, comp.CHANNELS * comp.PIXELS), np.float32)
    done = np.empty(tiles_x * tiles_y, np.int32)
    comp.composite(
        ranked,
        tile_start,
        entries,
        tiles_x,
        np.float32(settings.alpha_min),
        np.float32(settings.alpha_max),
        np.float32(settings.transmittance_min),
        image,
        done,
    )
    return _View(camera, packed, ranked, tile_start, entries, slots, slot_start, image, done)


def _untile(image: Tensor, width: int, height: int) -> Tensor:  # [tiles, C * 64] -> [H, W, C]
    """Put tiles side by side and cut the image out."""
    tiles_x, tiles_y = -(-width // tiles.TILE), -(-height // tiles.TILE)
    grid = image.view(tiles_y, tiles_x, comp.CHANNELS, tiles.TILE, tiles.TILE)
    flat = grid.permute(0, 3, 1, 4, 2).reshape(tiles_y * 8, tiles_x * 8, comp.CHANNELS)
    return flat[:height, :width]


def _tile(image: Tensor) -> Tensor:  # [H, W, C] -> [tiles, C * 64]
    """Cut an image into tiles, padding with zeros."""
    height, width, channels = image.shape
    tiles_x, tiles_y = -(-width // tiles.TILE), -(-height // tiles.TILE)
    padded = image.new_zeros(tiles_y * tiles.TILE, tiles_x * tiles.TILE, channels)
    padded[:height, :width] = image
    grid = padded.view(tiles_y, tiles.TILE, tiles_x, tiles.TILE, channels)
    return grid.permute(0, 2, 4, 1, 3).reshape(tiles_y * tiles_x, -1)


class _Rasterize(torch.autograd.Function):
    """Images [V, H, W, 5] of (red, green, blue, w * depth, alpha)."""

    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        quaternions: Tensor,
        scales: Tensor,
        opacities: Tensor,
        sh: Tensor,
        offsets: Tensor | None,
        frozen: Splats | None,
        cameras: Cameras,
        settings: RenderSettings,
    ) -> Tensor:
        trainable: tuple[Tensor, ...] = (means, quaternions, scales, opacities, sh)
        first = 0 if frozen is None else len(frozen)
        joined = trainable
        if frozen is not None:
            old = (value for _, value in frozen.fields())
            joined = tuple(torch.cat(pair) for pair in zip(old, trainable, strict=True))
        arrays = tuple(value.detach().contiguous().numpy() for value in joined)
        none = np.empty((0, 2), np.float32)
        views = []
        for v in range(len(cameras)):
            shift = none
            if offsets is not None:
                shift = np.zeros((arrays[0].shape[0], 2), np.float32)
                shift[first:] = offsets[v].detach().numpy()
            views.append(
                _draw_view(arrays, shift, camera_vector(cameras, v, settings), first, settings)
            )
        ctx.arrays, ctx.views, ctx.first, ctx.settings = arrays, views, first, settings
        ctx.wants_offsets = offsets is not None
        size = cameras.width, cameras.height
        if not views:
            return means.new_zeros(0, cameras.height, cameras.width, comp.CHANNELS)
        return torch.stack([_untile(torch.from_numpy(view.image), *size) for view in views])

    @staticmethod
    def backward(ctx: Any, grad_images: Tensor) -> Any:
        arrays, first, settings = ctx.arrays, ctx.first, ctx.settings
        grads = [np.zeros((a.shape[0] - first, *a.shape[1:]), np.float32) for a in arrays]
        count = arrays[0].shape[0] - first
        shape = (len(ctx.views), count, 2) if ctx.wants_offsets else (len(ctx.views), 0, 2)
        grad_offsets = np.zeros(shape, np.float32)
        for v, view in enumerate(ctx.views):
            upstream = _tile(grad_images[v]).contiguous().numpy()
            sums = np.zeros((int(view.slot_start[-1]), layout.SUMS), np.float32)
            width = int(view.camera[16])
            comp.composite_backward(
                view.ranked,
                view.tile_start,
                view.entries,
                view.slots,
                -(-width // tiles.TILE),
                np.float32(settings.alpha_min),
                np.float32(settings.alpha_max),
                view.image,
                view.done,
                upstream,
                sums,
            )
            project_backward(
                *arrays,
                view.camera,
                view.packed,
                first,
                view.slot_start,
                sums,
                *grads,
                grad_offsets[v],
            )
        tensors = [torch.from_numpy(grad) for grad in grads]
        offsets = torch.from_numpy(grad_offsets) if ctx.wants_offsets else None
        return (*tensors, offsets, None, None, None)


def rasterize(
    splats: Splats,
    cameras: Cameras,
    frozen: Splats | None,
    offsets: Tensor | None,  # [V, N, 2]
    settings: RenderSettings,
) -> Tensor:  # [V, H, W, 5]
    """Draw ``frozen`` and ``splats`` together; gradients reach ``splats`` and ``offsets`` only."""
    degree = max(splats.sh_degree, 0 if frozen is None else frozen.sh_degree)
    splats = splats.with_sh_degree(degree).to("cpu", torch.float32)
    if frozen is not None:
        frozen = frozen.with_sh_degree(degree).to("cpu", torch.float32)
    return _Rasterize.apply(
        splats.means,
        splats.quaternions,
        splats.scales,
        splats.opacities,
        splats.sh,
        offsets,
        frozen,
        cameras.to("cpu"),
        settings,
    )
