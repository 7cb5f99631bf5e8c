import json

import numpy as np
import pytest
import torch

from gscomplete.splats import concatenate
from recipes.in_memory import Answer
from recipes.real_objects.compare import pose
from recipes.real_objects.load import RealObject
from recipes.real_objects.unseen import (
    Options,
    bootstrap_interval,
    chosen_entries,
    hidden_surface_errors,
    main,
    part_of,
)
from tests.recipes.train_embedded_prior.packs import write_pack
from tests.shape.shapes import half, moved, sphere


def test_parts_of_every_kind_keep_a_part():
    ball = sphere()
    kept = {}
    for kind in ("scan", "arc", "half", "box", "complete"):
        part = part_of(ball, kind, np.random.default_rng(1))
        again = part_of(ball, kind, np.random.default_rng(1))
        assert torch.equal(part.means, again.means)
        kept[kind] = len(part) / len(ball)
    assert kept["complete"] == 1.0
    # A view of a ball shows less than half of it, an arc more; the box takes 40 % away.
    assert 0.25 < kept["scan"] < 0.5 < kept["arc"] < 0.9
    assert 0.2 < kept["half"] < 0.8
    assert kept["box"] == pytest.approx(0.6, abs=0.02)


def test_the_hidden_surface_is_measured():
    ball = sphere()
    item = RealObject("ball", "a ball", "Z", half(ball), ball, "half")
    posed = pose(item)
    lacking = posed.truth.select(~half_mask(posed))
    exact = hidden_surface_errors(posed, Answer(lacking, posed.views, 0.0))
    assert exact["f_score_1"] == 1.0
    assert exact["chamfer"] < 1e-4
    nothing = hidden_surface_errors(posed, Answer(lacking.select(torch.arange(0)), posed.views, 0))
    assert nothing["f_score_3"] == 0.0
    away = moved(lacking, (0.0, 0.0, 0.02))
    shifted = hidden_surface_errors(posed, Answer(away, posed.views, 0.0))
    assert shifted["f_score_1"] < 0.9 < shifted["f_score_3"]
    both = concatenate([lacking, moved(lacking, (0.0, 0.0, 1.0))])
    assert hidden_surface_errors(posed, Answer(both, posed.views, 0.0))["f_score_1"] < 0.7


def half_mask(posed):
    have = {tuple(p) for p in posed.partial.means.tolist()}
    return torch.tensor([tuple(p) in have for p in posed.truth.means.tolist()])


def test_the_interval_of_a_mean_covers_it():
    values = np.random.default_rng(0).normal(0.8, 0.1, 100)
    low, high = bootstrap_interval(values)
    assert low < values.mean() < high
    # 1.96 standard errors to each side.
    assert high - low == pytest.approx(2 * 1.96 * 0.01, rel=0.2)


def test_the_command_goes_on_where_it_stopped(tmp_path, capsys):
    folder = write_pack(tmp_path / "pack")
    assert [entry.id for entry in chosen_entries(folder, None)] == ["a/picture"]
    options = Options(folder, tmp_path / "out", ways=("input",), kinds=("half", "complete"))
    main(options)
    first = capsys.readouterr().out
    rows = json.loads((tmp_path / "out" / "results.json").read_text())
    assert "a/picture:half" in json.dumps(rows)
    assert "complete input" in first
    main(options)
    assert capsys.readouterr().out == first
