"""Validation names parts of another whole, strange files, and links out of a dataset."""

import dataclasses
import json
import shutil
from pathlib import Path

import pytest
import torch
import trimesh

from gscomplete.splats import read_splats, write_splats
from splatcomplete_data.cli import main
from splatcomplete_data.dataset.validate import validate_dataset
from splatcomplete_data.objects import file_record


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a dataset of one box, without an index."""
    folder = tmp_path_factory.mktemp("dataset")
    trimesh.creation.box((1, 1, 1)).export(folder / "box.ply")
    arguments = ["mesh", str(folder / "box.ply"), "--count", "2000", "--cut", "plane:90"]
    assert main([*arguments, "--licence", "CC0", "--out", str(folder / "out/box")]) == 0
    return folder / "out"


@pytest.fixture
def copy(dataset: Path, tmp_path: Path) -> Path:
    """Copy the dataset."""
    shutil.copytree(dataset, tmp_path / "copy")
    return tmp_path / "copy"


def findings_of(folder: Path) -> dict[str, str]:
    """Return messages by names, but for what the copies always lack."""
    found = validate_dataset(folder)[1]
    return {f.name: f"{f.severity}: {f.message}" for f in found if f.name != "no_index"}


def test_a_part_of_another_whole_is_an_error(copy: Path) -> None:
    assert "other_whole" not in findings_of(copy)
    path, record_path = copy / "box/partial.ply", copy / "box/object.json"
    part = read_splats(path).splats
    means = part.means.clone()
    means[:3] += torch.tensor([0.0, 0.0, 1e-4])
    write_splats(path, dataclasses.replace(part, means=means))
    record = json.loads(record_path.read_text())
    record["files"]["partial.ply"] = dataclasses.asdict(file_record(path))
    record_path.write_text(json.dumps(record))
    found = findings_of(copy)
    assert found["other_whole"] == "error: partial.ply: 3 splats lie where complete.ply has none"
    assert "wrong_hash" not in found
    record["steps"] = []  # how the part was made is not known
    record_path.write_text(json.dumps(record))
    assert "other_whole" not in findings_of(copy)


def test_strange_files_beside_the_objects_are_named(copy: Path) -> None:
    (copy / "stray.ply").write_text("ply")
    (copy / ".hidden").write_text("")
    assert findings_of(copy)["unknown_file"] == "warning: stray.ply: no file of a dataset"


def test_links_out_of_the_dataset_are_named(copy: Path, tmp_path: Path) -> None:
    path, elsewhere = copy / "box/partial.ply", tmp_path / "elsewhere.ply"
    path.rename(copy / "box/inside.ply")
    path.symlink_to("inside.ply")
    assert "outside_link" not in findings_of(copy)
    path.unlink()
    (copy / "box/inside.ply").rename(elsewhere)
    path.symlink_to(elsewhere)
    assert findings_of(copy) == {
        "outside_link": f"warning: partial.ply: a link out of the dataset, to {elsewhere.resolve()}"
    }
