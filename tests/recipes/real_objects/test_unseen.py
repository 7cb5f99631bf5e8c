import json

import numpy as np
import pytest
import torch

from recipes.real_objects.unseen import Options, chosen_entries, main, part_of
from tests.builders.mesh_pack import write_pack
from tests.builders.objects import ball


def test_parts_of_every_kind_keep_a_part():
    complete = ball()
    kept = {}
    for kind in ("scan", "arc", "half", "box", "complete", "middle"):
        part = part_of(complete, kind, np.random.default_rng(1))
        again = part_of(complete, kind, np.random.default_rng(1))
        assert torch.equal(part.means, again.means)
        kept[kind] = len(part) / len(complete)
    assert kept["complete"] == 1.0
    # A view of a ball shows less than half of it, an arc more; the box takes 40 % away.
    assert 0.25 < kept["scan"] < 0.5 < kept["arc"] < 0.9
    assert 0.2 < kept["half"] < 0.8
    # two standard errors of a half of 6000 random splats
    assert kept["middle"] == pytest.approx(0.5, abs=2 * 0.5 / 6000**0.5)
    # the box ends at a quantile, between two splats
    assert kept["box"] == pytest.approx(0.6, abs=1.5 / 6000)


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
