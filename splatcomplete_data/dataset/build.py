"""Build a dataset from a recipe: parallel, idempotent, resumable, and continuing after failures.

Conventions
-----------
* Every object is made by its command in a worker process that stands in the data folder, so that
  records name sources relative to it and are the same bytes wherever the data lie.
* ``OUT/.build/ID.json`` holds a fingerprint (entry, tool version, hashes of the sources and of
  the files that these name), a digest of the code (``code_digest``), and the hash of the
  resulting object.json. An object is left alone if all of these match and its files are intact, so
  a second build does nothing, and one that was killed resumes where it stopped. An object whose
  command was killed leaves only a temporary folder, which the next build removes.
* ``.build/ID.json`` also records that this build may replace ``OUT/ID``; it is written before the
  object. An ``OUT/ID`` without it was made by someone else and is left alone.
* Captures (training from photos) go to ``OUT/.build/captures``. Their fingerprint is written before
  they start: one that was killed resumes from its checkpoint, one that has changed starts again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import importlib
import io
import json
import logging
import os
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from gscomplete import __version__
from gscomplete.batch.local_workers import run_local
from gscomplete.batch.machine import WorkerPlan, usable_cores
from gscomplete.errors import UserError
from gscomplete.util import jsonio
from gscomplete.util.digests import sha256_of
from gscomplete.util.file_names import DATASET_FILE
from gscomplete.util.folder_lock import lock_folder
from splatcomplete_data.atomic_folder import forget_leftovers
from splatcomplete_data.dataset.code_digest import code_digest
from splatcomplete_data.dataset.recipe import Entry, Recipe
from splatcomplete_data.mesh.files.side_files import side_files
from splatcomplete_data.multiview.capture_folder import clear_capture
from splatcomplete_data.multiview.photos.capture import find_masks
from splatcomplete_data.named_files import Reach, require_allowed
from splatcomplete_data.objects import RECORD_FILE, read_record, record_of_file
from splatcomplete_data.pictures import allow_large_pictures

STATE_FOLDER = ".build"
CAPTURE_FOLDER = "captures"
INDEX_SCHEMA = "splatcomplete.dataset"

Status = Literal["built", "up to date", "failed"]
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one entry."""

    id: str
    status: Status
    message: str = ""
    """Why it failed, or what the command said."""


