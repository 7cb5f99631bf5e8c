"""The numbers of a run, as JSON.

Conventions
-----------
* Names follow the paper: E_color, E_depth, E_LPIPS, S_CLIP; ``metrics`` says how each is computed.
* A number that cannot be had is reported as unavailable with the reason, never replaced by another.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import torch

from gscomplete.evaluate.geometry import HiddenSurfaceErrors, hidden_surface_errors
from gscomplete.evaluate.haarpsi import haarpsi
from gscomplete.evaluate.metrics import (
    COVERED_ALPHA,
    MID_GREY,
    PreservationErrors,
    TruthErrors,
    preservation,
    preservation_of_renders,
    truth_errors_of_renders,
)
from gscomplete.evaluate.patches import patch_distance
from gscomplete.evaluate.perceptual import Unavailable, clip_similarity, lpips_error
from gscomplete.evaluate.ssim import ssim_map
from gscomplete.render import Render, render
from gscomplete.splats import Splats
from gscomplete.util.device import plain_torch
from gscomplete.views import ViewDistribution


@dataclass(frozen=True, slots=True)
class EvaluationSettings:
    """Knobs of an evaluation."""

    views: int = 16
    """Views of V averaged over, none of which anything was fitted to."""
    truth_views: int = 12
    """Views round the object at which a known truth is compared."""
    size_px: int = 256
    """Side of the renders (the paper's prior works at 256)."""


@dataclass(frozen=True, slots=True)
class TruthPictures:
    """How similar a completion and the true object appear from all round."""

    hidden_ssim: float | None
    """Mean SSIM over the hidden region; None if it is empty."""
    haarpsi: float
    """Mean HaarPSI of the views, over all pixels that either covers."""
    patches: float | None
    """Distance of the patches of the hidden region, as of colours; None if it is empty."""


@dataclass(frozen=True, slots=True)
class EvaluationReport:
    """Everything measured about one completion."""

    input_view: PreservationErrors
    """E_color and E_depth from the input view c alone, as the paper reports them."""
    all_views: PreservationErrors
    """E_color and E_depth over the view distribution V."""
    haarpsi: float
    """Mean HaarPSI of O to P over V, weighted by M_c; 1 = P's appearance is unchanged."""
    lpips: float | Unavailable
    """E_LPIPS from the input view c."""
    clip: float | Unavailable
    """S_CLIP between P from c and the completion from four sides."""
    truth: TruthErrors | None = None
    """Agreement with the known complete object; None when it is not known."""
    truth_pictures: TruthPictures | None = None
    """Likeness to it."""
    truth_surface: HiddenSurfaceErrors | None = None
    """Distances of the new surface to it; None also where P shows all of it."""


@plain_torch()
def evaluate(
    completed: Splats,
    partial: Splats,
    views: ViewDistribution,
    *,
    truth: Splats | None = None,
    settings: EvaluationSettings | None = None,
) -> EvaluationReport:
    """Measure a completion.

    Args:
        completed: O in the object frame.
        partial: P in the object frame.
        views: V with the input view c.
        truth: the complete object in the object frame, if known.
        settings: knobs; None = defaults.

    Returns:
        E_color and E_depth from c and over V, HaarPSI, and what the truth tells where it is known.

    Raises:
        UserError: P is not visible from c.
    """
    chosen = settings or EvaluationSettings()
    camera = views.input_camera(chosen.size_px)
    over_v = views.cameras(views.measured(chosen.views), chosen.size_px)
    with torch.no_grad():
        behind = partial.means.new_tensor(MID_GREY)
        ours, theirs = (render(splats, over_v, behind) for splats in (completed, partial))
    report = EvaluationReport(
        input_view=preservation(completed, partial, camera),
        all_views=preservation_of_renders(ours, theirs),
        haarpsi=float(haarpsi(ours.color, theirs.color, theirs.alpha).mean()),
        lpips=lpips_error(completed, partial, camera),
        clip=clip_similarity(completed, partial, camera, views.ring(4, chosen.size_px)),
    )
    if truth is None:
        return report
    all_round = views.ring(chosen.truth_views, chosen.size_px)
    with torch.no_grad():
        renders = [render(splats, all_round, behind) for splats in (completed, partial, truth)]
    return dataclasses.replace(
        report,
        truth=truth_errors_of_renders(*renders),
        truth_pictures=truth_pictures_of_renders(*renders),
        truth_surface=hidden_surface_errors(completed, partial, truth),
    )


def truth_pictures_of_renders(completed: Render, partial: Render, truth: Render) -> TruthPictures:
    """Compare renders of O with renders of T; one background for all."""
    either = (completed.alpha >= COVERED_ALPHA) | (truth.alpha >= COVERED_ALPHA)
    hidden = either & (partial.alpha < COVERED_ALPHA)
    alike = ssim_map(completed.color, truth.color)
    return TruthPictures(
        float(alike[hidden].mean()) if bool(hidden.any()) else None,
        float(haarpsi(completed.color, truth.color, either).mean()),
        patch_distance(completed.color, truth.color, hidden),
    )
