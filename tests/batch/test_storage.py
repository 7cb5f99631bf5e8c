"""A batch from an s3-like store into it, through s3fs and a server that the test starts."""

import hashlib
import json

import pytest

from gscomplete.batch import storage
from gscomplete.batch.machine import GIB, WorkerPlan
from gscomplete.batch.manifest import plan
from gscomplete.batch.run import LEDGER_FILE, open_batch, run_batch
from gscomplete.errors import UserError
from tests.builders.batch_jobs import ToyJob, notes_of

s3fs = pytest.importorskip("s3fs")
moto_server = pytest.importorskip("moto.server")


@pytest.fixture
def store(monkeypatch):
    """A bucket called lab."""
    server = moto_server.ThreadedMotoServer("127.0.0.1", 0)
    server.start()
    host, port = server.get_host_and_port()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "test")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "test")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    s3fs.S3FileSystem.clear_instance_cache()
    system = s3fs.S3FileSystem()
    system.makedirs("lab", exist_ok=True)
    yield system
    s3fs.S3FileSystem.clear_instance_cache()
    server.stop()


def test_a_batch_over_a_store_survives_kills_and_goes_on_elsewhere(store, tmp_path):
    for name in ("cow", "owl", "mug"):
        store.pipe_file(f"lab/in/{name}/object.json", b"{}")
        store.pipe_file(f"lab/in/{name}/partial.ply", b"bad" if name == "mug" else name.encode())
    items = plan("s3://lab/in", {})
    assert [item.id for item in items] == ["cow", "mug", "owl"]
    notes = tmp_path / "notes"
    notes.mkdir()
    job, workers = ToyJob(notes, kills=("cow",)), WorkerPlan(2, 1, 8 * GIB)
    batch = open_batch(items, {}, "s3://lab/out", scratch=tmp_path / "scratch")
    summary = run_batch(batch, job, workers)
    assert summary.counts == {"finished": 2, "failed": 1}
    assert notes_of(notes) == {"cow": ["begun", "resumed"], "owl": ["begun"]}
    assert store.cat_file("lab/out/cow/completed.ply") == hashlib.sha256(b"cow").digest()
    assert b"it is bad" in store.cat_file("lab/out/.batch/failed/mug.log")
    rows = store.cat_file(f"lab/out/.batch/{LEDGER_FILE}").splitlines()
    assert sorted(json.loads(row)["id"] for row in rows) == ["cow", "mug", "owl"]
    elsewhere = open_batch(items, {}, "s3://lab/out", scratch=tmp_path / "another machine")
    assert [item.id for item in elsewhere.to_do] == ["mug"]
    store.pipe_file("lab/in/owl/partial.ply", b"hoo")
    again = open_batch(items, {}, "s3://lab/out", scratch=tmp_path / "a third")
    assert [item.id for item in again.to_do] == ["mug", "owl"]


def test_what_is_not_there_is_told_in_one_line(store):
    with pytest.raises(UserError, match="expected a folder, a dataset or a manifest, found none"):
        plan("s3://lab/nothing", {})
    with pytest.raises(UserError, match="no such file"):
        plan("s3://lab/nothing.jsonl", {})
    assert storage.signature("s3://lab/nothing.ply") is None


class Unreachable:
    """A file system whose library has errors of its own kind, as botocore has without a key."""

    def __getattr__(self, name):
        def fail(*_, **__):
            raise RuntimeError("no credentials")

        return fail


def test_a_store_that_cannot_be_reached_is_told_in_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr(storage, "_open", lambda url: (Unreachable(), "lab/a"))
    (tmp_path / "work").mkdir()
    (tmp_path / "file").write_text("a")
    url = "s3://lab/a"
    for ask in (
        lambda: storage.read_text(url),
        lambda: storage.list_folder(url),
        lambda: storage.folders_with(url, "object.json"),
        lambda: storage.fetch(url, tmp_path / "here"),
        lambda: storage.put(tmp_path / "file", url),
        lambda: storage.publish(tmp_path / "work", url, "run.json"),
    ):
        with pytest.raises(UserError, match=r"s3://lab/a: cannot .*RuntimeError: no credentials"):
            ask()
    assert storage.signature(url) is None
    assert (tmp_path / "work").is_dir()  # what could not be published is kept
