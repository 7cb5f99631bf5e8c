"""The part of a PLY file after its header: cut it into vertex records and what surrounds them.

Conventions
-----------
* A payload is three runs of bytes: the elements before ``vertex``, the vertex records, the rest.
* Nothing is allocated for a count that the file's size does not bear out.
* In ASCII files a row is a line.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from gscomplete.splats.ply_header import Element, PlyError, PlyHeader


@dataclass(frozen=True, slots=True, eq=False)
class Payload:
    """The bytes after a header."""

    before: bytes  # elements before the vertex element
    records: NDArray[np.uint8]  # the vertex element, verbatim
    after: bytes  # everything behind it
    warnings: tuple[str, ...]


def read_payload(path: Path, header: PlyHeader, vertex: Element) -> Payload:
    """Read the bytes after the header.

    Raises:
        PlyError: the file is shorter than the header says, or cannot be read.
    """
    try:
        with path.open("rb") as stream:
            if header.format == "ascii":
                stream.seek(header.size)
                return _cut_lines(path, stream.read(), header, vertex)
            start, size = locate_records(path, stream, header, vertex)
            stream.seek(header.size)
            before = stream.read(start - header.size)
            records = np.fromfile(stream, np.uint8, size)
            if records.size < size:
                message = f"changed while it was read: expected {size} bytes of vertex records"
                raise PlyError(path, "truncated_payload", f"{message}, found {records.size}")
            after = stream.read()
    except OSError as error:
        message = f"cannot read: {error.strerror or type(error).__name__}"
        raise PlyError(path, "unreadable_file", message) from error
    return Payload(before, records, after, tuple(check_rest(header, vertex, len(after))))


def locate_records(
    path: Path, stream: BinaryIO, header: PlyHeader, vertex: Element
) -> tuple[int, int]:
    """Return the offset and size in bytes of the vertex records of a binary file.

    Raises:
        PlyError: the file ends before the last record.
    """
    file_size = os.fstat(stream.fileno()).st_size
    start = header.size
    for element in _elements_before(header, vertex):
        if element.has_lists:
            start = _skip_list_rows(path, stream, start, element, header.byte_order)
        else:
            start += element.count * element.row_dtype("<").itemsize
    row_size = vertex.row_dtype("<").itemsize
    size = vertex.count * row_size
    if start + size > file_size:
        found = max(file_size - start, 0)
        message = (
            f"truncated: element vertex has {vertex.count} rows of {row_size} bytes, expected "
            f"{size} bytes, found {found} ({found // row_size} rows)"
        )
        raise PlyError(path, "truncated_payload", message)
    return start, size


def _elements_before(header: PlyHeader, vertex: Element) -> list[Element]:
    """Elements whose rows precede those of ``vertex``."""
    return [element for element in header.elements if element.line < vertex.line]


def _skip_list_rows(path: Path, stream: BinaryIO, start: int, element: Element, order: str) -> int:
    """Return the offset behind an element with list properties, walking its rows."""
    stream.seek(start)
    for _ in range(element.count):
        for prop in element.properties:
            length = 1
            if prop.count_code is not None:
                count_type = np.dtype(order + prop.count_code)
                data = stream.read(count_type.itemsize)
                if len(data) < count_type.itemsize:
                    message = f"truncated: expected a list length of element {element.name}"
                    raise PlyError(path, "truncated_payload", f"{message}, found the file's end")
                length = int(np.frombuffer(data, count_type)[0])
                if length < 0:
                    message = f"element {element.name}: expected a list length, found {length}"
                    raise PlyError(path, "bad_payload", message)
            stream.seek(length * np.dtype(prop.code).itemsize, os.SEEK_CUR)
    return stream.tell()


def check_rest(header: PlyHeader, vertex: Element, found: int) -> Iterator[str]:
    """Warn when what follows the vertex records has not the size the header says.

    Args:
        header: the file's header.
        vertex: its vertex element.
        found: number of bytes behind the vertex records.
    """
    rest = [element for element in header.elements if element.line > vertex.line]
    if any(element.has_lists for element in rest):
        return
    expected = sum(element.count * element.row_dtype("<").itemsize for element in rest)
    if found < expected:
        yield f"truncated after the vertices: expected {expected} more bytes, found {found}"
    elif found > expected:
        yield f"{found - expected} bytes after the last element that the header does not mention"


def stream_records(
    path: Path, header: PlyHeader, vertex: Element, rows: int
) -> Iterator[NDArray[np.void]]:
    """Yield the vertex records in blocks; a binary file is never in memory as a whole.

    Args:
        path: the file.
        header: its header.
        vertex: its vertex element.
        rows: number of records in a block.

    Raises:
        PlyError: as ``read_payload`` and ``parse_records``.
    """
    if header.format == "ascii":
        records = parse_records(path, header, vertex, read_payload(path, header, vertex))
        yield from (records[start : start + rows] for start in range(0, len(records), rows))
        return
    dtype = vertex.row_dtype(header.byte_order)
    with path.open("rb") as stream:
        start, _ = locate_records(path, stream, header, vertex)
        stream.seek(start)
        for first in range(0, vertex.count, rows):
            yield np.fromfile(stream, dtype, min(rows, vertex.count - first))


def payload_warnings(path: Path, header: PlyHeader, vertex: Element) -> tuple[str, ...]:
    """Return what ``read_payload`` would warn about, without reading the payload."""
    if header.format == "ascii":
        return ()
    with path.open("rb") as stream:
        start, size = locate_records(path, stream, header, vertex)
        end = os.fstat(stream.fileno()).st_size
    return tuple(check_rest(header, vertex, end - start - size))


def _cut_lines(path: Path, data: bytes, header: PlyHeader, vertex: Element) -> Payload:
    """Cut the lines of an ASCII payload."""
    raw = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero(raw == ord("\n")) + 1
    if len(raw) and raw[-1] != ord("\n"):
        ends = np.append(ends, len(raw))
    skipped = sum(element.count for element in _elements_before(header, vertex))
    found = max(len(ends) - skipped, 0)
    if vertex.count > found:
        message = f"truncated: element vertex: expected {vertex.count} lines, found {found}"
        raise PlyError(path, "truncated_payload", message)
    offsets = np.concatenate([[0], ends])
    start, stop = int(offsets[skipped]), int(offsets[skipped + vertex.count])
    return Payload(data[:start], raw[start:stop], data[stop:], ())


def parse_records(
    path: Path, header: PlyHeader, vertex: Element, payload: Payload
) -> NDArray[np.void]:
    """View binary records, or parse ASCII ones, as rows of ``Element.row_dtype``.

    Raises:
        PlyError: an ASCII row has a wrong number of values or something that is no number.
    """
    dtype = vertex.row_dtype(header.byte_order)
    if header.format != "ascii":
        return payload.records.view(dtype)
    width = len(vertex.properties)
    records = np.zeros(vertex.count, dtype)
    if vertex.count == 0:
        return records
    text = payload.records.tobytes().replace(b"\r", b" ")
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # "input contained no data": counted below
            table = np.loadtxt(BytesIO(text), np.float64, comments=None, ndmin=2)
            if table.shape != (vertex.count, width):
                found = f"{table.shape[0]} rows of {table.shape[1]}"
                raise ValueError(f"expected {vertex.count} rows of {width} values, found {found}")
            for i in range(width):
                records[f"p{i}"] = table[:, i]
    except (ValueError, OverflowError) as error:
        raise PlyError(path, "bad_payload", f"element vertex: {error}") from error
    return records


def format_rows(records: NDArray[np.void]) -> bytes:  # [B]
    """Write records as ASCII lines with as many digits as their types hold."""
    digits = {"f4": "%.9g", "f8": "%.17g"}
    names = records.dtype.names or ()
    kinds = [records.dtype[name].str[1:] for name in names]
    row_format = " ".join(digits.get(kind, "%d") for kind in kinds) + "\n"
    return "".join(row_format % row for row in records.tolist()).encode()
