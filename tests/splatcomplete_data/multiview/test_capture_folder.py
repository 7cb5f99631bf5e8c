"""An old capture stays until the new one is set up, whatever happens meanwhile."""

from __future__ import annotations

from pathlib import Path

import pytest

from gscomplete.errors import UserError
from splatcomplete_data.multiview.capture_folder import capture_folder, clear_capture

OLD = {"capture.json": "old", "splats.ply": "old", "sfm/database.db": "old"}
NEW = {"capture.json": "new", "log.jsonl": "new"}


def write(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def files(folder: Path) -> dict[str, str]:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_text() for path in paths}


def replace(out: Path, error: BaseException | None = None) -> None:
    with capture_folder(out, resume=False, overwrite=True):
        assert not (out / "sfm").exists()  # structure from motion starts anew
        write(out, {**NEW, "sfm/colmap.log": "new"})
        if error is not None:
            raise error


def test_a_new_capture_takes_the_place_of_the_old(tmp_path):
    out = write(tmp_path / "c", OLD)
    replace(out)
    assert files(out) == {**NEW, "sfm/colmap.log": "new"}
    assert sorted(path.name for path in out.iterdir()) == ["capture.json", "log.jsonl", "sfm"]


@pytest.mark.parametrize("error", [UserError("no"), KeyboardInterrupt(), SystemExit(3)])
def test_whatever_fails_the_old_capture_is_back(tmp_path, error):
    out = write(tmp_path / "c", OLD)
    with pytest.raises(type(error)):
        replace(out, error)
    assert files(out) == OLD
    assert sorted(path.name for path in out.iterdir()) == ["capture.json", "sfm", "splats.ply"]


def test_what_a_first_run_has_found_stays(tmp_path):
    with pytest.raises(UserError):
        replace(tmp_path / "c", UserError("too few photos registered"))
    assert files(tmp_path / "c") == {**NEW, "sfm/colmap.log": "new"}  # --resume goes on with it


@pytest.mark.parametrize(
    "left",
    [
        {".previous/" + name: text for name, text in OLD.items()} | NEW,
        {".previous.moving/splats.ply": "old"}
        | {name: text for name, text in OLD.items() if name != "splats.ply"},
        OLD | {".previous.dropped/splats.ply": "older"},
    ],
)
@pytest.mark.parametrize("resume", [True, False])
def test_what_a_killed_run_left_is_the_old_capture(tmp_path, left, resume):
    out = write(tmp_path / "c", left)
    if resume:
        with capture_folder(out, resume=True, overwrite=False):
            assert files(out) == OLD
    else:
        with pytest.raises(UserError, match="stop"):
            replace(out, UserError("stop"))
    assert files(out) == OLD


@pytest.mark.parametrize("step", range(12))
def test_killed_at_any_rename_the_old_capture_is_whole(tmp_path, monkeypatch, step):
    out, count, real = write(tmp_path / "c", OLD), 0, Path.rename

    def killed(*arguments):
        raise KeyboardInterrupt

    def rename(path, target):
        nonlocal count
        count += 1
        if count > step:
            killed()
        return real(path, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "rename", rename)
        with pytest.raises(UserError if step > 7 else KeyboardInterrupt):
            replace(out, UserError("no"))
    with capture_folder(out, resume=True, overwrite=False):
        assert files(out) == OLD


def test_folders_with_other_things_are_never_cleared(tmp_path):
    out = write(tmp_path / "c", {**OLD, "letter.txt": "mine"})
    with pytest.raises(UserError, match=r"letter\.txt"):
        replace(out)
    with pytest.raises(UserError, match=r"letter\.txt"):
        clear_capture(out)
    assert files(out) == {**OLD, "letter.txt": "mine"}
    (out / "letter.txt").unlink()
    clear_capture(out)
    assert list(out.iterdir()) == []
    clear_capture(tmp_path / "nothing")


def test_the_first_file_of_a_killed_run_is_in_nobodys_way(tmp_path):
    out = write(tmp_path / "c", {".capture.json.ab12_xyz.json": '{"sch'})
    with capture_folder(out, resume=False, overwrite=False):
        assert list(out.iterdir()) == []
    out = write(tmp_path / "d", {**OLD, ".splats.ply.ab12_xyz.ply": "ply"})
    replace(out)
    assert files(out) == {**NEW, "sfm/colmap.log": "new"}


def test_a_file_in_place_of_the_folder_is_named(tmp_path):
    (tmp_path / "c").write_text("mine")
    with (
        pytest.raises(UserError, match="--out: expected a folder to create, found a file"),
        capture_folder(tmp_path / "c", resume=False, overwrite=True),
    ):
        raise AssertionError
