"""The folder that a reconstruction writes: made, resumed, or given to a new run.

Conventions
-----------
* A new run that replaces an old capture first moves it into ``.previous``. The old capture is put
  back if the new run fails before it is set up, for whatever reason, and removed afterwards.
* Files are moved one by one, but the state of a move changes by a single rename, so the next run
  can interpret what a killed process left. ``.previous`` holds a complete old capture, and the rest
  of the folder belongs to the new run. ``.previous.moving`` holds a part of the old capture, and
  the rest of the folder is its other part. ``.previous.dropped`` is to be removed.
* A folder with anything else in it is never cleared.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

from gscomplete.errors import UserError
from gscomplete.fitting.step_loop import CHECKPOINTS, LOG_FILE
from gscomplete.util.atomic import forget_leftovers
from gscomplete.util.folder_lock import FolderLock, lock_folder

CAPTURE_FILE = "capture.json"
SPLATS_FILE = "splats.ply"
PREVIEW_FILE = "preview.png"
SFM_FOLDER = "sfm"
PREVIOUS = ".previous"
_MOVING = f"{PREVIOUS}.moving"
_DROPPED = f"{PREVIOUS}.dropped"
_WRITTEN = (CAPTURE_FILE, SPLATS_FILE, PREVIEW_FILE, LOG_FILE, CHECKPOINTS, SFM_FOLDER)
_OURS = (*_WRITTEN, PREVIOUS, _MOVING, _DROPPED)


@contextlib.contextmanager
def capture_folder(out: Path, *, resume: bool, overwrite: bool) -> Iterator[FolderLock | None]:
    """Prepare the folder for the block that sets up a run, and yield the folder's lock.

    If the block fails, an old capture that was to be replaced is put back. Leftovers of a run that
    was killed before it wrote its first file are ignored.

    Args:
        out: the folder; created if need be.
        resume: whether the block continues with what is there.
        overwrite: whether the block starts anew, whatever is there.

    Raises:
        UserError: it holds something and neither is asked for, there is nothing to resume, it
            holds files that are not ours, or another process works in it.
    """
    lock = None
    if out.is_dir():
        lock = lock_folder(out)
        forget_leftovers(out, _WRITTEN)
    if out.exists() and not out.is_dir():
        raise UserError(f"{out}: --out: expected a folder to create, found a file")
    if out.exists() and not (resume or overwrite) and any(out.iterdir()):
        raise UserError(
            f"{out}: the output folder exists and is not empty; choose another --out, continue "
            "with --resume, or start again with --overwrite"
        )
    if overwrite and not resume:
        _require_ours(out)
    _put_back(out)
    if resume:
        if not any((out / name).exists() for name in (CAPTURE_FILE, SFM_FOLDER)):
            raise UserError(
                f"{out}: nothing to resume: there is no {CAPTURE_FILE}; start without --resume"
            )
        yield lock
        return
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = lock_folder(out)
    except OSError as error:
        raise UserError(f"{out}: cannot create the output folder: {error.strerror}") from error
    try:
        _set_aside(out)
        yield lock
    except BaseException:
        _put_back(out)
        raise
    _drop(out)


def clear_capture(out: Path) -> None:
    """Remove a capture, finished or not; a folder that is not there is clear.

    Raises:
        UserError: the folder holds files that are not ours.
    """
    if out.is_dir():
        forget_leftovers(out, _WRITTEN)
        _require_ours(out)
        for path in out.iterdir():
            _remove(path)


def _require_ours(out: Path) -> None:
    """Refuse a folder that holds anything that no reconstruction wrote.

    Raises:
        UserError: it does.
    """
    names = [path.name for path in out.iterdir()] if out.is_dir() else []
    foreign = sorted(set(names) - set(_OURS))
    if foreign:
        raise UserError(f"{out}: --overwrite: holds {foreign[0]}, which this command did not write")


def _set_aside(out: Path) -> None:
    """Put an old capture, if there is one, into ``.previous``."""
    names = [name for name in _WRITTEN if (out / name).exists()]
    if names:
        (out / _MOVING).mkdir()
        for name in names:
            (out / name).rename(out / _MOVING / name)
        (out / _MOVING).rename(out / PREVIOUS)


def _put_back(out: Path) -> None:
    """Put an old capture, if one lies aside, in place of what a new run has made."""
    if (out / PREVIOUS).is_dir():
        for name in _WRITTEN:
            _remove(out / name)
        (out / PREVIOUS).rename(out / _MOVING)
    if (out / _MOVING).is_dir():
        for path in list((out / _MOVING).iterdir()):
            path.rename(out / path.name)
        (out / _MOVING).rmdir()
    _remove(out / _DROPPED)


def _drop(out: Path) -> None:
    """Remove the old capture, if one lies aside."""
    if (out / PREVIOUS).is_dir():
        (out / PREVIOUS).rename(out / _DROPPED)
        _remove(out / _DROPPED)


def _remove(path: Path) -> None:
    """Remove a file, link or folder; nothing there is well."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
