"""The one differentiable ``render`` call, over every backend."""

from __future__ import annotations

from typing import Any, Literal

import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.render.frozen import PreparedFrozen, PreparedView
from gscomplete.render.record import Background, Render
from gscomplete.render.settings import RenderSettings
from gscomplete.splats import Splats
from gscomplete.views import Cameras

Backend = Literal["auto", "cpu", "cuda", "reference"]
"""``auto``: cuda for splats on a CUDA device, else cpu. ``reference``: float64 PyTorch, slow."""


def render(
    splats: Splats,
    cameras: Cameras,
    background: Background | None = None,  # [3] or broadcastable to [V, H, W, 3]; None = black
    *,
    frozen: Splats | PreparedFrozen | None = None,
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
            gradient, so that they cost no time in the backward pass; or the same splats prepared
            for these cameras (:func:`prepare_frozen`), which gives the same bits in less time.
        screen_offsets: added to the projected centres. Zeros that require a gradient receive
            dL/d(centre in pixels) of every view, which densification needs.
        settings: constants of the image formation; None = the defaults.
        backend: which implementation draws.

    Returns:
        Colour over the background, alpha, and expected depth (0 where nothing is seen).

    Raises:
        UserError: the backend is not available on this machine.
        ValueError: ``frozen`` was prepared for other cameras or settings, or the offsets are not
            one for every view and splat.
    """
    settings = settings or RenderSettings()
    if screen_offsets is not None:
        shape, found = (len(cameras), len(splats), 2), tuple(screen_offsets.shape)
        if found != shape:
            raise ValueError(f"screen_offsets: expected shape {shape}, found {found}")
    chosen = _choose(backend, splats)
    if isinstance(frozen, PreparedFrozen):
        frozen.check(cameras, settings)
        if chosen != "cpu":
            frozen = frozen.splats
    drawn: Render = _backend(chosen).rasterize(splats, cameras, frozen, screen_offsets, settings)
    return drawn.over(background)


def prepare_frozen(
    frozen: Splats,
    cameras: Cameras,
    settings: RenderSettings | None = None,
    *,
    backend: Backend = "auto",
) -> PreparedFrozen:
    """Draw a frozen set alone, and keep all that its later renders with other splats can reuse.

    Args:
        frozen: splats that get no gradient, in the cameras' world frame.
        cameras: V views; the prepared value serves renders from exactly these.
        settings: constants of the image formation; None = the defaults.
        backend: which implementation draws; only renders on the CPU become faster.

    Returns:
        What ``render(..., frozen=...)`` takes for these views.

    Raises:
        UserError: the backend is not available on this machine.
    """
    settings = settings or RenderSettings()
    chosen = _choose(backend, frozen)
    with torch.no_grad():
        if chosen == "cpu":
            views = _backend(chosen).prepare_views(frozen, cameras, settings)
        else:
            drawn = _backend(chosen).rasterize(frozen, cameras, None, None, settings)
            views = tuple(PreparedView(drawn[v : v + 1], None) for v in range(len(cameras)))
    return PreparedFrozen(frozen, cameras, settings, views)


def _choose(backend: Backend, splats: Splats) -> Backend:
    """Return the backend that ``auto`` stands for."""
    if backend == "auto":
        return "cuda" if splats.means.is_cuda else "cpu"
    return backend


def _backend(name: Backend) -> Any:
    """Import a backend's module; the others may lack what they need here.

    Raises:
        UserError: there is no such backend.
    """
    if name == "cpu":
        from gscomplete.render.cpu import rasterize

        return rasterize
    if name == "cuda":
        from gscomplete.render import cuda

        return cuda
    if name == "reference":
        from gscomplete.render import reference

        return reference
    raise UserError(f"render: expected backend auto, cpu, cuda or reference, found {name}")


def choose_render_device(name: str, device: torch.device) -> tuple[torch.device, str | None]:
    """Choose where splats are rendered, next to a prior on ``device``.

    Args:
        name: what the user asked for; only ``auto`` may fall back to the CPU renderer.
        device: where the prior computes (``util.device.choose_device``).

    Returns:
        The device, and a line for the user if it is not the prior's.

    Raises:
        UserError: a CUDA device was asked for by name and cannot render.
    """
    if device.type != "cuda":
        return device, None
    from gscomplete.render.cuda import check_cuda_renderer  # it loads gsplat

    try:
        check_cuda_renderer(device)
    except UserError as error:
        if name != "auto":
            raise
        return torch.device("cpu"), f"rendering on the CPU: {error}"
    return device, None
