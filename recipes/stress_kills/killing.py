"""Start a job, stop it at a random moment, start it again, until it is finished; then compare.

Conventions
-----------
* A job is stopped by SIGKILL (three of five times, the process alone or with its workers), SIGTERM
  or Ctrl-C, which reaches its workers too as from a terminal.
* With a small disk, every third start finds it nearly full, and every sixth gets no signal but runs
  until the disk is full.
* A fault is anything that a user would report: a partial or different result, an exit code or a
  traceback that neither a signal nor a full disk explains, workers that survive, a changed input.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from recipes.stress_kills.disk import SmallDisk
from recipes.stress_kills.jobs import Job

_LONGEST_S = 900.0
"""A start that takes longer hangs."""
_WORKERS_END_S = 120.0
"""Workers of a killed job have to notice within this time."""
_LATEST = 1.1
"""Kills come up to this many times as late as the fastest job so far ends."""


@dataclass
class Tally:
    """What happened to a job."""

    ends: Counter[str] = field(default_factory=Counter)
    """How starts ended: by which signal, with a full disk, or finished."""
    faults: list[str] = field(default_factory=list)

    @property
    def kills(self) -> int:
        """Starts that a signal ended."""
        return sum(count for name, count in self.ends.items() if name.startswith("SIG"))


@dataclass(frozen=True)
class Reference:
    """An undisturbed job."""

    digests: dict[str, str]
    """SHA-256 of each result."""
    seconds: float


def run_undisturbed(job: Job, out: Path) -> Reference:
    """Run a job once; return what it gives.

    Raises:
        RuntimeError: it fails.
    """
    started = time.monotonic()
    done = subprocess.run(job.command(out), capture_output=True, text=True, timeout=_LONGEST_S)
    if done.returncode != 0:
        raise RuntimeError(f"{job.name}: {done.stderr}")
    return Reference(digests_of(job, out), time.monotonic() - started)


def kill_often(
    job: Job, reference: Reference, work: Path, kills: int, seed: int, disk: SmallDisk | None = None
) -> Tally:
    """Kill a job until it was killed often enough and is finished.

    Args:
        job: which one.
        reference: the same job, undisturbed.
        work: folder for its folders.
        kills: how often at least.
        seed: of moments and signals.
        disk: a small disk that ``work`` lies on, which is full at every third start; None = never.
    """
    rng = np.random.default_rng((seed, *job.name.encode()))
    tally = Tally()
    number, starts, usual_s = 0, 0, reference.seconds
    out = work / f"{job.name}0"
    while tally.kills < kills and len(tally.faults) < 10:
        is_full = disk is not None and starts % 3 == 1
        with disk.nearly_full(rng) if disk is not None and is_full else contextlib.nullcontext():
            is_fresh, started = not out.exists(), time.monotonic()
            moments = None if is_full and starts % 6 == 1 else rng
            end = _one_start(job, out, moments, usual_s, tally, is_full=is_full)
        if end == "finished" and is_fresh:
            usual_s = min(usual_s, time.monotonic() - started)
        starts += 1
        tally.ends[end] += 1
        sys.stderr.write(f"{job.name}: {tally.kills} of {kills} kills, {number} finished: {end}\n")
        tally.faults += [f"{out.name}: {fault}" for fault in _wrong(job, out, reference)]
        if end == "finished":
            number += 1
            tally.faults += _missing(job, out, reference)
            shutil.rmtree(out)
            out = work / f"{job.name}{number}"
    if _one_start(job, out, None, usual_s, tally) == "finished":
        tally.faults += _wrong(job, out, reference) + _missing(job, out, reference)
    return tally


def digests_of(job: Job, out: Path) -> dict[str, str]:
    """Return the SHA-256 of the results that are there."""
    paths = {name: out / name for name in job.results}
    return {
        name: hashlib.sha256(path.read_bytes()).hexdigest()
        for name, path in paths.items()
        if path.is_file()
    }


def _one_start(
    job: Job,
    out: Path,
    rng: np.random.Generator | None,
    usual_s: float,
    tally: Tally,
    *,
    is_full: bool = False,
) -> str:
    """Start a job and stop it, or not without ``rng``; return how it ended."""
    command = job.command(out)
    child = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
    )
    wait_s = _LONGEST_S if rng is None else float(rng.uniform(0, _LATEST * usual_s))
    sent = ""
    try:
        _, told = child.communicate(timeout=wait_s)
    except subprocess.TimeoutExpired:
        sent = "hangs" if rng is None else _send(child, rng)
        if rng is None:
            os.killpg(child.pid, signal.SIGKILL)
        _, told = child.communicate(timeout=_LONGEST_S)
    _await_workers(child.pid, job, tally)
    said = told.decode(errors="replace").strip()
    code = child.returncode
    if code == 0:
        return "finished"
    if sent and code in _codes_of(sent) and "Traceback" not in said:
        return sent
    if is_full and code in job.stopped_codes and "internal error" not in said:
        return "full disk"
    tally.faults.append(f"{job.name}: {sent or 'undisturbed'}: exit code {code}: {said[-400:]}")
    return sent or "failed"


def _send(child: subprocess.Popen[bytes], rng: np.random.Generator) -> str:
    """Send a signal; return its name."""
    kind = int(rng.integers(5))
    if kind < 3:
        if kind < 2:
            os.killpg(child.pid, signal.SIGKILL)
        else:
            child.kill()
        return "SIGKILL"
    if kind == 3:
        child.send_signal(signal.SIGTERM)
        return "SIGTERM"
    os.killpg(child.pid, signal.SIGINT)
    return "SIGINT"


def _codes_of(sent: str) -> tuple[int, ...]:
    """Return the exit codes of a job that a signal stopped: its own, or the system's."""
    number = int(signal.Signals[sent])
    return (-number, 128 + number)


def _await_workers(group: int, job: Job, tally: Tally) -> None:
    """Wait until the processes of a job are gone."""
    deadline = time.monotonic() + _WORKERS_END_S
    while time.monotonic() < deadline:
        if not _is_alive(group):
            return
        time.sleep(0.05)
    tally.faults.append(f"{job.name}: workers live on")
    os.killpg(group, signal.SIGKILL)


def _is_alive(group: int) -> bool:
    """Tell whether a group has processes that run; those that only wait to be reaped do not."""
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, IndexError):
            state, _, found = (folder / "stat").read_text().rpartition(")")[2].split()[:3]
            if int(found) == group and state not in "ZX":
                return True
    return False


def _wrong(job: Job, out: Path, reference: Reference) -> list[str]:
    """Name the results that are there and differ."""
    found = digests_of(job, out)
    return [f"{name} differs" for name, value in found.items() if value != reference.digests[name]]


def _missing(job: Job, out: Path, reference: Reference) -> list[str]:
    """Name the results that a finished job lacks."""
    found = digests_of(job, out)
    return [f"{out.name}: {name} is missing" for name in reference.digests if name not in found]
