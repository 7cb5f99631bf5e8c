"""A batch: find out which objects are to be done, do them on workers, and record them in a ledger.

Conventions
-----------
* ``RUNS/ID`` is the run folder of object ID. ``RUNS/.batch`` holds ``batch.json`` (options and
  weights), ``ledger.jsonl``, ``failed/ID.log``, and, where RUNS is on this machine, ``work/``.
* Where RUNS is in a store, unfinished objects and the ledger being written are in a folder of this
  machine, and the ledger is copied to the store from time to time.
* An object counts as finished if the ledger says so for the same options and weights, its files
  still have the size and time (or tag) that they had then, and its result exists. All others go to
  workers, which read the files; for an object that is finished but missing in the ledger, this read
  is the only cost.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gscomplete.batch import storage
from gscomplete.batch.ledger import Ledger, Row, read_ledger
from gscomplete.batch.local_workers import Done, run_local
from gscomplete.batch.machine import WorkerPlan
from gscomplete.batch.manifest import Item
from gscomplete.batch.on_ray import run_on_ray
from gscomplete.batch.work import Job, Task, died, do, input_signatures, is_whole, option_key
from gscomplete.errors import UserError
from gscomplete.util import jsonio
from gscomplete.util.folder_lock import FolderLock, lock_folder

STATE_FOLDER = ".batch"
LEDGER_FILE = "ledger.jsonl"
BATCH_FILE = "batch.json"
_SCHEMA = "gscomplete.batch"
_LOOKS = 32
"""Objects in a store that are looked at at a time."""
_COPY_LEDGER_S = 60.0
"""Time between copies of the ledger to a store."""


@dataclass(frozen=True, slots=True)
class Batch:
    """A planned batch: its objects and options, and the folders that it uses."""

    items: tuple[Item, ...]
    identity: dict[str, Any]
    """Options and weights, as JSON values: what decides results besides the input."""
    runs: str
    state: Path
    """Folder of this machine for ledger and unfinished work."""
    rows: dict[str, Row]
    """The ledger as it was."""
    to_do: tuple[Item, ...]
    """What is not finished by the ledger."""
    lock: FolderLock | None

    @property
    def failed(self) -> str:
        """Folder for the logs of what failed: path or URL."""
        return storage.join(self.runs, f"{STATE_FOLDER}/failed")


@dataclass(slots=True)
class Summary:
    """How many objects of a batch ended in which way."""

    before: int = 0
    """Objects that the ledger had as finished; no worker was given them."""
    counts: Counter[str] = field(default_factory=Counter)
    """The others, by status of the ledger."""
    worker_seconds: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    """Of workers, by status."""
    facts: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    """Sums of the numbers that the job tells of results, over those that workers did now."""
    failed: list[Row] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, row: Row) -> None:
        """Count an object that ended."""
        self.counts[row.status] += 1
        self.worker_seconds[row.status] += row.seconds
        for name, value in row.facts.items():
            if row.status == "finished" and isinstance(value, int | float):
                self.facts[name] += value
        if row.status == "failed":
            self.failed.append(row)


def open_batch(
    items: list[Item],
    identity: dict[str, Any],
    runs: str,
    *,
    scratch: Path | None = None,
    redo: bool = False,
) -> Batch:
    """Lock the folder of the results, and find what is to be done.

    Args:
        items: the objects.
        identity: options and weights, as JSON values.
        runs: folder of the results: path or URL.
        scratch: folder for unfinished work of results in a store; None = in the system's folder
            for temporary files.
        redo: do objects again that were made with other options or weights.

    Raises:
        UserError: the results cannot be written, another batch is at work there, or they were
            begun with other options and are not to be done again.
    """
    runs = storage.absolute(runs)
    state = _state_folder(runs, scratch)
    try:
        (state / "work").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{state}: cannot create the folder: {error.strerror}") from error
    lock = lock_folder(state)
    if storage.is_url(runs):
        _take_over(runs, state)
    _check_identity(state / BATCH_FILE, identity, redo=redo)
    jsonio.write_json(state / BATCH_FILE, {"schema": _SCHEMA, "version": 1, "identity": identity})
    if storage.is_url(runs):
        storage.put(state / BATCH_FILE, storage.join(runs, f"{STATE_FOLDER}/{BATCH_FILE}"))
    rows = read_ledger(state / LEDGER_FILE)
    listed = storage.list_folder(runs)
    results = set() if listed is None else listed[1]
    with ThreadPoolExecutor(_LOOKS) as pool:  # a store takes some milliseconds per request
        far = any(storage.is_url(path) for path in (runs, *(item.source for item in items)))
        finished = (pool.map if far else map)(
            lambda item: (
                item.id in results
                and _is_finished(rows.get(item.id), item, identity)
                and is_whole(storage.join(runs, item.id))
            ),
            items,
        )
        to_do = [item for item, yes in zip(items, finished, strict=True) if not yes]
    return Batch(tuple(items), identity, runs, state, rows, tuple(to_do), lock)


def run_batch(
    batch: Batch,
    job: Job,
    plan: WorkerPlan,
    *,
    ray: str | None = None,
    retries: int = 2,
    on_row: Callable[[Row], None] = lambda row: None,
    on_tick: Callable[[list[Task]], None] = lambda running: None,
) -> Summary:
    """Do what is to be done.

    Args:
        batch: from ``open_batch``.
        job: what to do with each object.
        plan: the workers.
        ray: address of a Ray cluster; None = processes of this machine.
        retries: how many further workers try an object whose worker died.
        on_row: called with the ledger row of each object that ended.
        on_tick: called several times a second with the objects that are being done.

    Raises:
        UserError: something that all objects need is wrong, or there is no memory for a worker.
    """
    started = time.perf_counter()
    summary = Summary(len(batch.items) - len(batch.to_do))
    tasks = (
        Task(
            job,
            item,
            option_key(batch.identity, item),
            batch.runs,
            str(batch.state / "work"),
            batch.failed,
        )
        for item in batch.to_do
    )
    ended: Generator[Done[Task, Row], None, None]
    if ray is None:
        ended = run_local(do, tasks, plan, retries=retries, on_tick=on_tick)
    else:
        ended = run_on_ray(do, tasks, plan, ray, retries=retries, on_tick=on_tick)
    ledger = Ledger(batch.state / LEDGER_FILE)
    copied = time.monotonic()
    try:
        with contextlib.closing(ended):
            for done in ended:
                row = (
                    died(done.task, done.attempts)
                    if done.result is None
                    else dataclasses.replace(done.result, attempts=done.attempts)
                )
                ledger.add(row)
                summary.add(row)
                on_row(row)
                if time.monotonic() - copied > _COPY_LEDGER_S:
                    _copy_ledger(batch)
                    copied = time.monotonic()
    finally:
        ledger.close()
        _copy_ledger(batch)
    summary.seconds = time.perf_counter() - started
    return summary


def _is_finished(row: Row | None, item: Item, identity: dict[str, Any]) -> bool:
    """Tell whether a ledger row says that an object is finished with this input and options."""
    if row is None or row.status == "failed" or row.key != option_key(identity, item):
        return False
    return row.inputs == input_signatures(item.source)


def _state_folder(runs: str, scratch: Path | None) -> Path:
    """Return the folder on this machine for the ledger and unfinished work."""
    if not storage.is_url(runs):
        return Path(runs) / STATE_FOLDER
    name = hashlib.sha256(runs.encode()).hexdigest()[:16]
    return (scratch or Path(tempfile.gettempdir())).absolute() / f"gscomplete-batch-{name}"


def _take_over(runs: str, state: Path) -> None:
    """Fetch a store's batch options and ledger where this machine has none, or shorter ones."""
    for name in (BATCH_FILE, LEDGER_FILE):
        path, here = storage.join(runs, f"{STATE_FOLDER}/{name}"), state / name
        there = storage.signature(path)
        if there is not None and (not here.is_file() or here.stat().st_size < there[0]):
            storage.fetch(path, state)


def _copy_ledger(batch: Batch) -> None:
    """Copy the ledger to the store that the results are in, if they are."""
    if storage.is_url(batch.runs):
        path = storage.join(batch.runs, f"{STATE_FOLDER}/{LEDGER_FILE}")
        storage.put(batch.state / LEDGER_FILE, path)


def _check_identity(path: Path, identity: dict[str, Any], *, redo: bool) -> None:
    """Check that the results in the folder were begun with the same options and weights.

    Raises:
        UserError: they were not, and ``redo`` is not set; the message says what differs.
    """
    if redo or not path.is_file():
        return
    stored = jsonio.read_json(path)
    before = stored.get("identity") if isinstance(stored, dict) else None
    if not isinstance(before, dict):
        raise UserError(f"{path}: identity: expected an object, found none")
    odd = [
        f"{name} {before.get(name)!r}, now {identity.get(name)!r}"
        for name in sorted(set(before) | set(identity))
        if before.get(name) != identity.get(name)
    ]
    if odd:
        raise UserError(
            f"{path.parent.parent}: its results were made with another {'; '.join(odd)}; choose "
            "another --out, or --redo to make them again"
        )
