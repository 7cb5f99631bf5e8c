"""Files that other files name (textures, buffers, photos, masks): which of them may be read.

Conventions
-----------
* A file that came from elsewhere may name any file of the machine. What it names is read only
  below its own folder, links followed, and below a folder that the user names
  (``--allow-outside``).
* Only regular files are read: a device has no end, a pipe may never begin.
"""

from __future__ import annotations

import stat
from dataclasses import dataclass
from pathlib import Path

from gscomplete.errors import UserError

MAX_FILE_BYTES = 2**31
"""Larger files are not read where a mesh names them."""


def require_allowed(folder: Path | None) -> None:
    """Refuse what allows no file: a further folder to read from that is none; None passes.

    Raises:
        UserError: there is no such folder.
    """
    if folder is not None and not folder.is_dir():
        found = "a file" if folder.exists() else "none"
        raise UserError(f"--allow-outside {folder}: expected a folder, found {found}")


@dataclass(frozen=True, slots=True)
class Reach:
    """The folders below which the files that one file names are read."""

    folders: tuple[Path, ...]  # absolute, links followed

    @staticmethod
    def of(holder: Path, allowed: Path | None = None) -> Reach:
        """Return what ``holder`` may name: its folder's files, and those of ``allowed``.

        Raises:
            UserError: ``allowed`` is no folder.
        """
        require_allowed(allowed)
        folders = (holder.parent, *((allowed,) if allowed is not None else ()))
        return Reach(tuple(folder.resolve() for folder in folders))

    def refusal(self, file: Path) -> str | None:
        """Say why a file is not read; None = it is, or there is no such file."""
        try:
            target = file.resolve()
            if not any(target.is_relative_to(folder) for folder in self.folders):
                return (
                    f"lies outside {self.folders[0]} and is not read (to read it: "
                    f"--allow-outside {target.parent})"
                )
            status = target.stat()
        except FileNotFoundError:
            return None
        except (OSError, ValueError, RuntimeError) as error:  # too long, null bytes, circular links
            return f"cannot be found ({error})"
        if stat.S_ISDIR(status.st_mode):
            return "is a folder, not a file"
        if not stat.S_ISREG(status.st_mode):
            return "is a device or pipe and is not read"
        if status.st_size > MAX_FILE_BYTES:
            return f"is larger than {MAX_FILE_BYTES / 2**30:g} GiB and is not read"
        return None

    def reads(self, file: Path) -> bool:
        """Tell whether a file is there and may be read."""
        return self.refusal(file) is None and file.is_file()
