"""One object: recognised, gone on with, published in one step, wherever a kill met it."""

import dataclasses
import json
from pathlib import Path

import pytest

from gscomplete.batch import storage
from gscomplete.batch.manifest import Item
from gscomplete.batch.work import ITEM_FILE, Task, do, input_signatures, option_key
from tests.builders.batch_jobs import ToyJob, notes_of


@pytest.fixture
def task(tmp_path) -> Task:
    for name in ("notes", "runs", "runs/.batch/work"):
        (tmp_path / name).mkdir(parents=True, exist_ok=True)
    (tmp_path / "a.ply").write_bytes(b"splats")
    runs = tmp_path / "runs"
    return Task(
        ToyJob(tmp_path / "notes"),
        Item("a", str(tmp_path / "a.ply")),
        "key",
        str(runs),
        str(runs / ".batch/work"),
        str(runs / ".batch/failed"),
    )


def changed(task: Task, **changes) -> Task:
    return Task(**{name: changes.get(name, getattr(task, name)) for name in Task.__slots__})


def leftovers(task: Task) -> list[str]:
    return [path.name for path in Path(task.work).iterdir()]


def test_a_finished_object_is_found_and_not_made_again(task):
    first, second = do(task), do(task)
    assert (first.status, second.status) == ("finished", "found")
    assert first.facts == second.facts == {"new_splats": 6}
    assert first.inputs == input_signatures(task.item.source)
    assert notes_of(task.job.notes) == {"a": ["begun"]}
    assert leftovers(task) == []


def test_another_input_or_other_options_make_it_again_and_replace_it(task):
    do(task)
    result = Path(task.runs, "a/completed.ply")
    before = result.read_bytes()
    Path(task.item.source).write_bytes(b"others")
    assert do(task).status == "finished"
    assert result.read_bytes() != before
    assert do(changed(task, key="other")).status == "finished"
    assert notes_of(task.job.notes) == {"a": ["begun"] * 3}
    assert leftovers(task) == []


def test_what_fails_leaves_a_log_and_what_was_there(task):
    do(task)
    kept = Path(task.runs, "a/completed.ply").read_bytes()
    Path(task.item.source).write_bytes(b"bad")
    row = do(task)
    assert (row.status, row.error) == ("failed", f"{task.item.source}: it is bad")
    assert Path(row.log).read_text() == row.error + "\n"
    assert Path(task.runs, "a/completed.ply").read_bytes() == kept
    Path(task.item.source).write_bytes(b"good")
    assert do(task).status == "finished"
    assert not Path(row.log).exists()


def test_a_log_may_name_a_file_whose_name_is_no_text(task):
    source = Path(task.item.source).with_name("n\udcff.ply")
    source.write_bytes(b"bad")
    row = do(changed(task, item=dataclasses.replace(task.item, source=str(source))))
    assert Path(row.log).read_text(encoding="utf-8").endswith("n\\udcff.ply: it is bad\n")


def test_an_unexpected_error_is_a_failure_with_its_traceback(task):
    Path(task.item.source).write_bytes(b"bug")
    row = do(task)
    assert row.error == "internal error: ZeroDivisionError: a bug"
    assert "batch_jobs.py" in Path(row.log).read_text()
    Path(task.item.source).unlink()
    assert "expected a splat file or an object folder" in do(task).error


def test_a_kill_between_finishing_and_publishing_costs_nothing(task, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(storage, "publish", lambda *arguments: exit_now())
        with pytest.raises(SystemExit):
            do(task)
    assert do(task).status == "finished"
    assert notes_of(task.job.notes) == {"a": ["begun"]}
    assert leftovers(task) == []


def test_a_kill_after_publishing_costs_nothing(task, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", lambda *arguments, **named: exit_now())
        with pytest.raises(SystemExit):
            do(task)
    assert do(task).status == "found"
    assert notes_of(task.job.notes) == {"a": ["begun"]}
    assert leftovers(task) == []


def test_what_a_kill_in_the_middle_of_a_record_leaves_goes(task):
    Path(task.work, ".a.json.abcdefgh.json").write_text("{")
    Path(task.work, ".b.json.abcdefgh.json").write_text("{")  # another worker's
    assert do(task).status == "finished"
    assert leftovers(task) == [".b.json.abcdefgh.json"]


def exit_now() -> None:
    raise SystemExit


def test_an_unfinished_run_goes_on_only_for_what_it_was_begun_with(task):
    stopped = changed(task, job=ToyJob(task.job.notes, stops=True))
    for unfinished in (stopped, stopped, changed(stopped, key="other")):
        with pytest.raises(KeyboardInterrupt):
            do(unfinished)
    assert notes_of(task.job.notes) == {"a": ["begun", "resumed", "begun"]}
    assert do(changed(task, key="other")).status == "finished"
    assert notes_of(task.job.notes) == {"a": ["begun", "resumed", "begun", "resumed"]}


def test_a_folder_of_somebody_else_is_left_alone(task):
    theirs = Path(task.runs, "a")
    theirs.mkdir()
    (theirs / "thesis.txt").write_text("mine")
    row = do(task)
    assert row.status == "failed"
    assert "move it away" in row.error
    assert (theirs / "thesis.txt").read_text() == "mine"


def test_stores_hold_what_this_machine_would(task):
    fsspec = pytest.importorskip("fsspec")
    store = fsspec.filesystem("memory")
    store.pipe("/worked/in/a.ply", b"splats")
    far = changed(task, item=Item("a", "memory://worked/in/a.ply"), runs="memory://worked/runs")
    assert (do(far).status, do(far).status) == ("finished", "found")
    assert do(task).status == "finished"
    for name in ("completed.ply", ITEM_FILE):
        assert store.cat_file(f"/worked/runs/a/{name}") == Path(task.runs, "a", name).read_bytes()
    run = json.loads(store.cat_file("/worked/runs/a/run.json"))
    assert run["input"]["path"] == "memory://worked/in/a.ply"
    assert leftovers(task) == []
    store.rm_file(f"/worked/runs/a/{ITEM_FILE}")  # an upload that was killed
    assert do(far).status == "finished"
    store.rm_file(f"/worked/runs/a/{ITEM_FILE}")
    store.pipe("/worked/runs/a/thesis.txt", b"mine")
    assert "move it away" in do(far).error
    assert store.exists("/worked/runs/a/thesis.txt")


def test_a_key_is_of_options_weights_and_the_object_s_own_options():
    item = Item("a", "a.ply", {"prompt": "a mug"})
    key = option_key({"preset": "default"}, item)
    assert key == option_key({"preset": "default"}, Item("b", "b.ply", {"prompt": "a mug"}))
    assert key != option_key({"preset": "fast"}, item)
    assert key != option_key({"preset": "default"}, Item("a", "a.ply", {"prompt": "a cup"}))
