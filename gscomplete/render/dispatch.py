"""The one differentiable ``render`` call, over every backend."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.render.record import Render
from gscomplete.render.settings import RenderSettings
from gscomplete.splats import Splats
from gscomplete.views import Cameras

Backend = Literal["auto", "cpu", "cuda", "reference"]
"""``auto``: cuda for splats on a CUDA device, else cpu. ``reference``: float64 PyTorch, slow."""


def render(
    splats: Splats,
    cameras: Cameras,
    background: Tensor | None = None,  # [3] or broadcastable to [V, H, W, 3]; None = black
    *,
    frozen: Splats | None = None,
    screen_offsets: Tensor | None = None,  # [V, N, 2] pixels
    settings: RenderSettings | None = None,
    backend: Backend = "auto",
) -> Render:
    """Render splats from every camera.

    Args:
        splats: N splats in the cameras' world frame; gradients reach all their fields.
        cameras: V views of one image size.
        background: colour behind the splats.
        frozen: splats drawn together with ``splats`` that take part in occlusion but get no
            gradient, at no backward cost.
        screen_offsets: added to the projected centres. Zeros that require a gradient receive
            dL/d(centre in pixels) of every view, which densification needs.
        settings: constants of the image formation; None = the defaults.
        backend: which implementation draws.

    Returns:
        Colour over the background, alpha, and expected depth (0 where nothing is seen).

    Raises:
        UserError: the backend is not available on this machine.
    """
    settings = settings or RenderSettings()
    if backend == "auto":
        backend = "cuda" if splats.means.is_cuda else "cpu"
    if backend == "cpu":
        from gscomplete.render.cpu.rasterize import rasterize
    elif backend == "cuda":
        from gscomplete.render.cuda import rasterize
    elif backend == "reference":
        from gscomplete.render.reference import rasterize
    else:
        raise UserError(f"render: expected backend auto, cpu, cuda or reference, found {backend}")
    images = rasterize(splats, cameras, frozen, screen_offsets, settings)
    color, summed_depth, alpha = images[..., :3], images[..., 3], images[..., 4]
    if background is not None:
        color = color + (1.0 - alpha)[..., None] * background.to(color)
    depth = torch.where(alpha > 0, summed_depth / alpha.clamp_min(1e-8), 0.0)
    return Render(color, alpha, depth)
