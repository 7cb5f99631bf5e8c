"""The numbers of a run, as JSON and as a table.

Conventions
-----------
* Names follow the paper: E_color, E_depth, E_LPIPS, S_CLIP; ``metrics`` says how each is computed.
* A number that cannot be had is reported as unavailable with the reason, never replaced by another.
"""

from __future__ import annotations

from dataclasses import dataclass

from rich.table import Table

from gscomplete.evaluate.metrics import PreservationErrors, TruthErrors, against_truth, preservation
from gscomplete.evaluate.perceptual import Unavailable, clip_similarity, lpips_error
from gscomplete.splats import Splats
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
class EvaluationReport:
    """Everything measured about one completion."""

    input_view: PreservationErrors
    """E_color and E_depth from the input view c alone, as the paper reports them."""
    all_views: PreservationErrors
    """E_color and E_depth over the view distribution V."""
    lpips: float | Unavailable
    """E_LPIPS from the input view c."""
    clip: float | Unavailable
    """S_CLIP between P from c and the completion from four sides."""
    truth: TruthErrors | None = None
    """Agreement with the known whole object; None when it is not known."""


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
        truth: the whole object in the object frame, if known.
        settings: knobs; None = defaults.

    Raises:
        UserError: P is not visible from c.
    """
    chosen = settings or EvaluationSettings()
    camera = views.input_camera(chosen.size_px)
    over_v = views.cameras(views.measured(chosen.views), chosen.size_px)
    all_round = views.ring(chosen.truth_views, chosen.size_px)
    return EvaluationReport(
        input_view=preservation(completed, partial, camera),
        all_views=preservation(completed, partial, over_v),
        lpips=lpips_error(completed, partial, camera),
        clip=clip_similarity(completed, partial, camera, views.ring(4, chosen.size_px)),
        truth=None if truth is None else against_truth(completed, partial, truth, all_round),
    )


def report_table(report: EvaluationReport, title: str = "Evaluation") -> Table:
    """Lay a report out for the terminal."""
    table = Table(title=title)
    table.add_column("metric")
    table.add_column("input view c", justify="right")
    table.add_column(f"V ({report.all_views.views} views)", justify="right")
    one, many = report.input_view, report.all_views
    table.add_row("E_color (masked mean)", _number(one.color), _number(many.color))
    table.add_row(
        "E_color (image mean)", _number(one.color_image_mean), _number(many.color_image_mean)
    )
    table.add_row("E_depth (object sizes squared)", _number(one.depth), _number(many.depth))
    table.add_row("E_LPIPS", _number(report.lpips), "")
    table.add_row("S_CLIP", _number(report.clip), "")
    if report.truth is not None:
        psnr = report.truth.hidden_color_psnr_db
        table.add_row("hidden silhouette IoU", "", _number(report.truth.hidden_iou))
        table.add_row("hidden colour PSNR (dB)", "", "-" if psnr is None else f"{psnr:.1f}")
    return table


def _number(value: float | Unavailable) -> str:
    """Show a number briefly, or why there is none."""
    return f"unavailable: {value.reason}" if isinstance(value, Unavailable) else f"{value:.4g}"
