"""Scans as rows of text: XYZ, PTS, ASC and CSV files.

Conventions
-----------
* Numbers stand between blanks, tabs, commas or semicolons; with semicolons a comma is a decimal
  point. Lines that start with ``#`` or ``/`` are comments.
* A line above the rows that has a name for every column, ``x``, ``y`` and ``z`` among them, is the
  header, with ``#`` or ``//`` in front or without: its names say what the columns are.
* Without a header the first three columns are the point. Three adjacent columns of unit length are
  a normal. Three other adjacent columns are the colour if they hold whole numbers up to 255, or
  else up to 65535, or else numbers from 0 to 1. If several triples fit, the last is taken, because
  PTS files have the intensity before the colour. In rows of 6 or 7 columns the last three are the
  colour unless they hold negative numbers.
* A note tells the user which columns became the colour.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float64Array
from splatcomplete_data.scan.cloud import NO_COLOR, PointCloud, grey_colors, unit_colors

_COLOR_NAMES = (("r", "g", "b"), ("red", "green", "blue"), ("rf", "gf", "bf"))
_COLOR_PREFIX = re.compile(r"^(colou?r|diffuse|rgb|scalar)_")
_COMMENT = ("#", "/")
_MOST_HEADER_LINES = 2
"""A file may begin with its number of points and a header; with more lines that are neither rows
nor comments, it is not a scan."""
_UNIT_LENGTH_OFF = 0.02
"""A normal's length is this close to 1: two decimals of every coordinate leave 0.01."""
_SHARE_OF_NORMALS = 0.99
_BYTE, _WORD = 255, 65535


@dataclass(frozen=True, slots=True)
class _Columns:
    """The columns of a table that hold positions and colours."""

    point: tuple[int, ...]
    color: tuple[int, ...] | None
    note: str


def read_text_scan(path: Path) -> tuple[PointCloud, tuple[str, ...]]:
    """Read rows of points (module conventions), and a note on their colour.

    Points that are not finite are kept.

    Raises:
        UserError: there are no rows; or they differ in length, have fewer than three columns, or
            hold words that are not numbers.
    """
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    numbered = enumerate(map(str.strip, text.splitlines()), start=1)
    lines = [(number, line) for number, line in numbered if line]
    first = next((i for i, (_, line) in enumerate(lines) if _is_row(line)), len(lines))
    heads = [line for _, line in lines[:first]]
    if sum(not line.startswith(_COMMENT) for line in heads) > _MOST_HEADER_LINES:
        raise UserError(
            f"{path}: expected rows of x y z [r g b], found {heads[0][:40]!r} before the first row"
        )
    rows = {
        number: words
        for number, line in lines[first:]
        if line[0] not in _COMMENT and (words := _words(line))
    }
    if not rows:
        raise UserError(f"{path}: expected rows of x y z [r g b], found none")
    table = _numbers(path, rows)
    columns = _columns(heads, table)
    points = table[:, columns.point]
    if columns.color is None:
        return PointCloud(points, grey_colors(len(points))), (columns.note,)
    return PointCloud(points, unit_colors(table[:, columns.color])), (columns.note,)


def _numbers(path: Path, rows: dict[int, list[str]]) -> Float64Array:  # [N, C]
    """Turn the words of rows into numbers.

    Args:
        path: the file.
        rows: words by line number, the first row of numbers first.

    Raises:
        UserError: a row has another length than the first, or a word is no number.
    """
    width = len(next(iter(rows.values())))
    for number, words in rows.items():
        if len(words) != width or width < 3:
            found = f"{width} and {len(words)}" if len(words) != width else f"{width}"
            raise UserError(
                f"{path}:{number}: expected rows of equal length, 3 numbers or more; found {found}"
            )
    try:
        return np.array(list(rows.values()), np.float64)
    except ValueError as error:
        for number, words in rows.items():
            if any(not _is_number(word) for word in words):
                found = " ".join(words)[:40]
                raise UserError(f"{path}:{number}: expected numbers, found {found!r}") from error
        raise


def _columns(heads: list[str], table: Float64Array) -> _Columns:
    """Tell the columns apart, by the header or else by their numbers."""
    width = table.shape[1]
    headers = [names for names in map(_names, heads) if {"x", "y", "z"} <= set(names)]
    for names in headers:
        if len(names) == width:
            return _named(names)
    found = _guessed(table)
    if not headers:
        return found
    unused = f"the header is not used: it names {len(headers[0])} columns, rows have {width}"
    return _Columns(found.point, found.color, f"{found.note} ({unused})")


