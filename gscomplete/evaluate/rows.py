"""Rows of a table: one completion of one object by one method, with its numbers by name.

Conventions
-----------
* ``MEASURES`` is the one list of numbers that tables, files and pages show: name in files, label
  for people, LaTeX, whether lower is better, digits.
* None = not measured: no truth is known, or weights are missing (``unavailable`` says why).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from gscomplete.evaluate.perceptual import Unavailable
from gscomplete.evaluate.report import EvaluationReport


@dataclass(frozen=True, slots=True)
class Measure:
    """One number of a completion."""

    name: str
    """In JSON and CSV."""
    label: str
    """In Markdown and HTML."""
    latex: str
    """In LaTeX."""
    lower_is_better: bool
    digits: int
    get: Callable[[EvaluationReport], float | Unavailable | None]


def _truth(name: str) -> Callable[[EvaluationReport], float | None]:
    return lambda report: None if report.truth is None else getattr(report.truth, name)


def _pictures(name: str) -> Callable[[EvaluationReport], float | None]:
    return lambda r: None if r.truth_pictures is None else getattr(r.truth_pictures, name)


def _surface(name: str) -> Callable[[EvaluationReport], float | None]:
    return lambda r: None if r.truth_surface is None else getattr(r.truth_surface, name)


MEASURES: tuple[Measure, ...] = (
    Measure("e_depth_c", "E_depth c", r"$E^\text{Depth}_\text{MSE}$", True, 5,
            lambda r: r.input_view.depth),
    Measure("e_color_c", "E_color c", r"$E^\text{Color}_\text{MSE}$", True, 5,
            lambda r: r.input_view.color),
    Measure("e_depth_v", "E_depth V", r"$E^\text{Depth}_{V}$", True, 5,
            lambda r: r.all_views.depth),
    Measure("e_color_v", "E_color V", r"$E^\text{Color}_{V}$", True, 5,
            lambda r: r.all_views.color),
    Measure("haarpsi_v", "HaarPSI V", r"$S_\text{HaarPSI}$", False, 3, lambda r: r.haarpsi),
    Measure("lpips_c", "E_LPIPS", r"$E_\text{LPIPS}$", True, 4, lambda r: r.lpips),
    Measure("clip", "S_CLIP", r"$S_\text{CLIP}$", False, 2, lambda r: r.clip),
    Measure("silhouette_iou", "IoU", "IoU", False, 3, _truth("silhouette_iou")),
    Measure("silhouette_missed", "missed", "missed", True, 3, _truth("silhouette_missed")),
    Measure("silhouette_excess", "excess", "excess", True, 3, _truth("silhouette_excess")),
    Measure("hidden_psnr_db", "hidden PSNR", "PSNR (dB)", False, 2,
            _truth("hidden_color_psnr_db")),
    Measure("hidden_ssim", "hidden SSIM", "SSIM", False, 3, _pictures("hidden_ssim")),
    Measure("haarpsi_truth", "HaarPSI truth", r"$S_\text{HaarPSI}^\text{truth}$", False, 3,
            _pictures("haarpsi")),
    Measure("hidden_patches", "hidden patches", "patches", True, 3, _pictures("patches")),
    Measure("chamfer", "chamfer", "chamfer", True, 4, _surface("chamfer")),
    Measure("f_score_1", "F 1 %", r"$F_{1\%}$", False, 3, _surface("f_score_1")),
    Measure("f_score_3", "F 3 %", r"$F_{3\%}$", False, 3, _surface("f_score_3")),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Row:
    """The numbers of one completion."""

    method: str
    """Who completed: the name of the folder of runs, or of the file."""
    object: str
    subset: str | None
    """Kind of source; None = the object belongs to no dataset."""
    values: dict[str, float | None]
    """By ``Measure.name``."""
    seconds: float | None = None
    """Time that completing took; None = not recorded."""
    unavailable: dict[str, str] = field(default_factory=dict)
    """Reasons why numbers are missing on this machine, such as missing weights, by measure."""
    notes: tuple[str, ...] = ()
    """Warnings of the run, and how another system's result was aligned."""


def row_of(
    report: EvaluationReport,
    method: str,
    object_: str,
    subset: str | None,
    seconds: float | None = None,
    notes: tuple[str, ...] = (),
) -> Row:
    """Flatten a report."""
    values: dict[str, float | None] = {}
    unavailable = {}
    for measure in MEASURES:
        value = measure.get(report)
        if isinstance(value, Unavailable):
            unavailable[measure.name], value = value.reason, None
        values[measure.name] = value
    return Row(method, object_, subset, values, seconds, unavailable, notes)
