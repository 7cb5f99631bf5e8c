"""What a worker does with one object of a batch: check whether it is done, do it, publish it.

Conventions
-----------
* A run folder is made in the batch's work folder and becomes the result in one step, together with
  ``item.json``, which records the input, options and weights that it was made from. So a result is
  never incomplete, and never mistaken for one of other options.
* ``WORK/ID.json`` records the same for the unfinished folder ``WORK/ID`` and is written before it:
  an unfinished run is continued only with the input, options and weights that it was begun with.
* A result depends neither on which worker makes it nor on how many tries it takes: a worker that
  dies loses what it did since its last checkpoint, and the next worker goes on from there.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import shutil
import socket
import sys
import time
import traceback
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

from gscomplete.batch import storage
from gscomplete.batch.ledger import Row
from gscomplete.batch.manifest import Item
from gscomplete.errors import UserError
from gscomplete.util.atomic import forget_leftovers
from gscomplete.util.digests import sha256_of
from gscomplete.util.file_names import OBJECT_FILE, OUTPUT_FILE, PARTIAL_FILE, RUN_FILE, splat_stem
from gscomplete.util.jsonio import read_json, write_json

ITEM_FILE = "item.json"
"""In a result: what it was made of."""
_SCHEMA = "gscomplete.batch.item"


class Job(Protocol):
    """What a batch does with its objects; pickled to the workers."""

    def make(self, item: Item, source: Path, out: Path, *, resume: bool) -> dict[str, Any]:
        """Make an object's run folder.

        Args:
            item: the object.
            source: its splat file or object folder, on this machine.
            out: the run folder to create, or to go on with.
            resume: whether to go on with it.

        Returns:
            Facts of the result that go into the ledger.

        Raises:
            UserError: something about this object is wrong.
            SetupError: something that all objects need is wrong.
        """
        ...


class SetupError(UserError):
    """Something that all objects of a batch need is wrong: the batch ends."""


@dataclass(frozen=True, slots=True)
class Task:
    """One object, for a worker."""

    job: Job
    item: Item
    key: str
    """Digest of the options and weights that are asked for."""
    runs: str
    """Folder of the results: path or URL."""
    work: str
    """Folder on this machine for what is unfinished; on the file system of ``runs`` if that is a
    path."""
    failed: str
    """Folder for the logs of what failed: path or URL."""

    @property
    def result(self) -> str:
        """Return the folder of the object's result."""
        return storage.join(self.runs, self.item.id)


def option_key(identity: dict[str, Any], item: Item) -> str:
    """Return a digest of the batch's options and weights and the object's own options.

    Args:
        identity: of the batch, as JSON values.
        item: the object.
    """
    asked = json.dumps([identity, item.options], sort_keys=True)
    return hashlib.sha256(asked.encode()).hexdigest()[:32]


def input_files(source: str) -> tuple[str, ...]:
    """Return the files that an object is read from: its splats and its ``object.json``."""
    if _is_file(source):
        return source, storage.join(source.rpartition("/")[0], OBJECT_FILE)
    return storage.join(source, PARTIAL_FILE), storage.join(source, OBJECT_FILE)


def _is_file(source: str) -> bool:
    """Tell a splat file from an object folder by its name."""
    return splat_stem(source.rpartition("/")[2]) is not None


def input_signatures(source: str) -> list[Any]:
    """Return the signatures of an object's files, as JSON values."""
    found = (storage.signature(path) for path in input_files(source))
    return [None if each is None else list(each) for each in found]


def is_whole(result: str) -> bool:
    """Tell whether a result has its record and its splats: files can be lost or damaged later."""
    size, _ = storage.signature(storage.join(result, OUTPUT_FILE)) or (0, "")
    return size > 0 and _read_record(result, RUN_FILE) is not None


def do(task: Task) -> Row:
    """Do one object; an error of that object becomes a row, and only a SetupError is raised.

    Raises:
        SetupError: something that all objects need is wrong.
    """
    started = time.perf_counter()
    worker = f"{socket.gethostname()}:{os.getpid()}"
    said = io.StringIO()
    inputs: list[Any] = []
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            inputs = input_signatures(task.item.source)
            found, facts = _do(task)
    except SetupError:
        raise
    except Exception as error:
        text = _message(error)
        log = _write_log(task, f"{said.getvalue()}{_details(error)}{text}\n")
        return Row(
            task.item.id,
            "failed",
            task.key,
            inputs,
            round(time.perf_counter() - started, 3),
            worker,
            error=text,
            log=log,
            ended=_now(),
        )
    return Row(
        task.item.id,
        "found" if found else "finished",
        task.key,
        inputs,
        round(time.perf_counter() - started, 3),
        worker,
        facts=facts,
        ended=_now(),
    )


def died(task: Task, attempts: int) -> Row:
    """Return the row of an object during which every worker died that tried it."""
    text = f"{attempts} workers died on it, one after another (killed, or out of memory)"
    log = _write_log(task, text + "\n")
    return Row(
        task.item.id, "failed", task.key, attempts=attempts, error=text, log=log, ended=_now()
    )


