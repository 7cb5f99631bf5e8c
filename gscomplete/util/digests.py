"""Digests of files, with which runs, weights and objects record what they were made from."""

from __future__ import annotations

import hashlib
from pathlib import Path

from gscomplete.errors import UserError


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal, however large it is.

    Raises:
        UserError: the file cannot be read.
    """
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise UserError(f"{path}: cannot read it ({error.strerror})") from error
