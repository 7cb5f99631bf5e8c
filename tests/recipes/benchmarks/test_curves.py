import json
import re

import pytest
from PIL import Image

from gscomplete.errors import UserError
from recipes.benchmarks.curves import __main__ as curves
from recipes.benchmarks.curves import charts


def _row(seconds, iou, psnr=20.0):
    return {
        "seconds": seconds,
        "silhouette_iou": iou,
        "hidden_color_psnr_db": psnr,
        "e_color_v": 1e-3,
    }


def _write(folder, name, content):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def test_every_panel_shows_its_command_and_what_was_measured(tmp_path):
    error = {"color_mean": 1e-4}
    lists = {"scene": "surface", "exact_tile_lists": True, "alpha_min": 1 / 255, "uncut": error}
    _write(tmp_path, "renderer_accuracy.json", {"rows": [lists | {"ms": ms} for ms in (9, 3)]})
    ways = {"fast": _row(2.0, 0.8), "default": _row(6.0, 0.9)}
    _write(tmp_path, "completion.json", {"rows": {"cow": ways, "apple": {"fast": _row(4.0, 0.6)}}})
    known = {f"exact/paper/{n}/0/a/{item}": _row(n, 0.9) for n in (50, 100) for item in "pq"}
    known["exact/paper/50/0/a/p"]["hidden_color_psnr_db"] = None
    _write(tmp_path, "known_priors/results.json", {"rows": known})
    score = {"mesh": "m", "mode": "cells", "splats": 1000, "convert_s": 0.5, "iou": 0.99}
    others = {"mesh": "n", "splats": 996, "psnr_db": 31.0}  # as many were asked for
    scores = [score | {"psnr_db": 33.0}, score | others]
    _write(tmp_path, "mesh_conversion.json", {"scores": scores})
    curves.main(curves.Options(tmp_path))
    text = (tmp_path / "curves.html").read_text()
    with Image.open(tmp_path / "curves.png") as picture:
        assert picture.size == (2 * 580, 4 * 340)  # seven charts
    for panel in curves.PANELS:
        assert panel.command.split(" --")[0].split("; do ")[-1] in text
    assert "there is no captures.json" in text
    assert text.count("<figure>") == text.count("data:image/png") == 1 + 2 + 2 + 2
    points = re.findall(r"<tr><td>([^<]*)<td>([^<]*)<td>([^<]*)", text)
    assert ("fast", "3", "0.7") in points  # the mean of two objects
    assert ("default", "6", "0.9") in points
    assert [x for name, x, _ in points if name == "alpha_min 0.004"] == ["3", "9"]
    assert ("exact, paper", "50", "20") in points  # of one object: the other has no PSNR
    assert ("cells", "0.5", "32") in points


@pytest.mark.parametrize(
    ("count", "asked"), [(9_935, 10_000), (10_003, 10_000), (30_194, 30_000), (299_993, 300_000)]
)
def test_counts_near_each_other_are_one(count, asked):
    assert curves._rounded(count) == asked


def test_small_numbers_are_told_apart():
    assert [charts._short(x) for x in (1e-4, 1.2e-4, 0.02, 3e6)] == ["1e-4", "1.2e-4", "0.02", "3M"]


def test_narrow_logarithmic_axes_have_ticks():
    ticks = charts._Axis([310.0, 450.0], log=True, start=0, stop=100).ticks()
    assert ticks == [350, 400, 450]


def test_a_file_of_something_else_is_named(tmp_path):
    _write(tmp_path, "completion.json", {"rows": [1]})
    with pytest.raises(UserError, match=r"completion\.json: expected what this writes: python"):
        curves.main(curves.Options(tmp_path))
