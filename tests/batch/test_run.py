"""Batches from the first object to a second run that has nothing to do."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gscomplete.batch.ledger import Ledger, Row, read_ledger
from gscomplete.batch.machine import GIB, WorkerPlan
from gscomplete.batch.manifest import Item
from gscomplete.batch.run import LEDGER_FILE, Batch, Summary, open_batch, run_batch
from gscomplete.batch.work import input_signatures, option_key
from gscomplete.errors import UserError
from tests.builders.batch_jobs import ToyJob, notes_of

IDENTITY = {"preset": "fast", "weights": "1"}
WORKERS = WorkerPlan(2, 1, 8 * GIB)


@pytest.fixture
def items(tmp_path) -> list[Item]:
    (tmp_path / "notes").mkdir()
    for name in "abcdef":
        (tmp_path / f"{name}.ply").write_bytes(b"bad" if name == "d" else name.encode())
    return [Item(name, str(tmp_path / f"{name}.ply")) for name in "abcdef"]


def opened(tmp_path: Path, items: list[Item], identity: dict = IDENTITY, **more) -> Batch:
    return open_batch(items, identity, str(tmp_path / "runs"), **more)


def ran(batch: Batch, tmp_path: Path, kills: tuple[str, ...] = (), **more) -> Summary:
    return run_batch(batch, ToyJob(tmp_path / "notes", kills), WORKERS, **more)


def test_a_batch_goes_past_failures_and_kills_and_does_nothing_twice(items, tmp_path):
    seen: list[Row] = []
    batch = opened(tmp_path, items)
    summary = ran(batch, tmp_path, kills=("b", "f"), on_row=seen.append)
    assert summary.counts == {"finished": 5, "failed": 1}
    assert [row.id for row in summary.failed] == ["d"]
    assert sorted(row.id for row in seen) == list("abcdef")
    notes = notes_of(tmp_path / "notes")
    assert notes == {
        "a": ["begun"],
        "b": ["begun", "resumed"],
        "c": ["begun"],
        "e": ["begun"],
        "f": ["begun", "resumed"],
    }
    rows = read_ledger(batch.state / LEDGER_FILE)
    assert {name: row.attempts for name, row in rows.items()} == dict.fromkeys("abcdef", 1) | {
        "b": 2,
        "f": 2,
    }
    del batch
    again = opened(tmp_path, items)
    assert [item.id for item in again.to_do] == ["d"]
    assert ran(again, tmp_path).counts == {"failed": 1}
    assert notes_of(tmp_path / "notes") == notes


def test_without_its_ledger_a_batch_finds_what_is_finished(items, tmp_path):
    ran(opened(tmp_path, items), tmp_path)
    (tmp_path / "runs/.batch" / LEDGER_FILE).unlink()
    assert ran(opened(tmp_path, items), tmp_path).counts == {"found": 5, "failed": 1}


def test_what_changed_or_was_removed_is_done_again(items, tmp_path):
    ran(opened(tmp_path, items), tmp_path)
    (tmp_path / "a.ply").write_bytes(b"another")
    os.rename(tmp_path / "runs/c", tmp_path / "elsewhere")
    batch = opened(tmp_path, items)
    assert [item.id for item in batch.to_do] == ["a", "c", "d"]


@pytest.mark.parametrize("with_ledger", [True, False])
def test_a_result_that_lost_a_file_is_made_again(items, tmp_path, with_ledger):
    ran(opened(tmp_path, items), tmp_path)
    runs = tmp_path / "runs"
    (runs / "a/completed.ply").unlink()
    (runs / "b/completed.ply").write_bytes(b"")
    (runs / "c/run.json").write_bytes(b"\xff{")
    if not with_ledger:
        (runs / ".batch" / LEDGER_FILE).unlink()
    batch = opened(tmp_path, items)
    assert {"a", "b", "c"} <= {item.id for item in batch.to_do}
    assert ("e" in {item.id for item in batch.to_do}) != with_ledger
    counts = ran(batch, tmp_path).counts
    assert counts["finished"] == 3
    assert counts.get("found", 0) == (0 if with_ledger else 2)
    assert all((runs / name / "completed.ply").stat().st_size for name in "abcef")


def test_other_options_are_refused_unless_all_is_to_be_done_again(items, tmp_path):
    ran(opened(tmp_path, items), tmp_path)
    other = IDENTITY | {"preset": "default"}
    with pytest.raises(UserError, match="preset 'fast', now 'default'; choose another --out"):
        opened(tmp_path, items, other)
    assert len(opened(tmp_path, items, other, redo=True).to_do) == 6


def test_two_batches_do_not_share_a_folder(items, tmp_path):
    batch = opened(tmp_path, items)
    other = f"from gscomplete.batch.run import open_batch; open_batch([], {{}}, {batch.runs!r})"
    ended = subprocess.run([sys.executable, "-c", other], capture_output=True, text=True)
    assert "another process is at work in this folder" in ended.stderr
    assert len(batch.to_do) == 6


def test_a_second_run_over_a_thousand_finished_objects_takes_no_time(tmp_path):
    runs = tmp_path / "runs"
    (runs / ".batch").mkdir(parents=True)
    items, ledger = [], Ledger(runs / ".batch" / LEDGER_FILE)
    for number in range(1000):
        name = f"{number:04}"
        (runs / name).mkdir()
        (runs / name / "completed.ply").write_bytes(b"splats")
        (runs / name / "run.json").write_text("{}")
        path = tmp_path / f"{name}.ply"
        path.write_bytes(b"splats")
        item = Item(name, str(path))
        items.append(item)
        key = option_key(IDENTITY, item)
        ledger.add(Row(name, "finished", key, input_signatures(str(path))))
    ledger.close()
    started = time.perf_counter()
    batch = opened(tmp_path, items)
    assert not batch.to_do
    assert time.perf_counter() - started < 5


def test_results_in_a_store_have_their_ledger_there(items, tmp_path):
    fsspec = pytest.importorskip("fsspec")
    store = fsspec.filesystem("memory")
    runs = "memory://ledgers/runs"
    batch = open_batch(items, IDENTITY, runs, scratch=tmp_path / "scratch")
    ledger = Ledger(batch.state / LEDGER_FILE)
    signatures = input_signatures(items[0].source)
    ledger.add(Row("a", "finished", option_key(IDENTITY, items[0]), signatures))
    ledger.close()
    for name in ("item.json", "run.json", "completed.ply"):
        store.pipe(f"/ledgers/runs/a/{name}", b"{}")
    run_batch(
        open_batch(items[:1], IDENTITY, runs, scratch=tmp_path / "scratch"),
        ToyJob(tmp_path),
        WORKERS,
    )
    assert json.loads(store.cat_file(f"/ledgers/runs/.batch/{LEDGER_FILE}"))["id"] == "a"
    elsewhere = open_batch(items, IDENTITY, runs, scratch=tmp_path / "another machine")
    assert [item.id for item in elsewhere.to_do] == list("bcdef")
