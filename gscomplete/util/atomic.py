"""Write files so that a reader, a crash or a full disk never meets half of one.

Conventions
-----------
* The new content goes to a temporary file in the destination's own folder (a rename is atomic
  only within one file system), is flushed to the disk, and then takes the destination's name.
* Whatever goes wrong before that rename leaves an existing destination as it was.
"""

from __future__ import annotations

import contextlib
import errno
import glob
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from gscomplete.errors import UserError

_OS_REASONS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EACCES: "no permission to write here",
    errno.EPERM: "no permission to write here",
    errno.EROFS: "the file system is read-only",
    errno.ENOENT: "the folder does not exist",
    errno.ENOTDIR: "a part of the path is a file, not a folder",
    errno.EISDIR: "the destination is a folder",
    errno.ELOOP: "it is a link that leads back to itself",
    errno.ENAMETOOLONG: "the file name is too long",
    errno.EFBIG: "the file would be too large for this file system",
}


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path next to ``path`` that becomes ``path`` when the block succeeds.

    The caller writes the temporary file by any means and closes it before leaving the block. An
    existing destination keeps its permissions. When the block raises, the temporary file is
    removed and the destination is untouched.

    Args:
        path: the file to create or replace. Its folder must exist.

    Raises:
        UserError: the folder cannot be written, the disk is full, or ``path`` is a folder.
    """
    destination = Path(path)
    temporary: Path | None = None
    try:
        if destination.is_symlink():
            # replace the file behind a link, not the link
            destination = Path(os.path.realpath(destination))
            if destination.is_symlink():
                raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
        if destination.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        handle, name = tempfile.mkstemp(
            dir=destination.parent, prefix=f".{destination.name[:32]}.", suffix=destination.suffix
        )
        os.close(handle)
        temporary = Path(name)
        temporary.chmod(_mode_for(destination))
        yield temporary
        _flush_to_disk(temporary)
        os.replace(temporary, destination)
        temporary = None
        _flush_to_disk(destination.parent)
    except OSError as error:
        reason = _OS_REASONS.get(error.errno or 0)
        ours = {None, str(temporary), str(destination), str(destination.parent)}
        if reason is None or (error.filename not in ours and temporary is not None):
            raise  # the block failed over some other file
        raise UserError(f"{path}: cannot write: {reason} ({destination.parent})") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def forget_leftovers(folder: Path, names: Iterable[str]) -> None:
    """Remove the temporary files that killed writers of some files left behind.

    Call it only while nothing else writes into the folder.

    Args:
        folder: where they wrote.
        names: of the files that they were to write; nothing else is removed.
    """
    for name in names:
        suffix = Path(name).suffix
        for path in folder.glob(f".{glob.escape(name[:32])}.????????{glob.escape(suffix)}"):
            if path.is_file():
                path.unlink(missing_ok=True)


def _mode_for(destination: Path) -> int:
    """Permission bits of the file being replaced, or those a plain ``open`` would give."""
    with contextlib.suppress(FileNotFoundError):
        return destination.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


def _flush_to_disk(path: Path) -> None:
    """Force a file's bytes, or a folder's entries, to the disk."""
    flags = os.O_RDONLY | getattr(os, "O_DIRECTORY", 0) if path.is_dir() else os.O_RDWR
    try:
        handle = os.open(path, flags)
    except PermissionError:
        if path.is_dir():
            return  # a writable folder that may not be listed: nothing more can be done
        raise
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
