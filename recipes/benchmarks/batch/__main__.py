"""Batches against runs one by one: the same bytes, kills, and throughput.

``python -m recipes.benchmarks.batch --dataset DIR --meshes PACK --out runs/batch`` completes 64
real objects in several ways and compares the bytes of their run folders:

* ``one-by-one``: ``gscomplete complete``, a process for each object.
* ``local``: ``gscomplete batch`` with its defaults.
* ``killed``: the same, but random workers are killed by SIGKILL, and occasionally the batch itself,
  which is then started again.
* ``ray``: on a Ray cluster of this machine, whose workers are also killed at random.
* ``alternate``: measures the ratio of times. It completes groups of the first objects one by one
  and as a batch in turn, so that other load on the machine slows both alike.

Each row is saved when it is measured: a way that is done is not done again.
"""

from __future__ import annotations

import json
import os
import random
import signal
import statistics
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from gscomplete.batch.ledger import read_ledger
from gscomplete.errors import UserError
from gscomplete.util.digests import sha256_of
from recipes.benchmarks.batch.objects import make_objects
from recipes.entry_point import start
from recipes.results import Results

Way = Literal["one-by-one", "local", "killed", "ray", "alternate"]
_FILES = ("completed.ply", "preview.png", "turntable.webp")
_SECONDS_BETWEEN_KILLS = (3.0, 15.0)
_SHARE_OF_BATCHES = 0.25
"""Of kills in ``killed`` that meet the batch itself."""
_GROUP = 6
"""Objects of a group that is done in both ways, one after the other."""


@dataclass(frozen=True)
class Options:
    """Complete real objects in batches and one by one."""

    out: Path
    """Folder for objects, run folders and ``results.json``."""
    dataset: Path | None = None
    """SplatComplete-open as built by splatcomplete-data; None = none of its objects."""
    meshes: Path | None = None
    """Folder of the pack of meshes; None = no parts of it."""
    objects: int = 64
    """Number of objects, the dataset's first."""
    ways: tuple[Way, ...] = ("one-by-one", "local", "killed", "ray", "alternate")
    """What to do, in order; the others are compared with ``one-by-one``."""
    kills: int = 12
    """Workers killed in ``killed`` and in ``ray``."""
    alternating: int = 24
    """Objects of ``alternate``."""
    preset: str = "default"
    """Preset of all runs."""
    seed: int = 0
    """Seed of the moments of kills."""


def main(options: Options) -> int:
    """Run the ways; exit code 1 if a byte differs or an object is lost or done twice."""
    manifest = make_objects(options.out, options.dataset, options.meshes, options.objects)
    rows = [json.loads(line) for line in manifest.read_text().splitlines()]
    results = Results(options.out / "results.json", {"preset": options.preset, "objects": rows})
    for way in options.ways:
        if way in results.rows:
            continue
        _say(f"{way} ...")
        results.rows[way] = _WAYS[way](options, manifest, rows)
        results.save()
    sys.stdout.write(_table(results.rows))
    return int(any(row.get("differ") or row.get("wrong") for row in results.rows.values()))


