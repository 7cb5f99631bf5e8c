"""The validate command: exit codes, text and JSON."""

import json
from pathlib import Path

import pytest
import torch

from gscomplete.cli.validate import ValidateOptions, run
from gscomplete.errors import UserError
from gscomplete.splats import Splats, write_splats
from tests.builders.folders import write_object_folder
from tests.builders.objects import random_splats


def write_one(path: Path) -> Path:
    one = Splats(torch.zeros(1, 3), torch.eye(4)[:1], torch.ones(1, 3), torch.ones(1),
                 torch.zeros(1, 1, 3))  # fmt: skip
    write_splats(path, one)
    return path


def test_text_and_exit_codes(tmp_path, capsys):
    good = write_one(tmp_path / "good[x].ply")
    (tmp_path / "bad.ply").write_bytes(b"")
    assert run(ValidateOptions([good])) == 0
    assert f"{good}: ok, 1 splats, SH degree 0" in capsys.readouterr().out
    assert run(ValidateOptions([good, tmp_path / "bad.ply", tmp_path / "absent.ply"])) == 1
    printed = capsys.readouterr().out
    assert "error   not_a_splat_file (1): expected a PLY file, found an empty file" in printed
    assert "unreadable_file" in printed


def test_json_is_one_object(tmp_path, capsys):
    good = write_one(tmp_path / "good.ply")
    assert run(ValidateOptions([good, tmp_path / "absent.ply"], json=True)) == 1
    data = json.loads(capsys.readouterr().out)
    assert data["ok"] is False
    assert [file["ok"] for file in data["files"]] == [True, False]
    assert data["files"][0]["n_splats"] == 1
    assert data["files"][1]["findings"][0]["name"] == "unreadable_file"


def test_no_file_is_an_error():
    with pytest.raises(UserError, match="at least one FILE"):
        run(ValidateOptions([]))


def test_a_folder_stands_for_its_splat_files(tmp_path, capsys):
    folder = write_object_folder(tmp_path / "mug", random_splats(3), random_splats(7))
    assert run(ValidateOptions([folder], json=True)) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert [Path(file["path"]).name for file in files] == ["complete.ply", "partial.ply"]
    with pytest.raises(UserError, match=r"splat files \(.*\.spz, .*\), found none"):
        run(ValidateOptions([tmp_path]))
