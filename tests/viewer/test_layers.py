import json
import shutil

import numpy as np
import pytest
import torch

from gscomplete.completion.settings import LearningRates
from gscomplete.errors import UserError
from gscomplete.fitting.checkpoint import save_checkpoint
from gscomplete.fitting.parameters import SplatParameters
from gscomplete.folders import alternative_file
from gscomplete.splats import append_splats, read_splats, write_splats
from gscomplete.viewer.layers import read_scene
from gscomplete.views import ObjectFrame, ViewDistribution
from tests.builders.folders import write_object_folder
from tests.builders.objects import random_splats
from tests.builders.ply_files import make_ply, random_table


def write_run(folder, p=5, new=7, **changes):
    folder.mkdir()
    write_splats(folder / "partial.ply", random_splats(p))
    append_splats(
        folder / "completed.ply", read_splats(folder / "partial.ply"), random_splats(new, seed=1)
    )
    record = {
        "status": "finished",
        "input": {"splats": p},
        "identity": {
            "frame": ObjectFrame("Y", (1.0, 2.0, 3.0), 2.0).to_json(),
            "views": ViewDistribution(30.0, 10.0).to_json(),
        },
    }
    (folder / "run.json").write_text(json.dumps(record | changes))
    return folder


def test_a_run_gives_p_and_what_was_added_in_its_frame(tmp_path):
    scene = read_scene([write_run(tmp_path / "run")], "Z", 100)
    assert [(layer.name, len(layer.splats)) for layer in scene.layers] == [("P", 5), ("new", 7)]
    assert scene.views == ViewDistribution(30.0, 10.0)
    frame = ObjectFrame("Y", (1.0, 2.0, 3.0), 2.0).object_from_file
    expected = frame.apply(random_splats(5).means.double()).float()
    assert torch.allclose(scene.layers[0].splats.means, expected, atol=1e-6)


def test_alternatives_stand_for_what_was_added(tmp_path):
    options = ["--mirror=30,0.1", "--mirror=none"]
    folder = write_run(tmp_path / "run", result={"alternatives": options})
    for number, count in enumerate((3, 4)):
        path = folder / alternative_file(number)
        path.parent.mkdir(exist_ok=True)
        write_splats(path, random_splats(count))
    layers = read_scene([folder], "Z", 100).layers
    assert [(layer.name, len(layer.splats)) for layer in layers[2:]] == list(
        zip(options, (3, 4), strict=True)
    )
    assert [layer.is_alternative for layer in layers] == [False, False, True, True]
    shutil.rmtree(folder / "alternatives")  # runs of before kept none
    assert len(read_scene([folder], "Z", 100).layers) == 2


def test_a_run_that_goes_on_shows_its_newest_checkpoint(tmp_path):
    folder = write_run(tmp_path / "run", status="running")
    record = json.loads((folder / "run.json").read_text())
    record["input"]["path"] = str(folder / "partial.ply")
    (folder / "run.json").write_text(json.dumps(record))
    (folder / "completed.ply").unlink()
    scene = read_scene([folder], "Z", 100)
    assert scene.running == folder
    assert [layer.name for layer in scene.layers] == ["P"]
    parameters = SplatParameters(random_splats(6, seed=3), LearningRates())
    state = {**parameters.state(), "step": torch.tensor(40)}
    save_checkpoint(folder / "checkpoints", state)
    scene = read_scene([folder], "Z", 100)
    assert [layer.name for layer in scene.layers] == ["P", "new"]
    expected = parameters.splats()
    for name in ("means", "quaternions", "scales", "opacities", "sh"):
        found = getattr(scene.layers[1].splats, name)
        assert torch.allclose(found, getattr(expected, name), atol=1e-5), name


def test_an_unfinished_run_is_named(tmp_path):
    folder = write_run(tmp_path / "run", status="stopped")
    (folder / "completed.ply").unlink()
    with pytest.raises(UserError, match=r"completed\.ply: no such file; the run is stopped"):
        read_scene([folder], "Z", 100)


