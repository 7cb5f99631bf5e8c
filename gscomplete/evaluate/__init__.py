"""Numbers and pictures that say how good a completion is."""

from gscomplete.evaluate.metrics import (
    PreservationErrors,
    TruthErrors,
    against_truth,
    preservation,
)
from gscomplete.evaluate.perceptual import Unavailable
from gscomplete.evaluate.pictures import (
    contact_sheet,
    draw_turntable,
    preview_sheet,
    render_images,
    save_image,
    save_turntable,
)
from gscomplete.evaluate.report import EvaluationReport, EvaluationSettings, evaluate

__all__ = [
    "EvaluationReport",
    "EvaluationSettings",
    "PreservationErrors",
    "TruthErrors",
    "Unavailable",
    "against_truth",
    "contact_sheet",
    "draw_turntable",
    "evaluate",
    "preservation",
    "preview_sheet",
    "render_images",
    "save_image",
    "save_turntable",
]
