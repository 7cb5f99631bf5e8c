"""What was measured is found again while all that it was made from is the same."""

import hashlib
import json
from pathlib import Path

import pytest

import gscomplete
from gscomplete.errors import UserError
from gscomplete.evaluate import kept as kept_module
from gscomplete.evaluate.kept import Kept, KeptResults, package_digest
from gscomplete.evaluate.rows import Row

ROW = Row("ours", "cup", None, {"clip": 0.1 + 0.2, "chamfer": None}, 2.5, {"x": "y"}, ("n\u00e4",))
KEPT = Kept(ROW, {"title": "cup", "pictures": [1, 2]})
SETTINGS = {"views": 4}


@pytest.fixture(autouse=True)
def _fixed_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_module, "package_digest", lambda: "code")


@pytest.fixture
def sources(tmp_path: Path) -> list[Path]:
    """A folder of a run, another of an object, and a file."""
    run, known, alone = tmp_path / "run", tmp_path / "object", tmp_path / "alone.bin"
    for path in (run / "run.json", run / "completed.ply", run / "extra.ply", known / "object.json"):
        path.parent.mkdir(exist_ok=True)
        path.write_text(path.name)
    alone.write_text("alone")
    return [run, known, alone]


@pytest.fixture
def results(tmp_path: Path, sources: list[Path]) -> KeptResults:
    found = KeptResults(tmp_path / "kept", SETTINGS)
    found.add("ours", "cup", sources, KEPT)
    return found


def test_what_is_added_is_found_by_method_and_object(results, sources, tmp_path):
    assert results.find("ours", "cup", sources) == KEPT
    assert results.find("ours", "mug", sources) is None
    assert results.find("other", "cup", sources) is None
    assert KeptResults(tmp_path / "kept", SETTINGS).find("ours", "cup", sources) == KEPT
    assert [path.name for path in (tmp_path / "kept" / "ours").iterdir()] == ["cup.json"]


def test_a_folder_that_is_not_there_holds_nothing_and_is_not_made_by_looking(sources, tmp_path):
    assert KeptResults(tmp_path / "none", SETTINGS).find("ours", "cup", sources) is None
    assert not (tmp_path / "none").exists()


def test_a_completion_without_a_card_is_found_without_one(results, sources):
    results.add("ours", "cup", sources, Kept(ROW, None))
    assert results.find("ours", "cup", sources) == Kept(ROW, None)


@pytest.mark.parametrize(
    "name",
    ["run/run.json", "run/completed.ply", "run/extra.ply", "object/object.json", "alone.bin"],
)
def test_a_changed_byte_of_any_measured_file_makes_it_stale(results, sources, tmp_path, name):
    path = tmp_path / name
    before = path.read_bytes()
    path.write_bytes(before[:-1] + b"?")
    assert results.find("ours", "cup", sources) is None
    path.write_bytes(before)
    assert results.find("ours", "cup", sources) == KEPT


def test_files_that_are_not_measured_do_not_count(results, sources, tmp_path):
    (tmp_path / "run" / "log.txt").write_text("later")
    (tmp_path / "run" / "deeper").mkdir()
    (tmp_path / "run" / "deeper" / "other.ply").write_text("later")
    assert results.find("ours", "cup", sources) == KEPT
    (tmp_path / "run" / "new.ply").write_text("later")
    assert results.find("ours", "cup", sources) is None


def test_fewer_files_and_sources_make_it_stale(results, sources, tmp_path):
    assert results.find("ours", "cup", sources[:2]) is None
    assert results.find("ours", "cup", sources[::-1]) is None
    (tmp_path / "run" / "extra.ply").unlink()
    assert results.find("ours", "cup", sources) is None


def test_other_settings_and_other_code_make_it_stale(results, sources, tmp_path, monkeypatch):
    folder = tmp_path / "kept"
    assert KeptResults(folder, {"views": 5}).find("ours", "cup", sources) is None
    monkeypatch.setattr(kept_module, "package_digest", lambda: "other code")
    assert KeptResults(folder, SETTINGS).find("ours", "cup", sources) is None


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "{}", "3"])
def test_damaged_files_are_measured_again(results, sources, tmp_path, text):
    (tmp_path / "kept/ours/cup.json").write_text(text)
    assert results.find("ours", "cup", sources) is None
    results.add("ours", "cup", sources, KEPT)
    assert results.find("ours", "cup", sources) == KEPT


@pytest.mark.parametrize("field", ["row", "card", "made_from"])
def test_files_that_lack_a_field_are_measured_again(results, sources, tmp_path, field):
    path = tmp_path / "kept/ours/cup.json"
    content = json.loads(path.read_text())
    del content[field]
    path.write_text(json.dumps(content))
    assert results.find("ours", "cup", sources) is None


@pytest.mark.parametrize("value", [None, 7, {}, {"method": 3}])
def test_rows_of_another_kind_are_measured_again(results, sources, tmp_path, value):
    path = tmp_path / "kept/ours/cup.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"row": value}))
    assert results.find("ours", "cup", sources) is None


def test_a_source_that_is_gone_is_no_source(results, sources, tmp_path):
    (tmp_path / "alone.bin").unlink()
    assert results.find("ours", "cup", sources) is None


def test_a_folder_that_cannot_be_written_is_named(sources, tmp_path):
    (tmp_path / "kept").write_text("a file")
    with pytest.raises(UserError, match=r"kept.ours: cannot create it"):
        KeptResults(tmp_path / "kept", SETTINGS).add("ours", "cup", sources, KEPT)


def test_the_digest_of_code_is_of_names_and_bytes_of_all_modules(monkeypatch, tmp_path):
    files = {"a.py": b"one", "deep/b.py": b"two", "c.txt": b"no code"}
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    monkeypatch.setattr(gscomplete, "__path__", [str(tmp_path)])
    assert package_digest() == hashlib.sha256(b"a.py\0one" + b"deep/b.py\0two").hexdigest()
    (tmp_path / "a.py").rename(tmp_path / "e.py")
    assert package_digest() == hashlib.sha256(b"deep/b.py\0two" + b"e.py\0one").hexdigest()
