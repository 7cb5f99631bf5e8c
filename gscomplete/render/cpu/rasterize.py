"""The CPU renderer as one autograd function over a batch of views.

Depth is the w-weighted sum here; ``record`` turns it into the expected depth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from gscomplete.render.cpu import view as one_view
from gscomplete.render.cpu.composite import CHANNELS
from gscomplete.render.frozen import PreparedFrozen, PreparedView
from gscomplete.render.settings import RenderSettings
from gscomplete.splats import Splats
from gscomplete.views import Cameras


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
        prepared: tuple[PreparedView, ...] | None,
        cameras: Cameras,
        settings: RenderSettings,
    ) -> Tensor:
        splats = Splats(means, quaternions, scales, opacities, sh)
        arrays = one_view.splat_arrays(splats)
        frozen_arrays = None if frozen is None else one_view.splat_arrays(frozen)
        shape = (len(cameras), cameras.height, cameras.width, CHANNELS)
        images = torch.zeros(shape)
        if prepared:
            torch.stack([view.image for view in prepared], out=images)
        shifts = np.empty((len(cameras), 0, 2), np.float32)
        if offsets is not None:
            shifts = offsets.detach().contiguous().numpy()
        with_slots = any(ctx.needs_input_grad)
        views = []
        for v in range(len(cameras)):
            camera = one_view.camera_numbers(cameras, v, settings)
            lists = one_view.list_tiles(
                frozen_arrays, arrays, shifts[v], camera, settings, with_slots=with_slots
            )
            kept = None if prepared is None else prepared[v].lists
            views.append(one_view.draw(lists, kept, camera, settings, images[v].numpy()))
        ctx.arrays, ctx.views, ctx.settings = arrays, views, settings
        ctx.wants_offsets = offsets is not None
        ctx.save_for_backward(images)
        return images

    @staticmethod
    def backward(ctx: Any, grad_images: Tensor) -> Any:
        (images,) = ctx.saved_tensors
        upstream = grad_images.contiguous().numpy()
        grads = [np.zeros(array.shape, np.float32) for array in ctx.arrays]
        count = len(ctx.arrays[0]) if ctx.wants_offsets else 0
        grad_offsets = np.zeros((len(ctx.views), count, 2), np.float32)
        for v, view in enumerate(ctx.views):
            one_view.differentiate(
                view,
                ctx.arrays,
                ctx.settings,
                images[v].numpy(),
                upstream[v],
                grads,
                grad_offsets[v],
            )
        tensors = [torch.from_numpy(grad) for grad in grads]
        offsets = torch.from_numpy(grad_offsets) if ctx.wants_offsets else None
        return (*tensors, offsets, None, None, None, None)


def rasterize(
    splats: Splats,
    cameras: Cameras,
    frozen: Splats | PreparedFrozen | None,
    offsets: Tensor | None,  # [V, N, 2]
    settings: RenderSettings,
) -> Tensor:  # [V, H, W, 5]
    """Draw ``frozen`` and ``splats`` together; gradients reach ``splats`` and ``offsets`` only."""
    prepared = None
    if isinstance(frozen, PreparedFrozen):
        if all(view.lists is not None for view in frozen.views):
            prepared, frozen = frozen.views, None
        else:
            frozen = frozen.splats
    return _Rasterize.apply(
        *(value for _, value in splats.to("cpu", torch.float32).fields()),
        offsets,
        None if frozen is None else frozen.to("cpu", torch.float32),
        prepared,
        cameras.to("cpu"),
        settings,
    )


def prepare_views(
    frozen: Splats, cameras: Cameras, settings: RenderSettings
) -> tuple[PreparedView, ...]:
    """Draw ``frozen`` alone in every view and keep what drawing others with it needs."""
    arrays = one_view.splat_arrays(frozen.to("cpu", torch.float32))
    cameras = cameras.to("cpu")
    views = []
    for v in range(len(cameras)):
        image = torch.zeros(cameras.height, cameras.width, CHANNELS)
        camera = one_view.camera_numbers(cameras, v, settings)
        lists = one_view.prepare(arrays, camera, settings, image.numpy())
        views.append(PreparedView(image, lists))
    return tuple(views)