@pytest.mark.parametrize("record", ["{}", '{"input": 3, "identity": {}}', "[]"])
def test_a_record_of_something_else_is_refused(tmp_path, record):
    folder = write_run(tmp_path / "run")
    (folder / "run.json").write_text(record)
    with pytest.raises(UserError, match=r"run\.json: expected the record of a run"):
        read_scene([folder], "Z", 100)


def test_a_run_with_fewer_splats_than_p_is_refused(tmp_path):
    folder = write_run(tmp_path / "run", input={"splats": 13})
    with pytest.raises(UserError, match="at least P's 13 splats, found 12"):
        read_scene([folder], "Z", 100)


def test_folders_give_a_layer_per_file_in_one_frame(tmp_path):
    """The first file's box is the frame; equal names are told apart by their folders."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_splats(tmp_path / name / "partial.ply", random_splats(40, seed=ord(name)))
    write_splats(tmp_path / "b" / "complete.ply", random_splats(50))
    scene = read_scene([tmp_path / "a", tmp_path / "b"], "Z", 30)
    assert [layer.name for layer in scene.layers] == ["a/partial", "complete", "b/partial"]
    assert scene.layers[0].note == "40 splats, 30 of them drawn, enlarged to match"
    assert scene.views is None
    whole = read_scene([tmp_path / "a"], "Z", 100).layers[0].splats
    low, high = whole.bounds()
    # of 40 splats the middle 99.9 % end a little within the outermost
    assert torch.allclose(low + high, torch.zeros(3), atol=0.02)
    assert float((high - low).max()) == pytest.approx(1.0, abs=0.02)


def test_files_of_equal_names_in_folders_of_equal_names_are_told_apart(tmp_path):
    paths = [tmp_path / name / "mug" / "completed.ply" for name in ("default", "fast")]
    for path in paths:
        path.parent.mkdir(parents=True)
        write_splats(path, random_splats(10))
    scene = read_scene([*paths, paths[0]], "Z", 30)
    names = [layer.name for layer in scene.layers]
    assert names == ["default/mug/completed", "fast/mug/completed", "default/mug/completed (2)"]


def test_a_folder_without_splats_is_refused(tmp_path):
    with pytest.raises(UserError, match="expected a run folder or splat files"):
        read_scene([tmp_path], "Z", 100)


def test_splats_that_cannot_be_drawn_are_left_out_and_counted(tmp_path):
    table = random_table(6, 0)
    table["x"][2] = np.nan
    (tmp_path / "a.ply").write_bytes(make_ply(table))
    layer = read_scene([tmp_path / "a.ply"], "Z", 100).layers[0]
    assert len(layer.splats) == 5
    assert layer.note == "6 splats, 1 of them not finite or too large to draw"


def test_hidden_files_of_a_folder_are_no_layers(tmp_path):
    write_splats(tmp_path / "one.ply", random_splats(5))
    (tmp_path / "._one.ply").write_bytes(b"what macOS leaves")
    assert [layer.name for layer in read_scene([tmp_path], "Z", 100).layers] == ["one"]


def test_floaters_do_not_decide_the_frame_and_are_told(tmp_path):
    splats = random_splats(40)
    splats.means[:2] = torch.tensor([[1e4, 0.0, 0.0], [0.0, 1e5, 0.0]])
    write_splats(tmp_path / "a.ply", splats)
    layer = read_scene([tmp_path / "a.ply"], "Z", 100).layers[0]
    assert layer.note == "40 splats, 2 of them outside the frame"
    assert 0.5 < float(layer.splats.means[2:].abs().max()) < 0.8


def test_an_object_folder_gives_its_files_in_its_frame(tmp_path):
    folder = write_object_folder(tmp_path / "mug", random_splats(5), random_splats(9))
    scene = read_scene([folder], "Z", 100)
    assert [(layer.name, len(layer.splats)) for layer in scene.layers] == [
        ("complete", 9), ("partial", 5)
    ]  # fmt: skip
    assert scene.views == ViewDistribution(30.0, 10.0, 40.0, 12.0)
    frame = ObjectFrame("Y", (0.1, 0.0, 0.0), 1.25).object_from_file
    expected = frame.apply(random_splats(5).means.double()).float()
    assert torch.allclose(scene.layers[1].splats.means, expected, atol=1e-6)
