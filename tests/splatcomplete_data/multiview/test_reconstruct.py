from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.splats import read_splats
from splatcomplete_data.cli import main
from splatcomplete_data.multiview import reconstruct
from splatcomplete_data.multiview.sfm import structure_from_motion
from splatcomplete_data.multiview.sfm.structure_from_motion import SfmSettings
from tests.builders import captures

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


def test_a_training_without_splats_is_not_finished(photos, tmp_path):
    run = prepared(photos, tmp_path / "a")
    run.training.parameters.edit(torch.zeros(len(run.training.parameters), dtype=torch.bool))
    run.training.step_number = run.training.settings.steps
    with pytest.raises(UserError, match=r"expected splats .* found none left"):
        reconstruct.execute(run, lambda report: None)
    assert not (tmp_path / "a/splats.ply").exists()
    assert json.loads((tmp_path / "a/capture.json").read_text())["status"] == "running"


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


def prepared(folder: Path, out: Path, **values: object) -> reconstruct.Reconstruction:
    request = reconstruct.Request(folder, out, start="random", random_points=300)
    request = dataclasses.replace(request, **values)  # type: ignore[arg-type]
    return reconstruct.prepare(request, torch.device("cpu"))


def contents(folder: Path) -> dict[str, bytes]:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def test_an_old_capture_stays_when_the_new_one_cannot_begin(photos, tmp_path, monkeypatch):
    out = tmp_path / "a"
    assert images(photos, out) == 0
    before = contents(out)
    (tmp_path / "empty").mkdir()
    for folder, flags in ((tmp_path / "empty", []), (photos, ["--hold-out", "1"])):
        assert images(folder, out, "--overwrite", *flags) == 2
        assert contents(out) == before

    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(reconstruct, "Training", interrupted)
        assert images(photos, out, "--overwrite") == 130
    assert contents(out) == before
    prepared(photos, out, overwrite=True)
    assert set(contents(out)) == {"capture.json"}


def change_lens(folder: Path) -> None:
    path = folder / "transforms.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "fl_x": 30.0, "fl_y": 30.0}))


def change_distortion(folder: Path) -> None:
    path = folder / "transforms.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "k1": 0.05}))


def change_mask(folder: Path) -> None:
    path = folder / "masks/photo_03.png"
    image = Image.open(path).convert("L")
    image.putpixel((4, 4), 255 - image.getpixel((4, 4)))
    image.save(path)


def change_photo(folder: Path) -> None:
    path = folder / "images/photo_03.png"
    image = Image.open(path).convert("RGB")
    image.putpixel((4, 4), (255, 0, 255))
    image.save(path)


@pytest.mark.parametrize("change", [change_lens, change_distortion, change_mask, change_photo])
def test_what_training_sees_must_be_the_same_to_resume(tmp_path, change):
    folder = captures.transforms_capture(tmp_path / "c")
    (folder / "masks").mkdir()
    for name in (f"photo_{index:02}.png" for index in range(8)):
        Image.open(folder / "images" / name).convert("L").save(folder / "masks" / name)
    prepared(folder, tmp_path / "a")
    prepared(folder, tmp_path / "a", resume=True)
    change(folder)
    with pytest.raises(UserError, match="cannot resume with another views_points_sha256"):
        prepared(folder, tmp_path / "a", resume=True)


@pytest.fixture
def colmap(monkeypatch) -> None:
    """Every photo registers at once."""

    def run(request: dict[str, Any], progress: object) -> dict[str, int]:
        names = request["groups"][0]["names"]
        captures.colmap_model(Path(request["model"]), captures.cameras(), names, text=False)
        return {"registered": len(names)}

    monkeypatch.setattr(structure_from_motion, "_run_colmap", run)
    monkeypatch.setattr(structure_from_motion, "has_pycolmap", lambda: True)


