"""Datasets build, stay, go on after failures, and validate names what is wrong."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import trimesh

from gscomplete.errors import UserError
from splatcomplete_data.cli import main
from splatcomplete_data.cli.images import ImagesOptions
from splatcomplete_data.dataset.build import _begin_capture, _make, build, fingerprint
from splatcomplete_data.dataset.recipe import read_recipe
from splatcomplete_data.dataset.stats import survey
from splatcomplete_data.dataset.validate import validate_dataset

HEAD = "schema: splatcomplete.recipe\nversion: 1\nname: test\n"
TWO = """objects:
  - {id: box, command: mesh, file: box.ply, count: 3000, cut: ['plane:90'], licence: CC0,
     prompt: a box, view: '270,10'}
  - {id: broken, command: mesh, file: broken.ply, prompt: nothing}
"""


def sources(folder: Path) -> Path:
    data = folder / "data"
    data.mkdir()
    trimesh.creation.box((1, 1, 1)).export(data / "box.ply")
    (data / "broken.ply").write_bytes(b"")
    return data


def recipe(folder: Path, text: str) -> Path:
    path = folder / "recipe.yaml"
    path.write_text(HEAD + text)
    return path


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A dataset of one good and one broken object, with its recipe and data."""
    folder = tmp_path_factory.mktemp("dataset")
    data, path = sources(folder), recipe(folder, TWO)
    outcomes = build(read_recipe(path), data, folder / "out", workers=1)
    assert [outcome.status for outcome in outcomes] == ["built", "failed"]
    assert "broken.ply" in outcomes[1].message
    return folder / "out", path, data


def test_a_second_build_does_nothing(built: tuple[Path, Path, Path]) -> None:
    out, path, data = built
    before = {p: p.stat().st_mtime_ns for p in (out / "box").iterdir()}
    outcomes = build(read_recipe(path), data, out, workers=1, only=("box",))
    assert [outcome.status for outcome in outcomes] == ["up to date"]
    assert {p: p.stat().st_mtime_ns for p in (out / "box").iterdir()} == before
    record = json.loads((out / "box/object.json").read_text())
    assert record["source"]["file"] == "box.ply"  # relative: the same bytes wherever data lie


def test_what_other_code_made_is_made_anew_unless_it_is_to_stay(
    built: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    out, path, data = tmp_path / "out", built[1], built[2]
    shutil.copytree(built[0], out)
    state = out / ".build/box.json"
    made = state.read_text()
    older = {**json.loads(made), "code": "of another version"}
    unknown = {name: older[name] for name in ("fingerprint", "result")}  # of builds before it
    statuses = []
    for before, any_code in ((older, True), (older, False), (unknown, False)):
        state.write_text(json.dumps(before))
        outcomes = build(read_recipe(path), data, out, workers=1, only=("box",), any_code=any_code)
        statuses += [outcome.status for outcome in outcomes]
    assert statuses == ["up to date", "built", "built"]
    assert state.read_text() == made


def test_validate_names_every_fault(
    built: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, _, _ = built
    count, findings = validate_dataset(out)
    assert count == 1
    assert findings == []

    def names_after(change: object) -> set[str]:
        copy = tmp_path / "copy"
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(out, copy)
        change(copy)  # type: ignore[operator]
        return {finding.name for finding in validate_dataset(copy)[1]}

    def edit(key: str, value: object) -> object:
        def change(copy: Path) -> None:
            path = copy / "box/object.json"
            path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))

        return change

    assert "missing_file" in names_after(lambda c: (c / "box/preview.png").unlink())
    assert "unknown_file" in names_after(lambda c: (c / "box/extra").write_text("x"))
    assert "wrong_size" in names_after(lambda c: (c / "box/partial.ply").write_bytes(b"ply"))
    flipped = names_after(
        lambda c: (c / "box/preview.png").write_bytes(
            (c / "box/preview.png").read_bytes()[:-1] + b"x"
        )
    )
    assert "wrong_hash" in flipped
    assert "bad_record" in names_after(lambda c: (c / "box/object.json").write_text("{"))
    assert "changed_record" in names_after(edit("prompt", "another"))
    assert "wrong_count" in names_after(edit("counts", {"partial": 1, "complete": 2}))
    assert "other_name" in names_after(edit("id", "another"))
    frame = {"up": "Z", "center_file": [9.0, 0, 0], "size_file": 1.0}
    assert "outside_frame" in names_after(edit("frame", frame))
    assert "missing_object" in names_after(
        lambda c: shutil.copytree(c / "box", c / "new")
    ) or "unlisted_object" in names_after(lambda c: shutil.copytree(c / "box", c / "new"))
    assert main(["validate", str(out)]) == 0
    assert main(["validate", str(tmp_path / "nowhere")]) == 2
    assert "nowhere" in capsys.readouterr().err


