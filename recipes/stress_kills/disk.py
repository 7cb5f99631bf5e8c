"""A small disk that can be filled: any file system of at most 1 GB, such as a tmpfs."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscomplete.errors import UserError

_LARGEST = 2**30
_MOST_LEFT = 2**19
"""A nearly full disk has between nothing and this many bytes left: less than an object takes."""
_BLOCK = bytes(2**16)


@dataclass(frozen=True)
class SmallDisk:
    """A folder on a small file system."""

    folder: Path

    def __post_init__(self) -> None:
        """Check that it is small.

        Raises:
            UserError: it is larger than 1 GB, or no folder.
        """
        if not self.folder.is_dir():
            raise UserError(f"--disk: {self.folder}: expected a folder on a small file system")
        status = os.statvfs(self.folder)
        size = status.f_blocks * status.f_frsize
        if size > _LARGEST:
            raise UserError(
                f"--disk: {self.folder}: expected a file system of at most 1 GB, as it is filled; "
                f"found one of {size / 2**30:.0f} GB"
            )

    @contextlib.contextmanager
    def nearly_full(self, rng: np.random.Generator) -> Iterator[None]:
        """Leave only some bytes free in the block."""
        left = int(rng.integers(_MOST_LEFT))
        ballast = self.folder / "ballast"
        try:
            with ballast.open("wb") as file, contextlib.suppress(_Full):
                while True:
                    status = os.statvfs(self.folder)
                    free = status.f_bavail * status.f_frsize
                    if free <= left:
                        break
                    _write(file.fileno(), _BLOCK[: min(len(_BLOCK), free - left)])
            yield
        finally:
            ballast.unlink(missing_ok=True)


class _Full(Exception):
    """Nothing more can be written."""


def _write(handle: int, data: bytes) -> None:
    try:
        os.write(handle, data)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise _Full from error
        raise