@pytest.mark.usefixtures("colmap")
def test_training_that_has_begun_keeps_its_structure_from_motion(tmp_path):
    folder, out = tmp_path / "images", tmp_path / "a"
    captures.photos(folder, captures.cameras())
    prepared(folder, out)
    before = contents(out / "sfm")
    prepared(folder, out, resume=True)
    with pytest.raises(UserError, match="another sfm: lens_per_photo: the run has False"):
        prepared(folder, out, resume=True, sfm=SfmSettings(lens_per_photo=True))
    (folder / "photo_03.png").write_bytes((folder / "photo_02.png").read_bytes())
    with pytest.raises(UserError, match="cannot resume, as it was made from other photos"):
        prepared(folder, out, resume=True)
    assert contents(out / "sfm") == before
    (out / "capture.json").unlink()  # as after a run that found too few cameras
    run = prepared(folder, out, resume=True, sfm=SfmSettings(lens_per_photo=True))
    assert "made from other settings, photos" in run.notes[0]


@pytest.mark.usefixtures("colmap")
def test_photos_that_are_left_out_are_noted(tmp_path, capsys):
    folder, out = tmp_path / "images", tmp_path / "a"
    captures.photos(folder, captures.cameras())
    for name in ("a.HEIC", "b.heic", "c.dng", "photo_00.dng", "list.txt"):
        (folder / name).write_bytes(b"x")
    assert images(folder, out) == 0
    told = "photos of formats that are not read (1 .dng, 2 .heic): convert them to JPEG or PNG"
    assert told in capsys.readouterr().out
    assert any(told in note for note in json.loads((out / "capture.json").read_text())["notes"])


@pytest.mark.parametrize("inner", ["", "images"])
def test_folders_of_photos_that_are_not_read_are_named(tmp_path, capsys, inner):
    folder = tmp_path / "c" / inner
    folder.mkdir(parents=True)
    for index in range(5):
        (folder / f"{index}.AVIF").write_bytes(b"x")
    assert images(tmp_path / "c", tmp_path / "a") == 2
    assert "found photos of formats that are not read (5 .avif): convert" in capsys.readouterr().err


def test_settings_of_structure_from_motion_only_matter_where_it_is_used(photos, tmp_path):
    prepared(photos, tmp_path / "a")
    prepared(photos, tmp_path / "a", resume=True, sfm=SfmSettings(lens_per_photo=True))


def test_photos_of_one_name_in_two_folders_are_two(tmp_path):
    folder = captures.nested_capture(tmp_path / "c").parent
    assert images(folder, tmp_path / "a") == 0
    content = json.loads((tmp_path / "a/capture.json").read_text())
    assert {camera["name"] for camera in content["cameras"]} == {
        f"{side}/{index:04}.png" for side in ("left", "right") for index in range(4)
    }
    measured = content["result"]["held_out_psnr_db_per_photo"]
    assert set(measured) == {"left/0000.png", "right/0000.png"}
    assert sum(camera["held_out"] for camera in content["cameras"]) == 2


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--steps", "0"], "--steps: expected at least 1"),
        (["--hold-out", "1"], "--hold-out: expected 0 or at least 2"),
        (["--max-side", "2"], "--max-side"),
        (["--seed", "-1"], "--seed: expected 0 to 2,147,483,647, found -1"),
        (["--masks", "nowhere"], "expected a mask for every photo"),
        (["--device", "cuda:9"], "--device"),
    ],
)
def test_wrong_options_are_named(photos, tmp_path, capsys, flags, words):
    assert images(photos, tmp_path / "a", *flags) == 2
    assert words in capsys.readouterr().err


def test_more_initial_splats_than_are_allowed_are_thinned(photos, tmp_path, capsys):
    assert images(photos, tmp_path / "a", "--max-splats", "100", "--json") == 0
    content = json.loads(capsys.readouterr().out)
    assert 50 < content["result"]["splats"] <= 100
    assert any("--max-splats 100: an even choice of the" in note for note in content["notes"])


def test_folders_without_photos_are_named(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert images(tmp_path / "empty", tmp_path / "a") == 2
    assert "expected photos" in capsys.readouterr().err


def test_masks_restrict_the_splats_to_the_object(tmp_path):
    folder = captures.transforms_capture(tmp_path / "c", alpha=True)
    assert images(folder, tmp_path / "a") == 0
    means = read_splats(tmp_path / "a/splats.ply").splats.means
    # Without masks random points reach 4.5 to either side; within them, less than half of that,
    # and training moves few of them farther.
    assert means.abs().amax(dim=1).quantile(0.99) < 2.25
    assert means.abs().max() < 3.6
