"""``gscomplete batch`` as a user runs it: same bytes as one by one, and nothing twice when killed.

Objects are parts of the demo's sample, completed with ``fast`` and one answer of the shape network
in place of nine.
"""

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
import torch

from gscomplete.splats import read_splats, write_splats
from tests.builders.commands import PATIENCE_S, SAMPLE, run_here, start_alone

HOW = ("--preset", "fast", "--mirror", "none")
NAMES = ("low", "high")
THREADS = str(torch.get_num_threads())


@pytest.fixture(scope="module")
def manifest(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("objects")
    splats = read_splats(SAMPLE).splats
    height = splats.means[:, 2]
    for name, keep in zip(NAMES, (height < height.median(), height > height.median()), strict=True):
        write_splats(folder / f"{name}.ply", splats.select(keep))
    rows = [{"partial": f"{name}.ply", "prompt": "a red mug"} for name in NAMES]
    path = folder / "objects.jsonl"
    path.write_text("\n".join(map(json.dumps, rows)))
    return path


@pytest.fixture(scope="module")
def one_by_one(manifest, tmp_path_factory) -> dict[str, bytes]:
    out = tmp_path_factory.mktemp("one by one")
    for name in NAMES:
        part, run = manifest.with_name(f"{name}.ply"), out / name
        done = run_here("complete", part, "--prompt", "a red mug", "--out", run, *HOW)
        assert done.returncode == 0, done.stderr
    return results(out)


def results(runs: Path) -> dict[str, bytes]:
    """The files of all run folders that must not differ."""
    files = ("completed.ply", "preview.png", "turntable.webp")
    return {f"{name}/{file}": (runs / name / file).read_bytes() for name in NAMES for file in files}


def start(manifest: Path, out: Path, *more: object) -> subprocess.Popen:
    return start_alone("batch", manifest, "--out", out, *HOW, "--threads", THREADS, "--json", *more)


def workers_of(batch: subprocess.Popen) -> list[int]:
    """Processes of a batch that complete objects, by Linux's list of processes."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            is_worker = b"spawn_main" in (folder / "cmdline").read_bytes()
        except (OSError, ValueError):
            continue
        if parent == batch.pid and is_worker:
            found.append(int(folder.name))
    return found


def wait_until(condition, batch: subprocess.Popen) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert batch.poll() is None, batch.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs Linux's /proc")
def test_killed_batches_lose_nothing_and_do_nothing_twice(manifest, one_by_one, tmp_path):
    out = tmp_path / "runs"
    first = start(manifest, out, "--workers", 1)
    wait_until(lambda: (out / ".batch/work/low/run.json").exists(), first)
    os.kill(workers_of(first)[0], signal.SIGKILL)  # in the middle of an object
    wait_until(lambda: (out / "low/run.json").exists(), first)
    first.kill()
    first.wait()
    second = start(manifest, out, "--workers", 1)
    told, said = second.communicate(timeout=PATIENCE_S)
    assert second.returncode == 0, said
    assert json.loads(told)["objects"] == 2
    assert results(out) == one_by_one
    rows = [json.loads(row) for row in (out / ".batch/ledger.jsonl").read_text().splitlines()]
    assert [row["id"] for row in rows if row["status"] == "finished"].count("high") == 1
    assert not any((out / ".batch/work").iterdir())
    third = run_here("batch", manifest, "--out", out, *HOW, "--json")
    assert json.loads(third.stdout)["counts"] == {"finished_before": 2}, third.stderr


def test_a_ray_cluster_gives_the_same_bytes(manifest, one_by_one, tmp_path):
    pytest.importorskip("ray")
    batch = start(manifest, tmp_path / "runs", "--ray", "local", "--workers", 2)
    told, said = batch.communicate(timeout=PATIENCE_S)
    assert batch.returncode == 0, said
    assert json.loads(told)["counts"] == {"finished_before": 0, "finished": 2}
    assert results(tmp_path / "runs") == one_by_one


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_ctrl_c_ends_a_batch_in_one_line(manifest, tmp_path):
    batch = start(manifest, tmp_path / "runs", "--workers", 2)
    wait_until(lambda: (tmp_path / "runs/.batch/ledger.jsonl").exists(), batch)
    time.sleep(0.5)
    batch.send_signal(signal.SIGINT)
    told, said = batch.communicate(timeout=PATIENCE_S)
    assert batch.returncode == 130, said
    assert "interrupted; the same command continues with the unfinished objects" in said
    assert "Traceback" not in said
    assert told == ""
