"""Preservation of the input and agreement with a known truth (paper, section 4, "Metrics").

Conventions
-----------
* P is the partial input, O its completion, T the true complete object; all in the object frame, so
  depths are in object sizes. Colours are compared over one background, mid-grey unless told
  otherwise: no object is favoured for being as bright as what lies behind it.
* M_c, the mask, is the alpha of P's render from c. The paper weights its errors by M_c and leaves
  the normalisation open. Here an error is the weighted mean over all pixels of all views,

      E = sum(M_c * e) / sum(M_c),   e = squared difference (mean over the colour channels),

  so it does not depend on how much of the image the object fills. ``color_image_mean`` is the
  other reading, mean((M_c * difference)^2) over all pixels and channels: L_p, which is a sum over
  them, divided by their number.
* Depth is the expected camera-space z. Where O shows nothing in front of P's mask, its depth is
  undefined and the error counts as one object size.
* ``silhouette_iou`` compares complete silhouettes, P's part included, view by view: the input alone
  does not score 0, and a view from which P shows everything scores high for any completion.
* The hidden region of a view is where P shows nothing (alpha below 1/2) but O or T does (alpha at
  least 1/2): there, and only there, the completion had to be invented.
* Sums run in float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.render import Render, render
from gscomplete.splats import Splats
from gscomplete.util.device import plain_torch
from gscomplete.util.same_bits import fixed_mean, fixed_sum
from gscomplete.views import Cameras

MID_GREY = (0.5, 0.5, 0.5)
"""Background over which colours are compared."""
COVERED_ALPHA = 0.5
"""Alpha from which a pixel counts as showing the object."""
NOTHING_ALPHA = 1.0 / 255.0
"""Alpha below which a pixel has no depth."""


@dataclass(frozen=True, slots=True)
class PreservationErrors:
    """How far a completion changes P's appearance from the given views."""

    color: float
    """E_color: masked mean squared error of the colours in [0, 1]."""
    color_image_mean: float
    """Mean over pixels and channels of the squared masked difference: L_p over their number."""
    depth: float
    """E_depth: masked mean squared error of the depth, in squared object sizes."""
    mask_fraction: float
    """Share of the image that the mask covers."""
    views: int
    """Number of views averaged over."""
    color_per_view: tuple[float, ...]
    """E_color of each view; 0 where P is not visible at all."""


@dataclass(frozen=True, slots=True)
class TruthErrors:
    """How far a completion's invented part is from the true object."""

    silhouette_iou: float
    """Intersection over union of the complete silhouettes, mean over the views."""
    silhouette_missed: float
    """Share of the joined silhouettes that only T covers, mean over the views."""
    silhouette_excess: float
    """Share of the joined silhouettes that only O covers, mean over the views."""
    hidden_iou: float
    """Intersection over union of the silhouettes within the hidden region; 1 if it is empty."""
    hidden_color_psnr_db: float | None
    """Peak signal-to-noise ratio of the colours over the hidden region; None if it is empty."""
    hidden_precision: float
    """Share of O's hidden silhouette that T has too; 1 if O adds nothing."""
    hidden_recall: float
    """Share of T's hidden silhouette that O fills; 1 if T hides nothing."""
    color_psnr_db: float
    """Peak signal-to-noise ratio over all pixels where O or T shows something."""
    hidden_fraction: float
    """Share of the image that is hidden region."""
    views: int
    """Number of views averaged over."""


@plain_torch()
def preservation(
    completed: Splats,
    partial: Splats,
    cameras: Cameras,
    background: tuple[float, float, float] = MID_GREY,
) -> PreservationErrors:
    """Measure E_color and E_depth of a completion from the given views.

    Args:
        completed: O in the object frame.
        partial: P in the object frame.
        cameras: views of V, or the input view c alone.
        background: colour in [0, 1] behind both.

    Returns:
        E_color (squared colour difference) and E_depth (squared object sizes), of the paper's
        section "Metrics": means over P's mask and the views.

    Raises:
        UserError: P is not visible from any of the views.
    """
    with torch.no_grad():
        behind = partial.means.new_tensor(background)
        return preservation_of_renders(
            render(completed, cameras, behind), render(partial, cameras, behind)
        )