def build(
    recipe: Recipe,
    data: Path,
    out: Path,
    *,
    workers: int,
    only: tuple[str, ...] = (),
    allow_outside: Path | None = None,
    any_code: bool = False,
    on_outcome: Callable[[Outcome, int, int], None] = lambda outcome, done, total: None,
) -> list[Outcome]:
    """Build what is not up to date.

    Args:
        recipe: as read.
        data: folder that the recipe's paths are relative to.
        out: the dataset folder.
        workers: processes at a time.
        only: ids to build; none = all.
        allow_outside: folder below which files that the recipe names are read beside those below
            ``data``, and files that a mesh or capture names beside those below its own folder;
            None = ``data``.
        any_code: leave alone what other code made of the same entry and sources.
        on_outcome: called with each outcome, and how many of how many are done.

    Returns:
        The outcomes in the recipe's order; failures do not stop the others.

    Raises:
        UserError: a folder is missing or cannot be written, ``only`` names no object, or an entry
            names a file out of reach.
    """
    if not data.is_dir():
        raise UserError(f"{data}: --data: expected the folder of the sources, found none")
    unknown = sorted(set(only) - {entry.id for entry in recipe.objects})
    if unknown:
        raise UserError(f"--only: the recipe has no object {unknown[0]!r}")
    if workers < 1:
        raise UserError(f"--jobs: expected 1 or more, found {workers}")
    require_allowed(allow_outside)
    data, out = data.resolve(), out.resolve()
    reach = data if allow_outside is None else allow_outside.resolve()
    for entry in (*recipe.captures, *recipe.objects):
        entry.check_reach(data, reach)
    state = out / STATE_FOLDER
    try:
        (state / CAPTURE_FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{out}: cannot create the folder: {error.strerror}") from error
    lock = lock_folder(out)  # released when the build returns
    forget_leftovers(out, [entry.id for entry in recipe.objects])
    objects = [entry for entry in recipe.objects if not only or entry.id in only]
    needed = {name for entry in objects for name in entry.captures()}
    captures = [entry for entry in recipe.captures if entry.id in needed]
    total, done = len(captures) + len(objects), 0
    outcomes: dict[str, Outcome] = {}

    def tell(outcome: Outcome) -> None:
        nonlocal done
        done += 1
        on_outcome(outcome, done, total)

    failed: dict[str, str] = {}
    for outcome in _run_all(captures, data, out, reach, 1, tell, any_code):
        if outcome.status == "failed":
            failed[outcome.id] = outcome.message
    ready = []
    for entry in objects:
        broken = [name for name in entry.captures() if name in failed]
        if broken:
            why = f"its capture {broken[0]!r} failed"
            outcomes[entry.id] = Outcome(entry.id, "failed", why)
            tell(outcomes[entry.id])
        else:
            ready.append(entry)
    for outcome in _run_all(ready, data, out, reach, workers, tell, any_code):
        outcomes[outcome.id] = outcome
    write_index(recipe, out)
    del lock
    return [
        *(Outcome(name, "failed", text) for name, text in failed.items()),
        *(outcomes[entry.id] for entry in objects),
    ]


def write_index(recipe: Recipe, out: Path) -> None:
    """Write ``dataset.json``: what the dataset holds, in the recipe's order.

    Objects whose record is damaged are left out, with a note.
    """
    rows = []
    for entry in recipe.objects:
        folder = out / entry.id
        if not (folder / RECORD_FILE).is_file():
            continue
        try:
            record = read_record(folder)
        except UserError as error:
            _logger.warning("left out of %s until it is built again: %s", DATASET_FILE, error)
            continue
        rows.append(
            {
                "id": record.id,
                "subset": record.subset,
                "prompt": record.prompt,
                "object_sha256": sha256_of(folder / RECORD_FILE),
            }
        )
    content = {"schema": INDEX_SCHEMA, "version": 1, "name": recipe.name, "objects": rows}
    path = out / DATASET_FILE
    if not path.is_file() or path.read_text(encoding="utf-8") != jsonio.dumps(content):
        jsonio.write_json(path, content)


def fingerprint(entry: Entry, data: Path, out: Path, reach: Path | None = None) -> str:
    """Return the hash of everything that decides an entry's result.

    Folders count with the names and hashes of their files, meshes with those of the files they
    name (materials, textures, buffers; also that one is missing or out of ``reach``), captures with
    the hash of their splats, photos with the masks that are found beside them.
    """
    digest = hashlib.sha256()
    digest.update(json.dumps([__version__, entry.command, entry.values], sort_keys=True).encode())
    paths = list(entry.sources(data))
    if entry.is_capture and entry.values.get("masks") is None:
        found = [find_masks(path) for path in paths if path.is_dir()]
        paths += [masks for masks in found if masks is not None]
    for name in entry.captures():
        paths.append(out / STATE_FOLDER / CAPTURE_FOLDER / name / "splats.ply")
    if entry.command == "partial":  # what is beside the file of an object says which way is up
        paths += [path.with_name(RECORD_FILE) for path in paths if record_of_file(path)]
    for path in paths:
        inner = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
        for file in inner:
            line = f"{file.relative_to(path.parent)} {sha256_of(file)}\n"
            digest.update(line.encode(errors="surrogatepass"))
        near = Reach.of(path, reach)
        for name, file in side_files(path, near).items():
            content = sha256_of(file) if near.reads(file) else near.refusal(file) or "missing"
            digest.update(f"{name} {content}\n".encode(errors="surrogatepass"))
    return digest.hexdigest()


def is_up_to_date(
    entry: Entry, data: Path, out: Path, reach: Path | None = None, *, any_code: bool = False
) -> bool:
    """Tell whether an entry's folder is whole and made from the same things by the same code."""
    with contextlib.suppress(UserError, OSError, KeyError, TypeError):
        state = jsonio.read_json(out / STATE_FOLDER / f"{entry.id}.json")
        if not any_code and state["code"] != code_digest(entry.command):
            return False
        if state["fingerprint"] != fingerprint(entry, data, out, reach):
            return False
        if entry.is_capture:
            return bool(state["result"] == sha256_of(_folder(entry, out) / "splats.ply"))
        folder = out / entry.id
        if state["result"] != sha256_of(folder / RECORD_FILE):
            return False
        files = read_record(folder).files
        return all(sha256_of(folder / name) == file.sha256 for name, file in files.items())
    return False


def _folder(entry: Entry, out: Path) -> Path:
    """Return the folder that an entry writes."""
    return out / STATE_FOLDER / CAPTURE_FOLDER / entry.id if entry.is_capture else out / entry.id


def _run_all(
    entries: list[Entry],
    data: Path,
    out: Path,
    reach: Path | None,
    workers: int,
    tell: Callable[[Outcome], None],
    any_code: bool,
) -> list[Outcome]:
    """Make entries in worker processes; one that dies fails only what it was making."""
    outcomes: list[Outcome] = []

    def settle(outcome: Outcome) -> None:
        outcomes.append(outcome)
        tell(outcome)

    waiting = []
    for entry in entries:
        if is_up_to_date(entry, data, out, reach, any_code=any_code):
            settle(Outcome(entry.id, "up to date"))
        else:
            waiting.append(entry)
    count = max(1, min(workers, len(waiting)))
    plan = WorkerPlan(count, max(1, usable_cores() // count), memory_bytes=0)
    make = functools.partial(_make, out_text=str(out), reach=reach)
    enter = functools.partial(_enter, str(data))
    with contextlib.closing(run_local(make, waiting, plan, enter=enter, retries=1)) as ended:
        for done in ended:
            died = Outcome(
                done.task.id,
                "failed",
                "its process died twice, perhaps for lack of memory (--jobs 1 needs less)",
            )
            settle(done.result or died)
    return outcomes


def _enter(data: str) -> None:
    """Prepare a worker: make the data folder its current folder."""
    os.chdir(data)
    allow_large_pictures()
    logging.getLogger().setLevel(logging.ERROR)


def _make(entry: Entry, out_text: str, reach: Path | None = None) -> Outcome:
    """Make one entry in a worker; never raises."""
    out = Path(out_text)
    folder, state_file = _folder(entry, out), out / STATE_FOLDER / f"{entry.id}.json"
    said = io.StringIO()
    claimed = False
    try:
        print_, code = fingerprint(entry, Path(), out, reach), code_digest(entry.command)
        options = entry.options(folder, out / STATE_FOLDER / CAPTURE_FOLDER)
        if hasattr(options, "allow_outside"):
            options = dataclasses.replace(options, allow_outside=reach)
        if entry.is_capture:
            options = _begin_capture(state_file, print_, code, options)
        else:
            claimed = _claim(state_file, folder)
            options = dataclasses.replace(options, overwrite=True)
        _run_command(entry, options, said)
        result = "splats.ply" if entry.is_capture else RECORD_FILE
        jsonio.write_json(state_file, _state(print_, code, sha256_of(folder / result)))
    except UserError as error:
        return Outcome(entry.id, "failed", str(error))
    except OSError as error:
        return Outcome(entry.id, "failed", f"{error.filename}: {error.strerror}")
    except Exception as error:
        _logger.debug("%s", traceback.format_exc())
        return Outcome(entry.id, "failed", f"internal error: {type(error).__name__}: {error}")
    finally:
        if claimed and not (folder / RECORD_FILE).is_file():
            state_file.unlink(missing_ok=True)
    return Outcome(entry.id, "built", said.getvalue())


def _claim(state: Path, folder: Path) -> bool:
    """Record that a folder belongs to this build, before it is made; tell whether that is new.

    Raises:
        UserError: the folder holds something that this build did not make.
    """
    if state.is_file():
        return False
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        raise UserError(
            f"{folder}: expected nothing or a folder that this build made, found another one; "
            "move it away or give the entry another id"
        )
    jsonio.write_json(state, _state(None, None, None))
    return True


def _begin_capture(state: Path, print_: str, code: str, options: Any) -> Any:
    """Record what a capture is made from, and let it resume a capture of the same sources.

    A capture of other sources is removed at once. If it were kept until the new capture is set up,
    and that failed, the next build would resume the old one.

    Raises:
        UserError: the capture's folder holds what ``images`` did not write.
    """
    begun = None
    with contextlib.suppress(UserError, KeyError, TypeError):
        begun = jsonio.read_json(state)
        begun = begun["fingerprint"], begun["code"]
    goes_on = begun == (print_, code) and options.out.is_dir() and any(options.out.iterdir())
    if not goes_on:
        clear_capture(options.out)
    jsonio.write_json(state, _state(print_, code, None))
    return dataclasses.replace(options, resume=goes_on, overwrite=not goes_on)


def _state(print_: str | None, code: str | None, result: str | None) -> dict[str, str | None]:
    """Return what ``.build/ID.json`` holds; None = not yet known."""
    return {"fingerprint": print_, "code": code, "result": result}


def _run_command(entry: Entry, options: Any, said: io.StringIO) -> None:
    """Run the entry's command, catching what it prints."""
    module = importlib.import_module(f"splatcomplete_data.cli.{entry.command}")
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
        module.run(options)
