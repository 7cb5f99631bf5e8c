"""How much a compressed file may unpack to.

Conventions
-----------
* The size that a file's header states is checked before memory is reserved, and the actual bytes
  are counted while it is unpacked, so that a small file cannot fill the memory.
* The bound is proportional to the file's size: real data compress to about a tenth, constant
  pictures to a hundredth.
"""

from __future__ import annotations

from pathlib import Path

from gscomplete.errors import UserError

MAX_DECODED_BYTES = 2**31
"""No compressed file unpacks to more."""
FREE_BYTES = 2**28
"""Every compressed file may unpack to this many bytes..."""
MOST_PER_BYTE = 200
"""... and to this many more for each of its own."""


def most_decoded_bytes(path: Path) -> int:
    """Return how many bytes a compressed file may unpack to.

    Raises:
        OSError: it is not there.
    """
    return min(MAX_DECODED_BYTES, FREE_BYTES + MOST_PER_BYTE * path.stat().st_size)


def check_decoded_bytes(path: Path, decoded_bytes: int, what: str) -> None:
    """Check how much a compressed file says it holds.

    Args:
        path: the file.
        decoded_bytes: what it unpacks to.
        what: the part of the file, for the message.

    Raises:
        UserError: it is too much for a file of its size.
        OSError: it is not there.
    """
    most = most_decoded_bytes(path)
    if decoded_bytes > most:
        raise UserError(
            f"{path}: {what}: expected at most {most / 2**20:,.0f} MiB from a file of its size, "
            f"found {decoded_bytes / 2**20:,.0f} MiB (a damaged header, or a bomb)"
        )
