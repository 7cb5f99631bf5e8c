"""The CPU renderer as one autograd function over a batch of views."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from gscomplete.render.cpu import view as one_view
from gscomplete.render.frozen import PreparedFrozen, PreparedView
from gscomplete.render.record import Render, join_renders
from gscomplete.render.settings import RenderSettings
from gscomplete.splats import Splats
from gscomplete.views import Cameras

_NO_GRADIENT = tuple(np.empty((0, 0, *last), np.float32) for last in ((3,), (), ()))
"""Of a view: stands for zeros, which are neither written nor read then."""


class _Rasterize(torch.autograd.Function):
    """Colour [V, H, W, 3] over black, expected depth [V, H, W] and alpha [V, H, W]."""

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
    ) -> tuple[Tensor, Tensor, Tensor]:
        splats = Splats(means, quaternions, scales, opacities, sh)
        arrays = one_view.splat_arrays(splats)
        frozen_arrays = None if frozen is None else one_view.splat_arrays(frozen)
        drawn = _blank(cameras)
        if prepared:
            drawn = join_renders([view.picture for view in prepared])
        shifts = np.empty((len(cameras), 0, 2), np.float32)
        if offsets is not None:
            shifts = offsets.detach().contiguous().numpy()
        with_slots = any(ctx.needs_input_grad)
        views = []
        pictures = _arrays(drawn)
        numbers = one_view.camera_numbers(cameras, settings)
        for v, camera in enumerate(numbers):
            lists = one_view.list_tiles(
                frozen_arrays, arrays, shifts[v], camera, settings, with_slots=with_slots
            )
            kept = None if prepared is None else prepared[v].lists
            picture = _of_view(pictures, v)
            views.append(one_view.draw(lists, kept, camera, settings, picture))
        ctx.arrays, ctx.views, ctx.settings = arrays, views, settings
        ctx.wants_offsets = offsets is not None
        # The arrays share the splats' memory: saved as well, PyTorch notices if they are changed.
        splats_read = means, quaternions, scales, opacities, sh
        ctx.save_for_backward(drawn.color, drawn.depth, drawn.alpha, *splats_read)
        ctx.set_materialize_grads(False)
        return drawn.color, drawn.depth, drawn.alpha

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: Tensor | None) -> Any:
        color, depth, alpha, *_ = ctx.saved_tensors
        pictures = _arrays(Render(color, alpha, depth))
        given = [None if part is None else part.contiguous().numpy() for part in upstream]
        make = np.empty if ctx.views else np.zeros
        grads = [make(array.shape, np.float32) for array in ctx.arrays]
        count = len(ctx.arrays[0]) if ctx.wants_offsets else 0
        grad_offsets = np.zeros((len(ctx.views), count, 2), np.float32)
        for v, view in enumerate(ctx.views):
            grad_color, grad_depth, grad_alpha = (
                none if part is None else part[v]
                for part, none in zip(given, _NO_GRADIENT, strict=True)
            )
            one_view.differentiate(
                view,
                ctx.arrays,
                ctx.settings,
                _of_view(pictures, v),
                (grad_color, grad_depth, grad_alpha),
                grads,
                grad_offsets[v],
                is_first=v == 0,
            )
        tensors = [torch.from_numpy(grad) for grad in grads]
        offsets = torch.from_numpy(grad_offsets) if ctx.wants_offsets else None
        return (*tensors, offsets, None, None, None, None)


def _blank(cameras: Cameras) -> Render:
    """Return images of every view to write to."""
    shape = len(cameras), cameras.height, cameras.width
    color, alpha, depth = (
        torch.empty((*shape, *last), dtype=torch.float32, device="cpu") for last in ((3,), (), ())
    )
    return Render(color, alpha, depth)


def _arrays(drawn: Render) -> one_view.Picture:  # each [V, ...]
    """Return what the kernels write to, or read."""
    return drawn.color.numpy(), drawn.depth.numpy(), drawn.alpha.numpy()


def _of_view(pictures: one_view.Picture, v: int) -> one_view.Picture:
    """Return one view's part of it."""
    color, depth, alpha = pictures
    return color[v], depth[v], alpha[v]


def rasterize(
    splats: Splats,
    cameras: Cameras,
    frozen: Splats | PreparedFrozen | None,
    offsets: Tensor | None,  # [V, N, 2]
    settings: RenderSettings,
) -> Render:
    """Draw both sets together over black; gradients reach ``splats`` and ``offsets`` only."""
    prepared = None
    if isinstance(frozen, PreparedFrozen):
        if all(view.lists is not None for view in frozen.views):
            prepared, frozen = frozen.views, None
        else:
            frozen = frozen.splats
    color, depth, alpha = _Rasterize.apply(
        *(value for _, value in splats.to("cpu", torch.float32).fields()),
        None if offsets is None else offsets.to("cpu", torch.float32),
        None if frozen is None else frozen.to("cpu", torch.float32),
        prepared,
        cameras.to("cpu"),
        settings,
    )
    return Render(color, alpha, depth)


def prepare_views(
    frozen: Splats, cameras: Cameras, settings: RenderSettings
) -> tuple[PreparedView, ...]:
    """Draw ``frozen`` alone in every view and keep what drawing others with it needs."""
    arrays = one_view.splat_arrays(frozen.to("cpu", torch.float32))
    cameras = cameras.to("cpu")
    views = []
    for v, camera in enumerate(one_view.camera_numbers(cameras, settings)):
        picture = _blank(cameras[v])
        lists = one_view.prepare(arrays, camera, settings, _of_view(_arrays(picture), 0))
        views.append(PreparedView(picture, lists))
    return tuple(views)
