"""One process at a time works in a folder.

Conventions
-----------
* The lock is one of the operating system on the folder itself: it needs no lock file, and it ends
  with the process, for whatever reason that ends. Within one process a folder's lock is shared.
* Where the file or operating system has no such locks, folders are used without one.
"""

from __future__ import annotations

import contextlib
import os
import weakref
from collections.abc import Iterable
from pathlib import Path

from gscomplete.errors import UserError
from gscomplete.util.atomic import forget_leftovers

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None  # type: ignore[assignment]

_NOT_EMPTY = (
    "{}: the output folder exists and is not empty; choose another --out, or continue the run in "
    "it with --resume"
)


class FolderLock:
    """A folder that belongs to this process as long as the object lives."""

    def __init__(self, handle: int) -> None:
        """Keep a locked handle."""
        self._handle = handle

    def __del__(self) -> None:
        """Unlock the folder."""
        with contextlib.suppress(OSError):
            os.close(self._handle)


_held: weakref.WeakValueDictionary[tuple[int, int], FolderLock] = weakref.WeakValueDictionary()
"""By device and number of the folder."""


def lock_folder(folder: Path) -> FolderLock | None:
    """Lock a folder that exists.

    Returns:
        The lock, to be kept as long as the folder is worked in; None where there are no locks.

    Raises:
        UserError: another process works in it.
    """
    if fcntl is None:
        return None
    handle = os.open(folder, os.O_RDONLY)
    status = os.fstat(handle)
    key = status.st_dev, status.st_ino
    held = _held.get(key)
    if held is not None:
        os.close(handle)
        return held
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(handle)
        raise UserError(
            f"{folder}: another process is at work in this folder; wait for it, end it, or choose "
            "another --out"
        ) from error
    except OSError:
        os.close(handle)
        return None
    lock = FolderLock(handle)
    _held[key] = lock
    return lock


def create_folder(out: Path, names: Iterable[str]) -> FolderLock | None:
    """Create an output folder and lock it.

    Args:
        out: the folder; it may already exist if it is empty.
        names: of the files that are to be written; temporary files of these names, left by a
            process that was killed before it finished its first file, do not count as content.

    Raises:
        UserError: it exists with something in it, or cannot be created.
    """
    require_free(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = lock_folder(out)
        forget_leftovers(out, names)
        is_empty = not any(out.iterdir())
    except OSError as error:
        raise UserError(f"{out}: cannot create the output folder: {error.strerror}") from error
    if not is_empty:
        raise UserError(_NOT_EMPTY.format(out))
    return lock


def require_free(out: Path) -> None:
    """Check, before any work for it is done, that an output folder can be created.

    Hidden files are left to :func:`create_folder`: a writer that was killed may have left them.

    Raises:
        UserError: it exists with something in it, or is a file.
    """
    if out.exists() and not out.is_dir():
        raise UserError(f"{out}: --out: expected a folder to create, found a file")
    if out.is_dir() and any(not path.name.startswith(".") for path in out.iterdir()):
        raise UserError(_NOT_EMPTY.format(out))