@plain_torch()
def against_truth(
    completed: Splats,
    partial: Splats,
    truth: Splats,
    cameras: Cameras,
    background: tuple[float, float, float] = MID_GREY,
) -> TruthErrors:
    """Compare a completion with the known complete object from the given views.

    Args:
        completed: O in the object frame.
        partial: P in the object frame.
        truth: T in the object frame.
        cameras: views all round the object, to see what P leaves open.
        background: colour in [0, 1] behind all three.

    Returns:
        Silhouette IoU in [0, 1], PSNR in dB, distances in object sizes.

    Raises:
        UserError: neither O nor T is visible from any of the views.
    """
    with torch.no_grad():
        behind = partial.means.new_tensor(background)
        renders = [render(splats, cameras, behind) for splats in (completed, partial, truth)]
        return truth_errors_of_renders(*renders)


def preservation_of_renders(completed: Render, partial: Render) -> PreservationErrors:
    """Measure E_color and E_depth from renders of O and P over one background.

    Raises:
        UserError: P's mask is empty in every view.
    """
    mask = partial.alpha.double()  # [V, H, W]
    total = float(fixed_sum(mask))
    if total <= 0.0:
        raise UserError(
            "preservation: the partial input is not visible from any of the views; check the "
            "centre, the size and the input view"
        )
    difference = completed.color.double() - partial.color.double()
    color = difference.square().mean(dim=-1)  # [V, H, W]
    depth = (completed.depth.double() - partial.depth.double()).square()
    depth = torch.where(completed.alpha < NOTHING_ALPHA, torch.ones_like(depth), depth)
    depth = torch.where(partial.alpha < NOTHING_ALPHA, torch.zeros_like(depth), depth)
    per_view = (mask * color).sum(dim=(1, 2)) / mask.sum(dim=(1, 2)).clamp_min(1e-12)
    return PreservationErrors(
        color=float(fixed_sum(mask * color)) / total,
        color_image_mean=float(fixed_mean(mask.square() * color)),
        depth=float(fixed_sum(mask * depth)) / total,
        mask_fraction=total / mask.numel(),
        views=len(mask),
        color_per_view=tuple(per_view.tolist()),
    )


def truth_errors_of_renders(completed: Render, partial: Render, truth: Render) -> TruthErrors:
    """Compare renders of O with renders of T where P shows nothing; one background for all.

    Raises:
        UserError: neither O nor T shows anything in any view.
    """
    ours = completed.alpha >= COVERED_ALPHA  # [V, H, W]
    real = truth.alpha >= COVERED_ALPHA
    either = ours | real
    if not bool(either.any()):
        raise UserError("against_truth: neither the completion nor the truth is visible")
    open_ = partial.alpha < COVERED_ALPHA
    hidden = open_ & either
    both = int((hidden & ours & real).sum())
    squared = (completed.color.double() - truth.color.double()).square().mean(dim=-1)
    joined = either.sum(dim=(1, 2))
    shared, missed, excess = (
        float((cells.sum(dim=(1, 2)) / joined.clamp_min(1))[joined > 0].mean())
        for cells in (ours & real, real & ~ours, ours & ~real)
    )
    return TruthErrors(
        silhouette_iou=shared,
        silhouette_missed=missed,
        silhouette_excess=excess,
        hidden_iou=_ratio(both, int(hidden.sum())),
        hidden_color_psnr_db=_psnr_db(squared, hidden) if bool(hidden.any()) else None,
        hidden_precision=_ratio(both, int((open_ & ours).sum())),
        hidden_recall=_ratio(both, int((open_ & real).sum())),
        color_psnr_db=_psnr_db(squared, either),
        hidden_fraction=float(hidden.double().mean()),
        views=len(hidden),
    )


def _ratio(part: int, total: int) -> float:
    """Divide counts; nothing out of nothing is all of it."""
    return part / total if total else 1.0


def _psnr_db(squared: Tensor, where: Tensor) -> float:  # [V, H, W], bool [V, H, W]
    """Peak signal-to-noise ratio of colours in [0, 1] over a region, at most 100 dB."""
    mean = max(float(fixed_mean(squared[where])), 1e-10)
    return -10.0 * math.log10(mean)