def _one_by_one(options: Options, manifest: Path, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Complete each object by a command of its own."""
    runs = options.out / "one-by-one"
    runs.mkdir(exist_ok=True)
    started = time.perf_counter()
    for row in rows:
        if not (runs / row["id"] / "completed.ply").exists():
            _complete(row, runs / row["id"], options.preset)
    return _row(options, runs, rows, time.perf_counter() - started)


def _complete(row: dict[str, Any], run: Path, preset: str) -> None:
    """Complete an object by ``gscomplete complete``.

    Raises:
        UserError: the command fails.
    """
    asked = _command("complete", row["partial"], "--out", run, "--preset", preset)
    if "prompt" in row:
        asked += ["--prompt", row["prompt"]]
    ended = subprocess.run(asked, capture_output=True, text=True)
    if ended.returncode:
        raise UserError(f"{' '.join(asked)}: {ended.stderr[-500:]}")


def _local(options: Options, manifest: Path, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Complete all objects by one undisturbed batch."""
    runs = options.out / "local"
    seconds, _, _ = _batch(manifest, runs, options.preset)
    return _row(options, runs, rows, seconds) | _twice(runs, rows)


def _killed(options: Options, manifest: Path, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Complete all objects by batches whose processes are killed."""
    runs = options.out / "killed"
    moments = random.Random(options.seed)
    seconds, killed, restarts = 0.0, 0, 0

    def kill(batch: subprocess.Popen[str]) -> int:
        if moments.random() < _SHARE_OF_BATCHES:
            batch.kill()
            return 0
        return _kill_one(_workers(batch.pid), moments)

    while True:
        took, more, code = _batch(
            manifest,
            runs,
            options.preset,
            ("--retries", str(options.kills)),
            kill if killed < options.kills else None,
            options.kills - killed,
            moments,
        )
        seconds, killed = seconds + took, killed + more
        if code >= 0:
            break
        restarts += 1
    row = _row(options, runs, rows, seconds) | _twice(runs, rows)
    return row | {"workers_killed": killed, "batches_killed": restarts, "exit_code": code}


def _ray(options: Options, manifest: Path, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Complete all objects on a cluster of two workers that are killed."""
    runs = options.out / "ray"
    moments = random.Random(options.seed)
    more = ("--ray", "local", "--workers", "2", "--retries", str(options.kills))

    def kill(batch: subprocess.Popen[str]) -> int:
        return _kill_one(_ray_workers(batch.pid), moments)

    seconds, killed, code = _batch(
        manifest, runs, options.preset, more, kill, options.kills, moments
    )
    row = _row(options, runs, rows, seconds) | _twice(runs, rows)
    return row | {"workers_killed": killed, "exit_code": code}


def _alternate(options: Options, manifest: Path, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Measure groups of objects one by one and as a batch, in turn."""
    folder = options.out / "alternate"
    folder.mkdir(exist_ok=True)
    ratios, seconds = [], {"one-by-one": 0.0, "batch": 0.0}
    tag = int(time.time())
    for first in range(0, min(options.alternating, len(rows)), _GROUP):
        group = rows[first : first + _GROUP]
        part = folder / f"{first}.jsonl"
        part.write_text("".join(json.dumps(row) + "\n" for row in group))
        took = {}
        for way in ("one-by-one", "batch")[:: 1 if first // _GROUP % 2 else -1]:
            runs = folder / f"{way}-{first}-{tag}"
            if way == "batch":
                took[way], _, _ = _batch(part, runs, options.preset)
            else:
                runs.mkdir()
                started = time.perf_counter()
                for row in group:
                    _complete(row, runs / row["id"], options.preset)
                took[way] = time.perf_counter() - started
            seconds[way] += took[way]
        ratios.append(took["one-by-one"] / took["batch"])
        _say(f"{len(group)} objects: {took}, {ratios[-1]:.2f} times")
    return {
        "seconds": seconds,
        "ratios": ratios,
        "ratio": seconds["one-by-one"] / seconds["batch"],
        "median_ratio": statistics.median(ratios),
        "group": _GROUP,
    }


def _batch(
    manifest: Path,
    runs: Path,
    preset: str,
    more: tuple[str, ...] = (),
    kill: Callable[[subprocess.Popen[str]], int] | None = None,
    most_kills: int = 0,
    moments: random.Random | None = None,
) -> tuple[float, int, int]:
    """Run a batch to its end.

    Args:
        manifest: its objects.
        runs: its results.
        preset: of its runs.
        more: options.
        kill: kills something, and returns how many workers.
        most_kills: workers to kill at most.
        moments: when.

    Returns:
        Seconds, workers killed, exit code (negative = the batch was killed itself).
    """
    started = time.perf_counter()
    asked = _command("batch", manifest, "--out", runs, "--preset", preset, *more)
    log = runs.parent / f"{runs.name}.log"
    killed = 0
    with log.open("a") as said:
        batch = subprocess.Popen(asked, stdout=said, stderr=said, text=True)
        while batch.poll() is None:
            if kill is None or moments is None or killed >= most_kills:
                batch.wait()
                break
            try:
                batch.wait(timeout=moments.uniform(*_SECONDS_BETWEEN_KILLS))
            except subprocess.TimeoutExpired:
                killed += kill(batch)
    return time.perf_counter() - started, killed, batch.returncode


def _command(*arguments: object) -> list[str]:
    """Return a call of the ``gscomplete`` command."""
    return [sys.executable, "-m", "gscomplete.cli", *map(str, arguments)]


def _kill_one(processes: list[int], moments: random.Random) -> int:
    """Kill one of some processes; return how many were killed."""
    if not processes:
        return 0
    try:
        os.kill(moments.choice(processes), signal.SIGKILL)
    except ProcessLookupError:
        return 0
    return 1


def _workers(parent: int) -> list[int]:
    """Return a batch's own worker processes."""
    return [p for p, above, line in _processes() if above == parent and b"spawn_main" in line]


def _ray_workers(parent: int) -> list[int]:
    """Return the processes of a batch's Ray cluster that do a task now."""
    processes = _processes()
    family = {parent}
    for _ in range(4):
        family |= {process for process, above, _ in processes if above in family}
    return [p for p, _, line in processes if p in family and line.startswith(b"ray::_do")]


def _processes() -> list[tuple[int, int, bytes]]:
    """Return number, parent and command line of all processes of this machine (Linux)."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            found.append((int(folder.name), parent, (folder / "cmdline").read_bytes()))
        except (OSError, ValueError):
            continue
    return found


def _row(
    options: Options, runs: Path, rows: list[dict[str, Any]], seconds: float
) -> dict[str, Any]:
    """Compare the files of a way's results with those of the runs one by one."""
    truth = options.out / "one-by-one"
    differ = []
    for row in rows:
        for name in _FILES:
            ours, other = runs / row["id"] / name, truth / row["id"] / name
            if not ours.is_file() or not other.is_file() or sha256_of(ours) != sha256_of(other):
                differ.append(f"{row['id']}/{name}")
    return {"seconds": seconds, "objects": len(rows), "differ": differ}


def _twice(runs: Path, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Count objects that were lost or done twice, by the ledger."""
    path = runs / ".batch/ledger.jsonl"
    finished: Counter[str] = Counter()
    for line in path.read_text().splitlines():
        row = json.loads(line)
        finished[row["id"]] += row["status"] == "finished"
    last = read_ledger(path)
    wrong = [row["id"] for row in rows if finished[row["id"]] > 1]
    wrong += [r["id"] for r in rows if r["id"] not in last or last[r["id"]].status == "failed"]
    return {"wrong": wrong, "left_over": sorted(os.listdir(runs / ".batch/work"))}


def _say(line: str) -> None:
    """Tell how far it is."""
    sys.stderr.write(line + "\n")
    sys.stderr.flush()


def _table(results: dict[str, Any]) -> str:
    """Show what came of each way."""
    lines = []
    for way, row in results.items():
        if way == "alternate":
            lines.append(
                f"{way:12} one by one {row['seconds']['one-by-one']:.1f} s, as batches "
                f"{row['seconds']['batch']:.1f} s: {row['ratio']:.2f} times (median of groups "
                f"{row['median_ratio']:.2f})"
            )
            continue
        killed = row.get("workers_killed", 0), row.get("batches_killed", 0)
        lines.append(
            f"{way:12} {row['objects']} objects, {row['seconds']:.1f} s, "
            f"{row['seconds'] / row['objects']:.2f} s each; {len(row['differ'])} files differ; "
            f"{len(row.get('wrong', []))} lost or done twice; {killed[0]} workers and {killed[1]} "
            "batches killed"
        )
    return "\n".join(lines) + "\n"


_WAYS: dict[Way, Callable[[Options, Path, list[dict[str, Any]]], dict[str, Any]]] = {
    "one-by-one": _one_by_one,
    "local": _local,
    "killed": _killed,
    "ray": _ray,
    "alternate": _alternate,
}


if __name__ == "__main__":
    start(main, Options, __doc__)
