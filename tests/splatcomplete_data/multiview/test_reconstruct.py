from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image

from gscomplete.splats import read_splats
from splatcomplete_data.cli import main
from splatcomplete_data.multiview import reconstruct
from tests.splatcomplete_data.multiview import captures

FLAGS = ["--start", "random", "--steps", "30", "--hold-out", "4", "--max-splats", "500"]
FLAGS += ["--random-points", "300"]


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> Path:
    return captures.transforms_capture(tmp_path_factory.mktemp("ball"))


def images(folder: Path, out: Path, *more: str) -> int:
    return main(["images", str(folder), "--out", str(out), *FLAGS, *more])


def test_a_capture_folder_holds_everything(photos, tmp_path, capsys):
    out = tmp_path / "capture"
    assert images(photos, out, "--json") == 0
    content = json.loads(capsys.readouterr().out)
    assert content == json.loads((out / "capture.json").read_text())
    assert content["status"] == "finished"
    assert len(content["cameras"]) == 8
    assert sum(camera["held_out"] for camera in content["cameras"]) == 2
    assert set(content["result"]["held_out_psnr_db_per_photo"]) == {"photo_00.png", "photo_04.png"}
    assert len(read_splats(out / "splats.ply").splats) == content["result"]["splats"]
    assert len((out / "log.jsonl").read_text().splitlines()) == 30
    assert Image.open(out / "preview.png").width > 100
    assert main(["crop", str(out), "--prompt", "a ball", "--out", str(tmp_path / "ball")]) == 0
    record = json.loads((tmp_path / "ball/object.json").read_text())
    assert record["frame"]["up"] == "Z"
    assert record["details"]["capture"]["result"] == content["result"]


def test_an_interrupted_run_resumes_to_the_same_bytes(photos, tmp_path, monkeypatch):
    assert images(photos, tmp_path / "whole") == 0
    real = reconstruct.Training.step

    def stop_at_17(self):
        if self.step_number == 17:
            raise KeyboardInterrupt
        return real(self)

    monkeypatch.setattr(reconstruct.Training, "step", stop_at_17)
    assert images(photos, tmp_path / "cut") == 130
    monkeypatch.setattr(reconstruct.Training, "step", real)
    assert images(photos, tmp_path / "cut", "--resume") == 0
    a, b = (tmp_path / name / "splats.ply" for name in ("whole", "cut"))
    assert a.read_bytes() == b.read_bytes()
    assert len((tmp_path / "cut/log.jsonl").read_text().splitlines()) == 30


def test_resuming_with_other_options_is_refused(photos, tmp_path, capsys):
    assert images(photos, tmp_path / "a") == 0
    capsys.readouterr()
    assert images(photos, tmp_path / "a", "--resume", "--seed", "5") == 2
    assert "cannot resume with another" in capsys.readouterr().err
    assert images(photos, tmp_path / "none", "--resume") == 2
    assert "nothing to resume" in capsys.readouterr().err


def test_an_old_capture_is_only_overwritten_when_asked(photos, tmp_path, capsys):
    out = tmp_path / "a"
    assert images(photos, out) == 0
    assert images(photos, out) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert images(photos, out, "--overwrite") == 0
    (out / "letter.txt").write_text("mine")
    assert images(photos, out, "--overwrite") == 2
    assert "letter.txt" in capsys.readouterr().err
    assert (out / "letter.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--steps", "0"], "--steps: expected at least 1"),
        (["--hold-out", "1"], "--hold-out: expected 0 or at least 2"),
        (["--max-splats", "100"], "--max-splats: expected at least the"),
        (["--max-side", "2"], "--max-side"),
        (["--masks", "nowhere"], "expected a mask for every photo"),
        (["--device", "cuda:9"], "--device"),
    ],
)
def test_wrong_options_are_named(photos, tmp_path, capsys, flags, words):
    assert images(photos, tmp_path / "a", *flags) == 2
    assert words in capsys.readouterr().err


def test_folders_without_photos_are_named(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert images(tmp_path / "empty", tmp_path / "a") == 2
    assert "expected photos" in capsys.readouterr().err


def test_masks_restrict_the_splats_to_the_object(tmp_path):
    folder = captures.transforms_capture(tmp_path / "c", alpha=True)
    assert images(folder, tmp_path / "a") == 0
    means = read_splats(tmp_path / "a/splats.ply").splats.means
    # Without masks random points reach 4.5 to either side; within them, less than half of that.
    assert means.abs().max() < 2.2
