"""What became of a batch's objects: one JSON line is appended each time an object ends.

Conventions
-----------
* The last line of an object counts. A line that was cut off by a kill, or is damaged otherwise, is
  ignored; the object's own folder then says whether the object is finished.
* ``finished``: completed by this run of the batch. ``found``: an earlier run had completed it from
  the same input, options and weights. ``failed``: ``error`` is the reason, ``log`` names a file
  with details.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

Status = Literal["finished", "found", "failed"]


@dataclass(frozen=True, slots=True)
class Row:
    """How an object ended."""

    id: str
    status: Status
    key: str = ""
    """Digest of options and weights that it was asked for with."""
    inputs: list[Any] = field(default_factory=list)
    """Signatures of the input's files as they were then."""
    seconds: float = 0.0
    """From its start on a worker to its end there."""
    worker: str = ""
    """Machine and process."""
    attempts: int = 1
    """How many workers it was given to: all but the last one died over it."""
    error: str = ""
    log: str = ""
    facts: dict[str, Any] = field(default_factory=dict)
    """What the job tells of the result."""
    ended: str = ""
    """Date and time, UTC."""


def read_ledger(path: Path) -> dict[str, Row]:
    """Return the last row of each object; an empty result where there is no file yet."""
    rows: dict[str, Row] = {}
    names = {item.name for item in dataclasses.fields(Row)}
    if not path.is_file():
        return rows
    with path.open("rb") as lines:
        for line in lines:
            try:
                values = json.loads(line, parse_constant=_finite, parse_float=_finite)
                rows[values["id"]] = Row(**{k: v for k, v in values.items() if k in names})
            except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
                continue
    return rows


def _finite(text: str) -> float:
    """Read a number.

    Raises:
        ValueError: it is NaN or infinite, which no ledger holds.
    """
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"expected a finite number, found {text}")
    return value


class Ledger:
    """The file, open for more rows."""

    def __init__(self, path: Path) -> None:
        """Open a ledger for appending; a last line that was cut off gets its line end."""
        self.path = path
        self._handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        size = os.fstat(self._handle).st_size
        if size and os.pread(self._handle, 1, size - 1) != b"\n":
            os.write(self._handle, b"\n")

    def add(self, row: Row) -> None:
        """Append a row; other processes see the whole row or nothing of it."""
        os.write(self._handle, (json.dumps(dataclasses.asdict(row)) + "\n").encode())

    def close(self) -> None:
        """Flush the rows to the disk."""
        os.fsync(self._handle)
        os.close(self._handle)
