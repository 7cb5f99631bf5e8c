"""A mesh of a made-up system goes through registry, conversion, alignment and measuring."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gscomplete.cli.evaluate import EvaluateOptions, run
from gscomplete.errors import UserError
from gscomplete.splats import write_splats
from gscomplete.views import ObjectFrame, ViewDistribution
from recipes.baselines.enter import Options, enter, find_result
from recipes.baselines.registry import SYSTEMS
from splatcomplete_data.mesh.convert import convert_mesh
from splatcomplete_data.mesh.files.load import load_mesh
from tests.builders.folders import write_object_folder
from tests.builders.objects import round_splats

trimesh = pytest.importorskip("trimesh")


def chair() -> "trimesh.Trimesh":
    parts = []
    for size, middle in (((1, 0.8, 0.12), (0, 0, 0)), ((0.12, 0.8, 1.0), (-0.44, 0, 0.5)),
                         ((0.2, 0.2, 0.5), (0.4, -0.3, 0.3))):  # fmt: skip
        box = trimesh.creation.box(size)
        box.apply_translation(middle)
        parts.append(box)
    return trimesh.util.concatenate(parts)


def chair_file(folder: Path) -> Path:
    chair().export(folder / "true.ply")
    return folder / "true.ply"


def test_a_result_is_converted_aligned_and_measured(tmp_path, capsys):
    mesh = chair()
    complete = convert_mesh(load_mesh(chair_file(tmp_path)), 5000).splats
    partial = complete.select(complete.means[:, 1] + 0.5 * complete.means[:, 2] > -0.15)
    write_object_folder(
        tmp_path / "open/chair", partial, complete, frame=ObjectFrame("Z", (0.0, 0.0, 0.25), 1.2),
        frame_origin="truth", views=ViewDistribution(60.0, 20.0, 20.0, 5.0),
    )  # fmt: skip
    matrix = np.eye(4)
    matrix[:3, :3] = 0.4 * Rotation.random(random_state=4).as_matrix()
    matrix[:3, 3] = (3.0, -2.0, 1.0)
    mesh.apply_transform(matrix)
    (tmp_path / "made_up").mkdir()
    mesh.export(tmp_path / "made_up/chair.glb")
    options = Options(
        "other", tmp_path / "open", tmp_path / "made_up", tmp_path / "out", count=5000,
        rotations=300,
    )  # fmt: skip
    assert enter(options) == {}
    assert json.loads((tmp_path / "out/alignment.json").read_text())["chair"]["warning"] == ""
    before = (tmp_path / "out/chair.ply").stat().st_mtime_ns
    assert enter(options) == {}  # nothing is done twice
    assert (tmp_path / "out/chair.ply").stat().st_mtime_ns == before
    capsys.readouterr()
    asked = EvaluateOptions(
        dataset=tmp_path / "open", runs=(f"other={tmp_path / 'out'}",), json=True,
        views=2, truth_views=4, size_px=64,
    )  # fmt: skip
    assert run(asked) == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert row["method"] == "other"
    assert row["values"]["silhouette_iou"] > 0.95
    assert row["values"]["e_depth_v"] < 0.01
    assert torch.isfinite(torch.tensor(row["values"]["f_score_3"]))


def test_files_are_found_by_the_objects_name(tmp_path):
    (tmp_path / "cup").mkdir()
    (tmp_path / "cup/sample.glb").touch()
    (tmp_path / "jug.OBJ").touch()
    (tmp_path / "jug.mtl").touch()
    assert find_result(tmp_path, "cup") == tmp_path / "cup/sample.glb"
    assert find_result(tmp_path, "jug") == tmp_path / "jug.OBJ"
    assert find_result(tmp_path, "pot") is None
    (tmp_path / "cup.ply").touch()
    with pytest.raises(UserError, match="expected one result of cup, found 2"):
        find_result(tmp_path, "cup")


def test_a_damaged_result_is_told_and_passed_over(tmp_path):
    splats = convert_mesh(load_mesh(chair_file(tmp_path)), 2000).splats
    for name in ("a", "b", "c"):
        write_object_folder(tmp_path / "open" / name, splats)
    (tmp_path / "made").mkdir()
    (tmp_path / "made/a.glb").write_bytes(b"no mesh")
    (tmp_path / "made/c").mkdir()
    for name in ("one.glb", "two.glb"):
        (tmp_path / "made/c" / name).touch()
    (tmp_path / "made/b").mkdir()
    (tmp_path / "made/b/._b.ply").touch()  # as macOS leaves them
    write_splats(tmp_path / "made/b.ply", splats)
    options = Options(
        "other", tmp_path / "open", tmp_path / "made", tmp_path / "out", rotations=100
    )
    failures = enter(options)
    assert set(failures) == {"a", "c"}
    assert "expected one result of c, found 2" in failures["c"]
    assert "a.glb" in failures["a"]
    assert (tmp_path / "out/b.ply").is_file()


def test_wrong_systems_and_folders_are_named(tmp_path):
    with pytest.raises(UserError, match="SYSTEM: expected one of mvdream"):
        enter(Options("mine", tmp_path, tmp_path, tmp_path / "out"))
    with pytest.raises(UserError, match="poisson: it is made here: python -m"):
        enter(Options("poisson", tmp_path, tmp_path, tmp_path / "out"))
    write_object_folder(tmp_path / "open/chair", round_splats(torch.rand(30, 3)))
    with pytest.raises(UserError, match="expected a result named after an object, found none"):
        enter(Options("trellis", tmp_path / "open", tmp_path, tmp_path / "out"))
    assert {"mvdream", "trellis", "instantmesh", "triposg", "amodal3r", "sam3d", "trellis2"} < set(
        SYSTEMS
    )
