"""The study itself: parts are made, completed, measured, and not twice."""

import json

import pytest

from recipes.known_priors.__main__ import Options, main
from tests.builders.mesh_pack import write_pack


def test_a_study_of_a_known_and_of_the_embedded_prior(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("recipes.real_objects.unseen._SPLATS", 1500)
    options = Options(
        meshes=write_pack(tmp_path / "pack"),
        out=tmp_path / "out",
        priors=("exact", "embedded"),
        ways=("bare", "paper"),
        steps=(2,),
        objects=1,
        resolution_px=16,
    )
    main(options)
    rows = json.loads((tmp_path / "out" / "results.json").read_text())["rows"]
    assert {key.split("/")[0]: row["calls"] for key, row in rows.items()} == {
        "exact": 2,
        "embedded": None,
    }
    assert len(rows) == 4
    told = capsys.readouterr().out
    assert "embedded, 2 steps, bare: E_color" in told
    monkeypatch.setattr("recipes.known_priors.__main__.completed", pytest.fail)  # nothing is left
    main(options)
    assert capsys.readouterr().out == told