def _do(task: Task) -> tuple[bool, dict[str, Any]]:
    """Do one object; return whether it was done already, and its facts for the ledger."""
    work = Path(task.work) / task.item.id
    copies, begun = (work.with_name(f"{work.name}.{kind}") for kind in ("input", "json"))
    forget_leftovers(begun.parent, [begun.name])  # of a worker that was killed
    source = _local_source(task.item.source, copies)
    inputs = {Path(path).name: sha256_of(local) for path, local in source.files.items()}
    record = {"schema": _SCHEMA, "version": 1, "inputs": inputs, "asked": task.key}
    result = _read_record(task.result, ITEM_FILE)
    same = result is not None and all(result.get(name) == value for name, value in record.items())
    if result is not None and same and is_whole(task.result):
        begun.unlink(missing_ok=True)
        shutil.rmtree(copies, ignore_errors=True)
        return True, result.get("facts", {})
    facts = _finished_facts(begun, work, record)
    if facts is None:
        facts = _make(task, source.path, work, begun, record)
        write_json(begun, record | {"facts": facts})
    write_json(work / ITEM_FILE, record | {"facts": facts})
    if storage.is_url(task.item.source):
        _name_source(work / RUN_FILE, task.item.source)
    storage.publish(work, task.result, ITEM_FILE)
    begun.unlink(missing_ok=True)
    if not storage.is_url(task.failed):
        Path(_log_path(task)).unlink(missing_ok=True)  # it failed before
    shutil.rmtree(copies, ignore_errors=True)
    return False, facts


@dataclass(frozen=True, slots=True)
class _Source:
    """An object's input on this machine."""

    path: Path
    files: dict[str, Path]


def _local_source(source: str, copies: Path) -> _Source:
    """Return those input files that exist, copied to this machine if they are in a store.

    Raises:
        UserError: there is none, or it cannot be read.
    """
    files = {
        path: storage.fetch(path, copies)
        for path in input_files(source)
        if storage.signature(path) is not None
    }
    if not files:
        raise UserError(f"{source}: expected a splat file or an object folder, found none")
    if not storage.is_url(source):
        return _Source(Path(source), files)
    main = input_files(source)[0]
    return _Source(files[main] if _is_file(source) and main in files else copies, files)


def _finished_facts(begun: Path, work: Path, record: dict[str, Any]) -> dict[str, Any] | None:
    """Return the facts of a run that is finished but not yet published; None = it is not."""
    found = _read(begun)
    if found is None or "facts" not in found or not work.is_dir():
        return None
    facts = found.pop("facts")
    return facts if found == record else None


def _make(
    task: Task, source: Path, work: Path, begun: Path, record: dict[str, Any]
) -> dict[str, Any]:
    """Make the run folder, or continue an unfinished one of the same input and options."""
    found = _read(begun)
    if found == record and (work / RUN_FILE).is_file():
        try:
            return task.job.make(task.item, source, work, resume=True)
        except SetupError:
            raise
        except UserError as error:
            sys.stderr.write(f"starting again: {error}\n")
    shutil.rmtree(work, ignore_errors=True)
    work.parent.mkdir(parents=True, exist_ok=True)
    write_json(begun, record)
    return task.job.make(task.item, source, work, resume=False)


def _read_record(result: str, name: str) -> dict[str, Any] | None:
    """Return one of a result's records; None where there is none, or something else."""
    text = storage.read_text(storage.join(result, name), errors="replace")
    try:
        record = json.loads(text or "null")
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None


def _read(path: Path) -> dict[str, Any] | None:
    """Return a JSON object of this machine; None where there is none."""
    try:
        found = read_json(path)
    except UserError:
        return None
    return found if isinstance(found, dict) else None


def _name_source(path: Path, source: str) -> None:
    """Write the input's path in the store, not that of this machine's copy, into ``run.json``."""
    content = read_json(path)
    content["input"]["path"] = input_files(source)[0]
    if content["input"].get("object") is not None:
        content["input"]["object"] = source.removesuffix("/" + PARTIAL_FILE)
    write_json(path, content)


def _message(error: Exception) -> str:
    """Return an error in one line."""
    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, MemoryError) or "can't allocate memory" in str(error):
        return "out of memory (--memory gives each worker more)"
    if isinstance(error, OSError):
        return f"{error.filename or 'input or output'}: {error.strerror or error}"
    return f"internal error: {type(error).__name__}: {error}"


def _details(error: Exception) -> str:
    """Return where an unexpected error happened."""
    return "" if isinstance(error, UserError) else "".join(traceback.format_exception(error))


def _write_log(task: Task, text: str) -> str:
    """Write a failed object's output to its log; return the log's path, "" if that fails."""
    path = _log_path(task)
    local = Path(task.work) / f"{task.item.id}.log"
    try:
        local.parent.mkdir(parents=True, exist_ok=True)
        local.write_text(text, encoding="utf-8", errors="backslashreplace")
        storage.put(local, path)
        local.unlink()
    except (OSError, UserError):
        return ""
    return path


def _log_path(task: Task) -> str:
    """Return where an object's log goes if it fails."""
    return storage.join(task.failed, f"{task.item.id}.log")


def _now() -> str:
    """Return date and time in UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")
