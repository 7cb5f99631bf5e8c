"""Rows hold every number of a report under its own name."""

import dataclasses
import json
from typing import Any

import pytest

from gscomplete.evaluate import EvaluationReport, Unavailable
from gscomplete.evaluate.rows import MEASURES, Row, row_of
from gscomplete.util import jsonio

PLACES = {
    "e_depth_c": "input_view.depth",
    "e_color_c": "input_view.color",
    "e_depth_v": "all_views.depth",
    "e_color_v": "all_views.color",
    "haarpsi_v": "haarpsi",
    "lpips_c": "lpips",
    "clip": "clip",
    "silhouette_iou": "truth.silhouette_iou",
    "silhouette_missed": "truth.silhouette_missed",
    "silhouette_excess": "truth.silhouette_excess",
    "hidden_psnr_db": "truth.hidden_color_psnr_db",
    "hidden_ssim": "truth_pictures.hidden_ssim",
    "haarpsi_truth": "truth_pictures.haarpsi",
    "hidden_patches": "truth_pictures.patches",
    "chamfer": "truth_surface.chamfer",
    "f_score_1": "truth_surface.f_score_1",
    "f_score_3": "truth_surface.f_score_3",
}
"""Where a report has each measure."""
ERRORS = {
    "e_depth_c", "e_color_c", "e_depth_v", "e_color_v", "lpips_c", "silhouette_missed",
    "silhouette_excess", "hidden_patches", "chamfer",
}  # fmt: skip
"""Measures of which less is better."""


def report_of(**changes: Any) -> EvaluationReport:
    """Return a report whose numbers all differ; ``changes`` replace its fields."""
    errors = {"color_image_mean": 0.1, "mask_fraction": 0.2, "views": 3, "color_per_view": [0.3]}
    content = {
        "input_view": {"color": 0.01, "depth": 0.02, **errors},
        "all_views": {"color": 0.03, "depth": 0.04, **errors},
        "haarpsi": 0.05,
        "lpips": 0.06,
        "clip": 0.07,
        "truth": {
            "silhouette_iou": 0.08, "silhouette_missed": 0.09, "silhouette_excess": 0.1,
            "hidden_iou": 0.11, "hidden_color_psnr_db": 12.0, "hidden_precision": 0.13,
            "hidden_recall": 0.14, "color_psnr_db": 15.0, "hidden_fraction": 0.16, "views": 17,
        },
        "truth_pictures": {"hidden_ssim": 0.18, "haarpsi": 0.19, "patches": 0.2},
        "truth_surface": {
            "chamfer": 0.21, "f_score_1": 0.22, "f_score_3": 0.23, "hidden_share": 0.24,
        },
    }  # fmt: skip
    return dataclasses.replace(jsonio.from_json(EvaluationReport, content, "report"), **changes)


def test_every_number_comes_from_its_place():
    report = report_of()
    row = row_of(report, "ours", "cup", "mesh", 2.5, ("a note",))
    assert list(row.values) == [measure.name for measure in MEASURES] == list(PLACES)
    for name, place in PLACES.items():
        value: Any = report
        for part in place.split("."):
            value = getattr(value, part)
        assert row.values[name] == value
    assert len(set(row.values.values())) == len(MEASURES)  # or two could be exchanged
    assert (row.method, row.object, row.subset, row.seconds) == ("ours", "cup", "mesh", 2.5)
    assert (row.unavailable, row.notes) == ({}, ("a note",))


def test_what_was_not_measured_is_none_and_says_why_where_it_is_known():
    report = report_of(
        lpips=Unavailable("no lpips"), clip=Unavailable("no weights"),
        truth=None, truth_pictures=None, truth_surface=None,
    )  # fmt: skip
    row = row_of(report, "ours", "cup", None)
    missing = {name for name, value in row.values.items() if value is None}
    assert missing == {n for n, place in PLACES.items() if place.startswith("truth")} | {
        "lpips_c", "clip"
    }  # fmt: skip
    assert row.unavailable == {"lpips_c": "no lpips", "clip": "no weights"}
    assert (row.subset, row.seconds, row.notes) == (None, None, ())


@pytest.mark.parametrize("field", ["truth", "truth_pictures", "truth_surface"])
def test_each_kind_of_truth_is_missed_alone(field):
    row = row_of(report_of(**{field: None}), "ours", "cup", None)
    missing = {name for name, value in row.values.items() if value is None}
    assert missing == {name for name, place in PLACES.items() if place.startswith(f"{field}.")}


def test_a_number_that_a_known_truth_lacks_is_none():
    report = report_of()
    assert report.truth is not None
    truth = dataclasses.replace(report.truth, hidden_color_psnr_db=None)
    row = row_of(report_of(truth=truth), "ours", "cup", None)
    assert [name for name, value in row.values.items() if value is None] == ["hidden_psnr_db"]


def test_zero_is_a_number():
    row = row_of(report_of(lpips=0.0, haarpsi=0.0), "ours", "cup", None)
    assert (row.values["lpips_c"], row.values["haarpsi_v"], row.unavailable) == (0.0, 0.0, {})


def test_measures_are_told_apart_and_errors_are_better_low():
    for field in ("name", "label", "latex"):
        assert len({getattr(measure, field) for measure in MEASURES}) == len(MEASURES)
    assert {measure.name for measure in MEASURES if measure.lower_is_better} == ERRORS
    assert all(measure.latex.count("$") in (0, 2) for measure in MEASURES)


def test_rows_do_not_share_their_reasons():
    one, two = (Row("ours", name, None, {}) for name in "ab")
    one.unavailable["clip"] = "no weights"
    assert two.unavailable == {}


def test_rows_survive_json():
    row = row_of(report_of(clip=Unavailable("no weights")), "ours", "cup", None, 1.0, ("a", "b"))
    assert jsonio.from_json(Row, json.loads(jsonio.dumps(row)), "row.json") == row