def test_stats_and_list(
    built: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, _, _ = built
    rows = survey(out).rows
    assert [(row.id, row.subset, row.in_recipe) for row in rows] == [("box", "mesh", True)]
    assert 0 < rows[0].partial < rows[0].complete
    assert main(["stats", str(out), "--sheet", str(tmp_path / "sheet.png")]) == 0
    assert (tmp_path / "sheet.png").stat().st_size > 1000
    assert main(["list", str(out), "--json"]) == 0
    assert '"id": "box"' in capsys.readouterr().out


def test_stray_folders_and_forgotten_objects_are_named(
    built: tuple[Path, Path, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "out"
    shutil.copytree(built[0], out)
    (out / "notes").mkdir()
    record = json.loads((out / "box/object.json").read_text())
    for name, count in (("a", 10), ("b", 21), ("c", 40)):
        shutil.copytree(out / "box", out / name)
        changed = {**record, "id": name, "counts": {**record["counts"], "partial": count}}
        (out / name / "object.json").write_text(json.dumps(changed))
    assert main(["list", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"left out: {out / 'notes'}: expected an object folder" in said
    assert "not in the recipe (by dataset.json): a" in said
    assert "dataset.json): box" not in said
    assert main(["stats", str(out), "--sheet", str(tmp_path / "sheet.png")]) == 0
    most = record["counts"]["partial"]
    assert f"10 / 30.5 / {most:,}" in capsys.readouterr().out
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert main(["stats", str(out)]) == 0
    Path("contact_sheet.png").write_text("mine")
    assert main(["stats", str(out)]) == 2
    assert Path("contact_sheet.png").read_text() == "mine"
    capsys.readouterr()
    assert main(["stats", str(out), "--json"]) == 0
    printed = capsys.readouterr()
    assert len(json.loads(printed.out)["objects"]) == 4
    assert "notes" in printed.err
    (tmp_path / "empty/inner").mkdir(parents=True)
    with pytest.raises(UserError, match="expected objects, found none"):
        survey(tmp_path / "empty")


def test_what_decides_an_object_is_in_its_fingerprint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = tmp_path / "data"
    data.mkdir()
    (data / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    text = "objects: [{id: a, command: mesh, file: a.obj, count: 300}]\n"
    entry = read_recipe(recipe(tmp_path, text)).objects[0]
    seen = {fingerprint(entry, data, tmp_path)}

    def differs() -> bool:
        before = len(seen)
        seen.add(fingerprint(entry, data, tmp_path))
        return len(seen) > before

    assert not differs()
    shutil.copy(data / "a.obj", data / "\udcff.obj")
    no_text = dataclasses.replace(entry, values=entry.values | {"file": "\udcff.obj"})
    assert fingerprint(no_text, data, tmp_path) not in seen
    (data / "a.mtl").write_text("newmtl m\nmap_Kd a.png\n")
    assert differs()
    (data / "a.png").write_bytes(b"one")
    assert differs()
    (data / "a.png").write_bytes(b"two")
    assert differs()
    (data / "other.png").write_bytes(b"nobody names it")
    assert not differs()
    monkeypatch.setattr("splatcomplete_data.dataset.build.__version__", "another")
    assert differs()


def test_the_record_beside_a_splat_file_is_in_the_fingerprint_of_its_part(
    built: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    data = tmp_path / "data"
    shutil.copytree(built[0] / "box", data / "box")
    text = "objects: [{id: a, command: partial, file: box/complete.ply, cut: ['plane:0']}]\n"
    entry = read_recipe(recipe(tmp_path, text)).objects[0]
    seen = {fingerprint(entry, data, tmp_path)}
    path = data / "box/object.json"
    record = json.loads(path.read_text())
    path.write_text(json.dumps({**record, "frame": {**record["frame"], "up": "X"}}))
    seen.add(fingerprint(entry, data, tmp_path))
    path.unlink()
    seen.add(fingerprint(entry, data, tmp_path))
    assert len(seen) == 3


def test_a_file_of_boxes_is_in_the_fingerprint(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    text = "objects: [{id: a, command: scan, file: a.ply, prompt: a cup, box: [boxes.txt]}]\n"
    entry = read_recipe(recipe(tmp_path, text)).objects[0]
    seen = set()
    for content in ("0,0,0,1,1,1\n", "0,0,0,1,1,2\n"):
        (data / "boxes.txt").write_text(content)
        seen.add(fingerprint(entry, data, tmp_path))
    assert len(seen) == 2


@pytest.mark.parametrize("place", ["photos/masks", "masks"])
def test_masks_that_a_capture_finds_by_itself_are_in_its_fingerprint(
    tmp_path: Path, place: str
) -> None:
    data = tmp_path / "data"
    (data / "photos").mkdir(parents=True)
    (data / "photos/a.jpg").write_bytes(b"photo")
    text = (
        "captures: [{id: c, command: images, images: photos}]\n"
        "objects: [{id: a, command: crop, file: 'capture:c'}]\n"
    )
    entry = read_recipe(recipe(tmp_path, text)).captures[0]
    seen = {fingerprint(entry, data, tmp_path)}
    (data / place).mkdir()
    for content in (b"one", b"two"):
        (data / place / "a.png").write_bytes(content)
        seen.add(fingerprint(entry, data, tmp_path))
    assert len(seen) == 3


def test_a_damaged_object_that_is_not_asked_for_does_not_stop_others(
    built: tuple[Path, Path, Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    _, path, data = built
    (tmp_path / "out/broken").mkdir(parents=True)
    (tmp_path / "out/broken/object.json").write_text("{")
    outcomes = build(read_recipe(path), data, tmp_path / "out", workers=1, only=("box",))
    assert [outcome.status for outcome in outcomes] == ["built"]
    assert any("broken/object.json" in record.getMessage() for record in caplog.records)


def test_captures_resume_only_what_was_made_from_the_same_things(tmp_path: Path) -> None:
    state, folder = tmp_path / "state.json", tmp_path / "capture"
    options = ImagesOptions(images=tmp_path, out=folder)

    def begun(print_: str, code: str = "a") -> tuple[bool, bool]:
        now = _begin_capture(state, print_, code, options)
        return now.resume, now.overwrite

    assert begun("one") == (False, True)
    folder.mkdir()
    assert begun("one") == (False, True)  # killed before anything was there
    (folder / "sfm").mkdir()
    assert begun("one") == (True, False)
    assert begun("one", "b") == (False, True)
    (folder / "sfm").mkdir()
    assert begun("two") == (False, True)
    assert list(folder.iterdir()) == []  # what is resumed next time is made from "two"
    (folder / "capture.json").write_text("{}")
    assert begun("two") == (True, False)
    (folder / "letter.txt").write_text("mine")
    with pytest.raises(UserError, match=r"letter\.txt"):
        begun("three")
    assert (folder / "letter.txt").read_text() == "mine"


def test_a_folder_that_the_build_did_not_make_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(sources(tmp_path))
    out, state = tmp_path / "out", tmp_path / "out/.build/box.json"
    (out / ".build").mkdir(parents=True)
    entry = read_recipe(recipe(tmp_path, TWO)).objects[0]
    ends: list[type[BaseException]] = []

    def run(entry: object, options: Any, said: object) -> None:
        if ends and ends[0] is UserError:
            raise UserError("no")
        options.out.mkdir(exist_ok=True)
        (options.out / "object.json").write_text("new")
        if ends:
            raise ends[0]

    monkeypatch.setattr("splatcomplete_data.dataset.build._run_command", run)
    (out / "box").mkdir()
    (out / "box/object.json").write_text("by hand")
    outcome = _make(entry, str(out))
    assert outcome.status == "failed"
    assert "box: expected nothing or a folder that this build made" in outcome.message
    assert (out / "box/object.json").read_text() == "by hand"
    assert not state.exists()
    shutil.rmtree(out / "box")
    ends = [UserError]
    assert _make(entry, str(out)).message == "no"
    assert not state.exists()
    ends = [KeyboardInterrupt]  # between the object and its state
    with pytest.raises(KeyboardInterrupt):
        _make(entry, str(out))
    assert (out / "box/object.json").is_file()
    ends = []
    assert _make(entry, str(out)).status == "built"
    assert _make(entry, str(out)).status == "built"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("objects: []\n", "objects"),
        ("objects: [{id: a, command: fly}]\n", "command"),
        ("objects: [{id: a, command: {}}]\n", "command: expected one of"),
        ("objects: [{id: a, command: mesh}]\n", "file"),
        (
            "objects: [{id: a, command: mesh, file: x, speed: 3}]\n",
            "unknown option 'speed'; expected prompt, view",
        ),
        ("objects: [{id: a, command: mesh, file: x, cut: ['plan:0']}]\n", "'plan:0'"),
        ("objects: [{id: a, command: mesh, file: x, count: many}]\n", "count"),
        ("objects: [{id: a, command: mesh, file: x, out: y}]\n", "out"),
        ("objects: [{id: a, command: crop, file: x, pick: true}]\n", "pick: set by build"),
        ("objects: [{id: ../a, command: mesh, file: x}]\n", "id"),
        ("objects: [{id: dataset.json, command: mesh, file: x}]\n", "entry 1: id: .* found 'data"),
        ("objects: [{id: Object.json, command: mesh, file: x}]\n", "entry 1: id: .* found 'Obj"),
        ("objects: [{id: a, command: crop, file: 'capture:b'}]\n", "capture"),
        (
            "objects: [{id: a, command: mesh, file: x}, {id: a, command: mesh, file: y}]\n",
            "a: expected each id once",
        ),
        (
            "captures: [{id: a, command: images, images: x}]\n"
            "objects: [{id: a, command: mesh, file: x}]\n",
            "a: expected each id once, found a capture's too",
        ),
        ("objects: {a: 1}\n", "list"),
        ("surplus: 1\n", "surplus"),
        ("objects: [\n", "YAML"),
    ],
)
def test_odd_recipes_name_the_entry(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        read_recipe(recipe(tmp_path, text))


def test_the_open_recipe_has_39_objects_of_all_subsets() -> None:
    path = Path(__file__).resolve().parents[3] / "recipes/splatcomplete_open/recipe.yaml"
    found = read_recipe(path)
    assert len(found.objects) == 39
    commands = [entry.command for entry in found.objects]
    assert commands.count("depth") >= 3
    assert commands.count("scan") >= 5
    assert commands.count("crop") >= 2
    for entry in found.objects:
        assert entry.values["prompt"]
        assert entry.values["licence"]
        assert entry.values.get("range", 50.0) == 50.0
