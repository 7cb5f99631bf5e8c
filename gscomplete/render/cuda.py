"""The CUDA renderer: gsplat behind the same call as the CPU renderer.

gsplat draws the definition in ``settings`` with alpha_min = 1/255 and alpha_max = 0.999 fixed in
its kernels; other values of these are refused. It stops at a transmittance of 1e-4 in any case.

Frozen splats are detached before they are joined to the others: nothing is kept for them, but
gsplat's backward kernel still visits every splat of a tile, so unlike on the CPU they are not free.

gsplat compiles its kernels at the first use where no ready-made ones are installed, which takes
minutes and needs the CUDA toolkit; :func:`check_cuda_renderer` finds out before a run begins.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.render.record import Render, render_from_sums
from gscomplete.render.settings import RenderSettings
from gscomplete.splats import Splats, concatenate
from gscomplete.views import Cameras

_FIXED = {"alpha_min": 1.0 / 255.0, "alpha_max": 0.999}


def _gsplat() -> Any:
    """Import gsplat.

    Raises:
        UserError: gsplat is not installed, or cannot be loaded on this machine.
    """
    try:
        import gsplat
    except Exception as error:  # a failed build of its kernels raises whatever the compiler did
        raise _unusable(error) from error
    return gsplat


def check_cuda_renderer(device: torch.device) -> None:
    """Draw one splat, forward and backward, to find out whether gsplat works here.

    Raises:
        UserError: it is not installed, its kernels cannot be built, or the GPU is not supported.
    """
    one = torch.ones(1, 1, 3, device=device)
    means = torch.tensor([[0.0, 0.0, 2.0]], device=device, requires_grad=True)
    quaternions = torch.tensor([[1.0, 0.0, 0.0, 0.0]], device=device)
    splats = Splats(means, quaternions, 0.2 * one[0], 0.5 * one[0, :, 0], one)
    cameras = Cameras(torch.eye(4)[None], torch.full((1, 2), 8.0), torch.full((1, 2), 4.0), 8, 8)
    gsplat = _gsplat()
    try:
        drawn = rasterize(splats, cameras, None, None, RenderSettings())
        (drawn.color.sum() + drawn.depth.sum() + drawn.alpha.sum()).backward()
        visible = float(drawn.alpha.detach().max()) > 0.1
    except Exception as error:
        raise _unusable(error) from error
    if not visible:
        raise _unusable(f"version {getattr(gsplat, '__version__', '?')} draws nothing")


def _unusable(reason: Exception | str) -> UserError:
    text = (str(reason).strip().split("\n")[0] or type(reason).__name__)[:200]
    return UserError(
        f"rendering on CUDA needs gsplat, which cannot be used here ({text}); install the extra "
        "gscomplete[cuda] (and the CUDA toolkit, where it has to compile), or use --device cpu"
    )


def rasterize(
    splats: Splats,
    cameras: Cameras,
    frozen: Splats | None,
    offsets: Tensor | None,  # [V, N, 2]
    settings: RenderSettings,
) -> Render:
    """Draw over black; gradients reach ``splats`` and ``offsets`` only.

    Raises:
        UserError: gsplat is missing, or a setting differs from what its kernels have built in.
    """
    for name, value in _FIXED.items():
        if abs(getattr(settings, name) - value) > 1e-9:
            raise UserError(
                f"render: {name} is {value:g} in gsplat's kernels, found {getattr(settings, name)}"
            )
    gsplat = _gsplat()
    device = splats.means.device
    together = splats
    if frozen is not None:
        together = concatenate([frozen.detach().to(device), splats])
    intrinsics = torch.zeros_like(cameras.camera_from_world[:, :3, :3])
    intrinsics[:, 0, 0], intrinsics[:, 1, 1] = cameras.focal_px.unbind(1)
    intrinsics[:, :2, 2] = cameras.center_px
    intrinsics[:, 2, 2] = 1.0
    colors, alphas, meta = gsplat.rasterization(
        together.means,
        together.quaternions,
        together.scales,
        together.opacities,
        together.sh,
        cameras.camera_from_world.to(device),
        intrinsics.to(device),
        cameras.width,
        cameras.height,
        near_plane=settings.near,
        eps2d=settings.blur_px2,
        sh_degree=together.sh_degree,
        render_mode="RGB+D",
        packed=False,
    )
    if offsets is not None and offsets.requires_grad:
        _pass_center_gradients(meta["means2d"], offsets, first=len(together) - len(splats))
    return render_from_sums(torch.cat([colors, alphas], dim=-1))


def _pass_center_gradients(centers: Tensor, offsets: Tensor, first: int) -> None:
    """Give ``offsets`` the gradient of the projected centres; gsplat has no input for offsets."""

    def pass_on(gradient: Tensor) -> None:
        part = gradient[..., first:, :].reshape(offsets.shape)
        if offsets.grad_fn is not None:  # computed from other tensors, which receive the gradient
            offsets.backward(part)
        else:
            offsets.grad = part if offsets.grad is None else offsets.grad + part

    centers.register_hook(pass_on)
