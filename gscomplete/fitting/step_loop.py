"""The loop of jobs that take many steps: one log line per step, checkpoints, and resuming.

Conventions
-----------
* A job's folder holds ``log.jsonl`` (a line per step taken) and ``checkpoints/``.
* A job that was interrupted by Ctrl-C, or killed, resumes from its last checkpoint and gives the
  same bytes as one that ran through.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.fitting.checkpoint import save_checkpoint
from gscomplete.util.atomic import atomic_path
from gscomplete.util.jsonio import read_json

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

LOG_FILE = "log.jsonl"
CHECKPOINTS = "checkpoints"
_LONGEST_VALUE = 60
"""Characters of a setting that a message shows."""

Report = TypeVar("Report", bound="DataclassInstance")
Report_co = TypeVar("Report_co", bound="DataclassInstance", covariant=True)


class StepJob(Protocol[Report_co]):
    """A job that is done step by step."""

    step_number: int
    """Steps taken."""

    @property
    def finished(self) -> bool:
        """Whether all steps are taken."""

    @property
    def between_updates(self) -> bool:
        """Whether the job may be resumed from the present :meth:`state`."""

    def step(self) -> Report_co:
        """Take a step."""

    def state(self) -> dict[str, Tensor]:
        """Return all that the next step depends on."""


def run_steps(
    job: StepJob[Report], out: Path, checkpoint_every: int, on_step: Callable[[Report], None]
) -> None:
    """Take all remaining steps.

    Args:
        job: what to do.
        out: the job's folder.
        checkpoint_every: steps; 0 = only at the end, or when interrupted.
        on_step: called after every step.

    Raises:
        UserError: the log or a checkpoint cannot be written.
    """
    _trim_log(out / LOG_FILE, job.step_number)
    try:
        _run_trimmed(job, out, checkpoint_every, on_step)
    except OSError as error:
        where = error.filename or out / LOG_FILE
        raise UserError(
            f"{where}: cannot write: {error.strerror or error}; --resume continues from the last "
            "checkpoint"
        ) from error


def logged_seconds(path: Path, steps: int) -> float:
    """Return how long the first steps of a job took, by its log; damaged lines count nothing.

    Args:
        path: the log; it need not exist.
        steps: how many steps.
    """
    if not path.exists():
        return 0.0
    total = 0.0
    for line in path.read_bytes().splitlines()[:steps]:
        with contextlib.suppress(ValueError, TypeError, KeyError):
            total += float(json.loads(line)["seconds"])
    return total


def _run_trimmed(
    job: StepJob[Report], out: Path, checkpoint_every: int, on_step: Callable[[Report], None]
) -> None:
    """Do what ``run_steps`` does; the log already ends at the job's present step."""
    folder = out / CHECKPOINTS
    with (out / LOG_FILE).open("a", encoding="utf-8") as log:
        try:
            while not job.finished:
                report = job.step()
                log.write(json.dumps(dataclasses.asdict(report)) + "\n")
                on_step(report)
                if checkpoint_every and job.step_number % checkpoint_every == 0:
                    log.flush()
                    save_checkpoint(folder, job.state())
        except KeyboardInterrupt:
            if job.between_updates:
                log.flush()
                save_checkpoint(folder, job.state())
            raise
    save_checkpoint(folder, job.state())


def require_same_identity(path: Path, identity: dict[str, Any]) -> None:
    """Refuse to resume a job with settings that would change its result.

    Args:
        path: JSON file of the job, whose "identity" holds all that decides the result.
        identity: the same for the present call.

    Raises:
        UserError: they differ (the message says in what), or the file is damaged.
    """
    data = read_json(path)
    stored = data.get("identity") if isinstance(data, dict) else None
    if not isinstance(stored, dict):
        raise UserError(f"{path}: identity: expected an object, found {type(stored).__name__}")
    for key, value in identity.items():
        found = stored.get(key)
        if found == value:
            continue
        if isinstance(value, dict) and isinstance(found, dict):
            detail = "; ".join(_differences(found, value))
        else:
            detail = f"the run has {found!r}, asked for {value!r}"
        raise UserError(
            f"{path}: cannot resume with another {key}: {detail}; resume with the options that it "
            "was started with"
        )


def _differences(stored: dict[str, Any], asked: dict[str, Any], inside: str = "") -> Iterator[str]:
    """Yield what differs, value by value."""
    for name in {**asked, **stored}:
        mine, theirs = stored.get(name), asked.get(name)
        if (name in stored, mine) == (name in asked, theirs):
            continue
        if isinstance(mine, dict) and isinstance(theirs, dict):
            yield from _differences(mine, theirs, f"{inside}{name}.")
        else:
            yield f"{inside}{name}: the run has {_of(stored, name)}, asked for {_of(asked, name)}"


def _of(settings: dict[str, Any], name: str) -> str:
    """Return a setting as text; null is not the same as no such setting."""
    if name not in settings:
        return "no such setting"
    text = repr(settings[name])
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."


def _trim_log(path: Path, step: int) -> None:
    """Drop log lines of steps that will be taken again."""
    if not path.exists():
        return
    lines = path.read_bytes().splitlines(keepends=True)[:step]  # as they are, damaged or not
    with atomic_path(path) as temporary:
        temporary.write_bytes(b"".join(lines))
