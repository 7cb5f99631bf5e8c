"""Cost of planning a large batch, of a second run over a finished one, and of many objects.

``python -m recipes.benchmarks.batch.scale`` measures the first two on this machine. With
``--runs``, a folder of finished results, it also estimates the cost of ``--objects`` objects of
that kind: core seconds from the ledger, bytes from the folders, and, by simulation, the time lost
when workers die.

Conventions
-----------
* Workers die independently, at a given rate per hour. A worker that dies loses the work on its
  present object, up to a moment drawn uniformly from the object's seconds, and the time of one
  start.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscomplete.batch.ledger import Ledger, Row, read_ledger
from gscomplete.batch.manifest import plan
from gscomplete.batch.run import LEDGER_FILE, STATE_FOLDER
from gscomplete.batch.work import input_signatures, option_key
from gscomplete.cli.batch_job import ITEM_FIELDS, identity_of
from gscomplete.cli.complete_options import HowToComplete
from recipes.entry_point import start

_START_S = 6.0
"""Of a new worker until its first object is as fast as all others."""
_SIMULATED_HOURS = 10_000


@dataclass(frozen=True)
class Options:
    """Measure planning and second runs; say what many objects would take."""

    planned: int = 100_000
    """Objects of the manifest that is planned."""
    finished: int = 1_000
    """Objects of the finished batch that is run again."""
    runs: Path | None = None
    """Folder of results of a batch; None = measure only."""
    objects: int = 10_000_000
    """Number of objects of their kind to extrapolate to."""
    cores: int = 1_000
    """Cores to extrapolate to, with a worker on each."""
    deaths_per_hour: float = 0.05
    """Deaths of a worker per hour (preempted machines, memory, hardware)."""
    seed: int = 0
    """Seed of the simulation."""


def main(options: Options) -> None:
    """Measure, and print lines."""
    with tempfile.TemporaryDirectory() as folder:
        lines = [
            _planning(Path(folder), options.planned),
            _second_run(Path(folder), options.finished),
        ]
    if options.runs is not None:
        lines += _many(options)
    sys.stdout.write("\n".join(lines) + "\n")


def _planning(folder: Path, count: int) -> str:
    """Plan a manifest, and say how long it took and how much memory the process had at most."""
    path = folder / "objects.jsonl"
    with path.open("w") as file:
        for number in range(count):
            row = {"partial": f"objects/{number:08}", "prompt": f"object {number} of many"}
            file.write(json.dumps(row) + "\n")
    started = time.perf_counter()
    items = plan(str(path), ITEM_FIELDS)
    seconds = time.perf_counter() - started
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return f"{len(items):,} objects planned in {seconds:.2f} s, {peak_mb:.0f} MB at most"


def _second_run(folder: Path, count: int) -> str:
    """Run the command over a batch that is finished, and say how long it took."""
    objects, runs = folder / "in", folder / "runs"
    objects.mkdir()
    (runs / STATE_FOLDER).mkdir(parents=True)
    for number in range(count):
        (objects / f"{number:06}.ply").write_bytes(b"splats")
    identity = identity_of(HowToComplete(prompt="an object"))
    ledger = Ledger(runs / STATE_FOLDER / LEDGER_FILE)
    for item in plan(str(objects), {}):
        (runs / item.id).mkdir()
        key, inputs = option_key(identity, item), input_signatures(item.source)
        ledger.add(Row(item.id, "finished", key, inputs))
    ledger.close()
    asked = [sys.executable, "-m", "gscomplete.cli", "batch", str(objects), "--out", str(runs)]
    started = time.perf_counter()
    told = subprocess.run(
        [*asked, "--prompt", "an object", "--json"], check=True, capture_output=True, text=True
    )
    seconds = time.perf_counter() - started
    before = json.loads(told.stdout)["counts"]["finished_before"]
    return f"a second run over {before:,} finished objects: {seconds:.2f} s"


def _many(options: Options) -> list[str]:
    """Say what many objects of the kind of some results would take."""
    assert options.runs is not None
    state = options.runs / STATE_FOLDER / LEDGER_FILE
    rows = [row for row in read_ledger(state).values() if row.status == "finished"]
    seconds = np.array([row.seconds for row in rows])
    sizes = [_bytes_of(options.runs / row.id) for row in rows]
    files = np.mean([len(list((options.runs / row.id).iterdir())) for row in rows])
    lost = _lost_share(seconds, options)
    core_days = options.objects * seconds.mean() / (1 - lost) / 86400
    ledger_bytes = state.stat().st_size / len(state.read_bytes().splitlines())
    return [
        f"{len(rows)} objects: {seconds.mean():.2f} s of a worker each (median "
        f"{np.median(seconds):.2f}, longest {seconds.max():.2f})",
        f"{options.objects:,} objects: {core_days:,.0f} days of a core, "
        f"{core_days / options.cores:.1f} days on {options.cores:,} cores",
        f"lost to {options.deaths_per_hour} deaths an hour of a worker: {100 * lost:.2f} %",
        f"results: {np.mean(sizes) / 1e6:.2f} MB and {files:.0f} files each, "
        f"{options.objects * np.mean(sizes) / 1e12:.1f} TB in all; ledger "
        f"{options.objects * ledger_bytes / 1e9:.1f} GB",
        f"written together: {options.cores * np.mean(sizes) / seconds.mean() / 1e6:,.0f} MB/s and "
        f"{options.cores * files / seconds.mean():,.0f} files a second",
    ]


def _bytes_of(folder: Path) -> int:
    """Return the bytes of all files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _lost_share(seconds: np.ndarray, options: Options) -> float:  # [N]
    """Simulate one worker for many hours; return the share of its time that deaths cost."""
    random = np.random.default_rng(options.seed)
    total = _SIMULATED_HOURS * 3600.0
    deaths = random.poisson(options.deaths_per_hour * _SIMULATED_HOURS)
    # a death is more likely during a longer object
    met = random.choice(seconds, deaths, p=seconds / seconds.sum())
    return float((met * random.uniform(size=deaths)).sum() + _START_S * deaths) / total


if __name__ == "__main__":
    start(main, Options, __doc__)
