"""Mesh files say which way is up, and reading turns nothing."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from splatcomplete_data import cli
from splatcomplete_data.mesh.files.load import load_mesh
from splatcomplete_data.mesh.files.up_axis import up_of_mesh_file
from splatcomplete_data.scan import read


def standing_box(path: Path, up_axis: str | None = "Y_UP") -> Path:
    """A box of 1 x 2 x 3; ``up_axis`` is what a DAE says, None = nothing."""
    trimesh.creation.box((1, 2, 3)).export(path)
    if path.suffix == ".dae":
        said = f"<up_axis>{up_axis}</up_axis>" if up_axis else ""
        text, count = re.subn(r"<up_axis>\w+</up_axis>", said, path.read_text())
        assert count == 1
        path.write_text(text)
    return path


@pytest.mark.parametrize(("said", "up"), [("X_UP", "X"), ("Y_UP", "Y"), ("Z_UP", "Z"), (None, "Y")])
def test_collada_says_it_and_trimesh_turns_nothing(tmp_path, said, up):
    path = standing_box(tmp_path / "a.dae", said)
    assert up_of_mesh_file(path) == up
    low, high = load_mesh(path).bounds()
    np.testing.assert_allclose(high - low, (1, 2, 3), atol=1e-5)


@pytest.mark.parametrize(
    ("name", "up"),
    [("a.glb", "Y"), ("a.gltf", "Y"), ("a.GLB", "Y"), ("a.obj", "Z"), ("a.ply", "Z")],
)
def test_other_formats(tmp_path, name, up):
    assert up_of_mesh_file(tmp_path / name) == up


@pytest.mark.parametrize("name", ["a.glb", "a.dae", "a.stl"])
def test_meshes_and_scan_meshes_stand_alike(tmp_path, monkeypatch, name):
    monkeypatch.setattr(read, "MESH_POINTS", 2000)
    path, up = standing_box(tmp_path / name), "Z" if name == "a.stl" else "Y"
    for command in (["mesh", "--count", "500"], ["scan", "--no-outliers", "--count", "500"]):
        out = tmp_path / command[0]
        assert cli.main([command[0], str(path), *command[1:], "--out", str(out)]) == 0
        assert json.loads((out / "object.json").read_text())["frame"]["up"] == up
