"""Write whole folders so that a reader, a crash or a full disk never meets half of one.

Conventions
-----------
* The files go into a temporary folder next to the destination, named ``.NAME.XXXX``, and are
  flushed to the disk; one rename then makes it the destination.
* A destination that is not empty is replaced only on request, and only if it contains the caller's
  marker (a file that all of the caller's folders have) or nothing but files that may be lost. No
  other folder is ever removed.
* It is replaced by exchanging the two names in one step where the system can (Linux); elsewhere
  the old folder is moved aside first.
* Files in a replaced folder that the caller did not write go on in the new one.
* Where something has taken the destination's name meanwhile, it stays, and the files are kept next
  to it, in ``NAME.XXXX``.
* ``forget_leftovers`` removes the temporary folders that killed processes left behind.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from gscomplete.errors import UserError

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2
_RANDOM_LETTERS = 8
"""Of the names that ``tempfile.mkdtemp`` makes."""


@contextlib.contextmanager
def atomic_folder(
    folder: Path,
    *,
    marker: str,
    spare: Collection[str] = (),
    overwrite: bool = False,
    written: Callable[[Path], Collection[str]] | None = None,
) -> Iterator[Path]:
    """Yield an empty temporary folder that becomes ``folder`` when the block succeeds.

    When the block raises, the temporary folder is removed and the destination is untouched.

    Args:
        folder: the folder to create; its parents are created too.
        marker: name of a file that tells the caller's folders from others.
        spare: names of files that may be lost; a folder of nothing else needs no marker.
        overwrite: replace a folder that exists and holds something, if it is the caller's.
        written: tells the names in such a folder that the caller wrote; None = all of them.

    Raises:
        UserError: the folder exists without ``overwrite`` or is not the caller's, is a file, or
            cannot be written; also if this is found only when the block has succeeded.
    """
    check_destination(folder, marker=marker, spare=spare, overwrite=overwrite)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=_prefix(folder.name)))
    except OSError as error:
        raise UserError(f"{folder}: cannot create the folder: {error.strerror}") from error
    try:
        yield temporary
        _flush(temporary)
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o777 & ~mask)
        try:
            check_destination(folder, marker=marker, spare=spare, overwrite=overwrite)
        except UserError as error:
            kept = folder.with_name(f"{folder.name}{temporary.suffix}")
            os.rename(temporary, kept)
            raise UserError(f"{error}; what was to be written is in {kept}") from error
        if written is not None and folder.is_dir():
            _keep_others(folder, temporary, {marker, *spare, *written(folder)})
        _take_name(temporary, folder, overwrite=overwrite)
    except OSError as error:
        if error.filename is not None and not str(error.filename).startswith(str(folder.parent)):
            raise  # the block failed over some other file
        raise UserError(f"{folder}: cannot write: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def check_destination(
    folder: Path, *, marker: str, spare: Collection[str] = (), overwrite: bool
) -> None:
    """Refuse a destination that holds something, before any work is done for it.

    Arguments are those of ``atomic_folder``.

    Raises:
        UserError: it exists without ``overwrite`` or is not the caller's, is a file, or is the
            current folder, which cannot be exchanged.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise UserError(f"{folder}: expected a folder or nothing, found a file or link")
    if folder.resolve() == Path.cwd():
        raise UserError(f"{folder}: expected a folder to create, found the current one")
    held = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    if not held:
        return
    if not (folder / marker).is_file() and not set(held) <= set(spare):
        raise UserError(
            f"{folder}: expected nothing, an empty folder, or one with {marker} to be replaced; "
            f"found other things (such as {next(name for name in held if name not in spare)}); "
            "choose another --out"
        )
    if not overwrite:
        raise UserError(
            f"{folder}: the folder exists and is not empty; choose another --out, or replace it "
            "with --overwrite"
        )


def forget_leftovers(folder: Path, names: Collection[str]) -> int:
    """Remove the temporary folders of killed writers; return how many.

    Call it only while nothing else writes into ``folder``.

    Args:
        folder: where the writers wrote.
        names: of the folders that they were to write; nothing else is removed.
    """
    prefixes = {_prefix(name) for name in names}
    removed = 0
    for child in list(folder.iterdir()) if folder.is_dir() else []:
        if child.name[:-_RANDOM_LETTERS] in prefixes and child.is_dir() and not child.is_symlink():
            shutil.rmtree(child, ignore_errors=True)
            removed += 1
    return removed


def _prefix(name: str) -> str:
    """Return the prefix of the names of a folder's temporary folders."""
    return f".{name[:32]}."


def _keep_others(folder: Path, temporary: Path, written: set[str]) -> None:
    """Copy what someone else put into a folder to the one that takes its place."""
    for path in folder.iterdir():
        kept = temporary / path.name
        if path.name in written or kept.exists():
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.copytree(path, kept, symlinks=True)
        else:
            shutil.copy2(path, kept, follow_symlinks=False)


def _take_name(temporary: Path, folder: Path, *, overwrite: bool) -> None:
    """Rename ``temporary`` to ``folder``; an earlier ``folder`` takes its place or is removed."""
    try:
        os.rename(temporary, folder)  # where there is nothing, or an empty folder
    except OSError as error:
        if not overwrite or error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
        if not _exchange(temporary, folder):
            aside = Path(tempfile.mkdtemp(dir=folder.parent, prefix=_prefix(folder.name)))
            os.rename(folder, aside)
            os.rename(temporary, folder)
            shutil.rmtree(aside, ignore_errors=True)
    with contextlib.suppress(OSError):
        _flush_one(folder.parent)


def _exchange(first: Path, second: Path) -> bool:
    """Exchange two names in one step; False where the system cannot."""
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if rename is None:
        return False
    names = os.fsencode(first), os.fsencode(second)
    return rename(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _RENAME_EXCHANGE) == 0


def _flush(folder: Path) -> None:
    """Force the files of a folder, and the folder, to the disk."""
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            _flush_one(path)
    _flush_one(folder)


def _flush_one(path: Path) -> None:
    """Force one file's bytes, or one folder's entries, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