def _named(names: list[str]) -> _Columns:
    """Find the columns by their names."""
    point = tuple(names.index(axis) for axis in "xyz")
    plain = [_COLOR_PREFIX.sub("", name) for name in names]
    for wanted in _COLOR_NAMES:
        if set(wanted) <= set(plain):
            color = tuple(plain.index(name) for name in wanted)
            shown = ", ".join(str(column + 1) for column in color)
            return _Columns(
                point, color, f"colour from columns {shown}, by their names in the header"
            )
    return _Columns(point, None, f"{NO_COLOR} (the header names {', '.join(names)})")


def _guessed(table: Float64Array) -> _Columns:
    """Tell by the numbers which columns are colours (module conventions)."""
    point = (0, 1, 2)
    width = table.shape[1]
    if width < 6:
        return _Columns(point, None, NO_COLOR)
    starts = list(range(3, width - 2))
    normal = next((start for start in starts if _are_normals(table[:, start : start + 3])), None)
    aside = ""
    if normal is not None:
        aside = f"; columns {normal + 1} to {normal + 3} taken for normals (unit length)"
        starts = [start for start in starts if abs(start - normal) >= 3]
    kinds = {start: _kind(table[:, start : start + 3]) for start in starts}
    start = min(reversed(starts), key=lambda start: kinds[start], default=None)
    is_last = width <= 7 and start == width - 3
    if start is None or kinds[start] > (_NOT_NEGATIVE if is_last else _NOT_NEGATIVE - 1):
        return _Columns(point, None, f"{NO_COLOR}{aside}")
    note = f"colour guessed from columns {start + 1} to {start + 3} ({_KINDS[kinds[start]]}){aside}"
    return _Columns(
        point,
        (start, start + 1, start + 2),
        f"{note}; a header line with column names makes it certain",
    )


def _are_normals(values: Float64Array) -> bool:  # [N, 3]
    """Tell whether rows have unit length; some may be zero, written where no normal was known."""
    length = np.linalg.norm(values[np.isfinite(values).all(axis=1)], axis=1)
    length = length[length > 0]
    is_unit = np.abs(length - 1) < _UNIT_LENGTH_OFF
    return len(length) > 0 and bool(is_unit.mean() >= _SHARE_OF_NORMALS)


_KINDS = (
    "whole numbers up to 255",
    "whole numbers up to 65535",
    "numbers from 0 to 1",
    "the last three, not negative",
)
"""Value ranges that colours may have, the likeliest first."""
_NOT_NEGATIVE = 3
"""Index of the last of them. So weak a condition counts only for rows that usually end in a
colour."""


def _kind(values: Float64Array) -> int:  # [N, 3]
    """Return the index in ``_KINDS`` of three columns' range; ``len(_KINDS)`` if none fits."""
    numbers = values[np.isfinite(values)]
    if numbers.size == 0 or (numbers < 0).any():
        return len(_KINDS)
    largest = numbers.max(initial=0.0)
    if largest <= _WORD and bool((numbers == np.floor(numbers)).all()):
        return 0 if largest <= _BYTE else 1
    return 2 if largest <= 1 else _NOT_NEGATIVE


def _names(line: str) -> list[str]:
    """Return a header's names in lower case, without quotes and units."""
    bare = line.lstrip("#/ \t").rstrip(",; \t").lower()
    cells = re.split(r"[,;\t]", bare) if re.search(r"[,;\t]", bare) else bare.split()
    return [re.sub(r"[^a-z0-9_ ].*$", "", cell.strip(" \"'")).strip() for cell in cells]


def _words(line: str) -> list[str]:
    """Split a row into its words."""
    if ";" in line:
        return line.replace(",", ".").replace(";", " ").split()
    return line.replace(",", " ").split()


def _is_row(line: str) -> bool:
    """Tell whether a line is a row of numbers, and not a comment, a header or a count."""
    words = _words(line)
    return not line.startswith(_COMMENT) and len(words) >= 2 and _is_number(words[0])


def _is_number(word: str) -> bool:
    """Tell whether a word is a number, finite or not."""
    try:
        float(word)
    except ValueError:
        return False
    return True
