"""The slow, obvious float64 twin of the renderer, in plain PyTorch.

It follows the definition in ``settings`` term by term, with no tiles, no early stop and autograd
for the gradients. Pixels are taken in blocks only to bound memory; a block considers the splats
whose pixel box at alpha_min reaches it, which leaves out nothing that the definition draws.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from gscomplete.render.record import Render, render_from_sums
from gscomplete.render.settings import MAX_VALUE, RenderSettings
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.splats.sh import evaluate_sh
from gscomplete.views import Cameras

BLOCK_PX = 32
EDGE_SLACK = 0.15


def _project(
    splats: Splats, matrix: Tensor, focal: Tensor, center: Tensor, size: Tensor, blur: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return screen centres [N, 2], blurred covariances [N, 2, 2], inverses, camera-space z [N].

    The determinant is that of the definition by Cauchy-Binet: with a c - b^2, needles of a length
    of 1e8 pixels would have no digit left.
    """
    world = matrix[:3, :3]
    points = splats.means @ world.T + matrix[:3, 3]
    depth = points[:, 2]
    safe = torch.where(depth > 0, depth, 1.0)
    ratio = points[:, :2] / safe[:, None]
    low, high = (-center - EDGE_SLACK * size) / focal, (size - center + EDGE_SLACK * size) / focal
    clamped = torch.minimum(torch.maximum(ratio, low), high)
    slope = focal / safe[:, None]  # [N, 2]
    jacobian = torch.zeros(len(splats), 2, 3, dtype=depth.dtype)
    jacobian = torch.stack(
        [
            torch.stack([slope[:, 0], jacobian[:, 0, 1], -slope[:, 0] * clamped[:, 0]], dim=1),
            torch.stack([jacobian[:, 1, 0], slope[:, 1], -slope[:, 1] * clamped[:, 1]], dim=1),
        ],
        dim=1,
    )
    factor = jacobian @ world @ rotation_matrices(splats.quaternions)
    factor = factor * splats.scales[:, None, :]
    sharp = factor @ factor.transpose(1, 2)
    covariance = sharp + blur * torch.eye(2, dtype=depth.dtype)
    minors = torch.linalg.cross(factor[:, 0], factor[:, 1])
    det = minors.square().sum(1) + blur * (sharp[:, 0, 0] + sharp[:, 1, 1]) + blur**2
    (a, b), (_, c) = (row.unbind(1) for row in covariance.unbind(1))
    adjugate = torch.stack([torch.stack([c, -b], dim=1), torch.stack([-b, a], dim=1)], dim=1)
    return ratio * focal + center, covariance, adjugate / det[:, None, None], depth


def _block(
    pixels: Tensor,  # [B, 2]
    centers: Tensor,  # [M, 2] in depth order
    inverse: Tensor,  # [M, 2, 2]
    opacities: Tensor,  # [M]
    values: Tensor,  # [M, 5] colour, depth, 1
    alpha_min: float,
    alpha_max: float,
) -> Tensor:  # [B, 5]
    """Composite M ordered splats over B pixels."""
    offset = pixels[:, None] - centers[None]
    power = 0.5 * torch.einsum("bmi,mij,bmj->bm", offset, inverse, offset)
    alpha = (opacities * torch.exp(-power)).clamp_max(alpha_max)
    alpha = torch.where(alpha >= alpha_min, alpha, 0.0)
    through = torch.cumprod(1.0 - alpha, dim=1)
    before = torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], dim=1)
    return (alpha * before) @ values


def rasterize(
    splats: Splats,
    cameras: Cameras,
    frozen: Splats | None,
    offsets: Tensor | None,  # [V, N, 2]
    settings: RenderSettings,
) -> Render:
    """Draw in float64, over black."""
    first = 0 if frozen is None else len(frozen)
    everything = splats if frozen is None else concatenate([frozen.detach(), splats])
    everything = everything.to("cpu", torch.float64)
    cameras = cameras.to("cpu", torch.float64)
    if len(cameras) == 0:
        nothing = torch.zeros(0, cameras.height, cameras.width, 5, dtype=torch.float64)
        return render_from_sums(nothing)
    views = [
        _view(everything, cameras[v], None if offsets is None else offsets[v], first, settings)
        for v in range(len(cameras))
    ]
    return render_from_sums(torch.stack(views))


def _view(
    splats: Splats,
    camera: Cameras,
    offsets: Tensor | None,  # [N, 2] for splats from ``first`` on
    first: int,
    settings: RenderSettings,
) -> Tensor:  # [H, W, 5]
    """Draw one view block by block."""
    size = torch.tensor([camera.width, camera.height], dtype=torch.float64)
    matrix, focal, center = camera.camera_from_world[0], camera.focal_px[0], camera.center_px[0]
    blur = settings.blur_px2
    centers, covariance, inverse, depth = _project(splats, matrix, focal, center, size, blur)
    if offsets is not None:
        shift = torch.cat([torch.zeros(first, 2, dtype=torch.float64), offsets.double()])
        centers = centers + shift
    direction = torch.nn.functional.normalize(splats.means - camera.positions[0], dim=1)
    colors = evaluate_sh(splats.sh, direction) + 0.5
    finite = (torch.cat([colors, depth[:, None]], dim=1).abs() < MAX_VALUE).all(dim=1)
    parts = [colors.clamp_min(0.0), depth[:, None], torch.ones_like(depth)[:, None]]
    values = torch.cat(parts, dim=1)
    drawn = (depth > settings.near) & (splats.opacities >= settings.alpha_min)
    drawn &= finite & covariance.isfinite().all(dim=(1, 2)) & (splats.opacities <= 1)
    order = torch.argsort(torch.where(drawn, depth, torch.inf), stable=True)[: int(drawn.sum())]
    reach = 2 * torch.log((splats.opacities / settings.alpha_min).clamp_min(1.0))
    half = (reach[:, None] * torch.diagonal(covariance, dim1=1, dim2=2)).sqrt().detach() + 1e-6
    rows = []
    for top in range(0, camera.height, BLOCK_PX):
        row = []
        for left in range(0, camera.width, BLOCK_PX):
            ys = torch.arange(top, min(top + BLOCK_PX, camera.height), dtype=torch.float64) + 0.5
            xs = torch.arange(left, min(left + BLOCK_PX, camera.width), dtype=torch.float64) + 0.5
            grid = torch.stack(torch.meshgrid(ys, xs, indexing="ij"), dim=-1).flip(-1)
            low, high = grid[0, 0], grid[-1, -1]
            near = ((centers + half >= low) & (centers - half <= high)).all(dim=1)
            chosen = order[near[order]]
            block = checkpoint(
                _block,
                grid.reshape(-1, 2),
                centers[chosen],
                inverse[chosen],
                splats.opacities[chosen],
                values[chosen],
                settings.alpha_min,
                settings.alpha_max,
                use_reentrant=False,
            )
            row.append(block.reshape(len(ys), len(xs), 5))
        rows.append(torch.cat(row, dim=1))
    return torch.cat(rows, dim=0)
