"""Tasks on a real Ray cluster of this machine."""

import os

import pytest

from gscomplete.batch.machine import GIB, WorkerPlan
from gscomplete.batch.manifest import Item
from gscomplete.batch.on_ray import run_on_ray
from gscomplete.batch.run import open_batch, run_batch
from gscomplete.errors import UserError
from tests.builders import batch_jobs

WORKERS = WorkerPlan(2, 1, GIB)


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    """Have Ray's processes find the tests."""
    pytest.importorskip("ray")
    monkeypatch.setenv("PYTHONPATH", os.getcwd())


def test_a_batch_on_two_workers_goes_past_failures_and_kills(tmp_path):
    (tmp_path / "notes").mkdir()
    for name in "abcd":
        (tmp_path / f"{name}.ply").write_bytes(b"bad" if name == "d" else name.encode())
    items = [Item(name, str(tmp_path / f"{name}.ply")) for name in "abcd"]
    batch = open_batch(items, {}, str(tmp_path / "runs"))
    job = batch_jobs.ToyJob(tmp_path / "notes", kills=("b",))
    summary = run_batch(batch, job, WORKERS, ray="local")
    assert summary.counts == {"finished": 3, "failed": 1}
    assert batch_jobs.notes_of(tmp_path / "notes") == {
        "a": ["begun"],
        "b": ["begun", "resumed"],
        "c": ["begun"],
    }


def test_a_cluster_that_is_not_there_is_one_line():
    with pytest.raises(UserError, match="cannot connect to a cluster"):
        list(run_on_ray(batch_jobs.square, [1], WORKERS, "127.0.0.1:1"))
