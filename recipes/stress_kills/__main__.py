"""Kill jobs at random moments: ``python -m recipes.stress_kills [--kills 100] [--disk DIR]``.

A completion with checkpoints, a build of four objects and a batch of three are stopped repeatedly
by SIGKILL, SIGTERM and Ctrl-C, and started again with the command that their messages give. In the
end their results must have the same bytes as those of undisturbed jobs, no partial result may ever
have been visible, and every message must be one line. With ``--disk``, a folder on a small file
system such as one made by ``mount -t tmpfs -o size=64m tmpfs DIR``, the jobs write there, and it is
nearly full at every third start.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from recipes.entry_point import start
from recipes.stress_kills.disk import SmallDisk
from recipes.stress_kills.jobs import small_jobs
from recipes.stress_kills.killing import kill_often, run_undisturbed


@dataclass(frozen=True)
class Options:
    """Kill jobs at random moments."""

    kills: int = 100
    """Number of kills, over all jobs."""
    seed: int = 0
    """Seed of moments and signals; when exactly a signal arrives is the machine's business."""
    disk: Path | None = None
    """Folder on a small file system, which is filled; None = a folder for temporary files, which
    is not."""
    jobs: tuple[Literal["complete", "build", "batch"], ...] = ("complete", "build", "batch")
    """Jobs to kill."""


def main(options: Options) -> int:
    """Kill the jobs and report, a JSON line each; return 1 if anything was lost."""
    disk = None if options.disk is None else SmallDisk(options.disk)
    failed = False
    with tempfile.TemporaryDirectory() as name, tempfile.TemporaryDirectory(dir=options.disk) as to:
        inputs, undisturbed, work = Path(name, "inputs"), Path(name, "undisturbed"), Path(to)
        inputs.mkdir()
        undisturbed.mkdir()
        jobs = [job for job in small_jobs(inputs) if job.name in options.jobs]
        before = _contents(inputs)
        for job in jobs:
            started = time.monotonic()
            reference = run_undisturbed(job, undisturbed / job.name)
            each = -(-options.kills // len(jobs))
            tally = kill_often(job, reference, work, each, options.seed, disk)
            if _contents(inputs) != before:
                tally.faults.append("an input has changed")
            failed |= bool(tally.faults)
            told = {"job": job.name, "ends": tally.ends, "faults": tally.faults}
            told |= {"undisturbed_s": round(reference.seconds, 1)}
            told |= {"minutes": round((time.monotonic() - started) / 60, 1)}
            sys.stdout.write(json.dumps(told) + "\n")
            sys.stdout.flush()
    return 1 if failed else 0


def _contents(folder: Path) -> dict[str, bytes]:
    """Return all files below a folder."""
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


if __name__ == "__main__":
    start(main, Options, __doc__)
