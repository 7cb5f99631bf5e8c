"""The part of a PLY file after its header: cut it into vertex records and what surrounds them.

Conventions
-----------
* A payload is three runs of bytes: the elements before ``vertex``, the vertex records, the rest.
* Nothing is allocated for a count that the file's size contradicts.
* In ASCII files a row is a line.
"""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from gscomplete.splats.ply_files.header import Element, PlyError, PlyHeader
from gscomplete.splats.ply_files.threads import WRITE_BYTES, Scratch, for_each_block

BlockSink = Callable[[slice, NDArray[np.void]], None]
"""Takes rows and their records."""
_LINE_BYTES = np.frombuffer(b"\t\n\v\f\r", np.uint8)
"""What ASCII rows may hold beside printable characters."""


@dataclass(frozen=True, slots=True, eq=False)
class Payload:
    """The bytes after a header."""

    before: bytes  # elements before the vertex element
    records: NDArray[np.uint8]  # the vertex element, verbatim
    after: bytes  # everything behind it
    warnings: tuple[str, ...]


def read_payload(
    path: Path,
    header: PlyHeader,
    vertex: Element,
    open_sink: Callable[[], BlockSink] | None = None,
) -> Payload:
    """Read the bytes after the header.

    Args:
        path: the file.
        header: its header.
        vertex: its vertex element, without lists.
        open_sink: called once when the file is known to hold all records; what it returns is
            called with every block of them as soon as that is read, while the processor's cache
            has it, in any order and from several threads.

    Raises:
        PlyError: the file is shorter than the header says, or cannot be read.
    """
    with _opened(path) as stream:
        if header.format == "ascii":
            stream.seek(header.size)
            payload = _cut_lines(path, stream.read(), header, vertex)
            if open_sink is not None:
                parsed = parse_records(path, header, vertex, payload)
                open_sink()(slice(0, vertex.count), parsed)
            return payload
        start, size = locate_records(path, stream, header, vertex)
        stream.seek(header.size)
        before = stream.read(start - header.size)
        rows = np.empty(vertex.count, vertex.row_dtype(header.byte_order))
        sink = open_sink() if open_sink else None

        def read_block(part: slice) -> None:
            _read_at(path, stream, rows[part], start + part.start * rows.itemsize)
            if sink is not None:
                sink(part, rows[part])

        for_each_block(len(rows), rows.itemsize, read_block)
        stream.seek(start + size)
        after = stream.read()
    found = tuple(check_rest(header, vertex, len(after)))
    return Payload(before, rows.view(np.uint8), after, found)


def pass_records(
    path: Path, header: PlyHeader, vertex: Element, open_sink: Callable[[], BlockSink]
) -> None:
    """Read the vertex records as ``read_payload`` does, but keep none of their bytes.

    Raises:
        PlyError: as ``read_payload``.
    """
    if header.format == "ascii":
        read_payload(path, header, vertex, open_sink)
        return
    dtype = vertex.row_dtype(header.byte_order)
    with _opened(path) as stream:
        start, _ = locate_records(path, stream, header, vertex)
        sink, scratch = open_sink(), Scratch()

        def read_block(part: slice) -> None:
            block = scratch.records(part.stop - part.start, dtype)
            _read_at(path, stream, block, start + part.start * dtype.itemsize)
            sink(part, block)

        for_each_block(vertex.count, dtype.itemsize, read_block)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """Open a file for reading; what the system refuses is a ``PlyError``."""
    try:
        with path.open("rb") as stream:
            yield stream
    except OSError as error:
        message = f"cannot read: {error.strerror or type(error).__name__}"
        raise PlyError(path, "unreadable_file", message) from error


def _read_at(path: Path, stream: BinaryIO, records: NDArray[np.void], offset: int) -> None:
    """Fill records from a place of a file without moving the stream, which threads share."""
    rest = memoryview(records.view(np.uint8).data)
    while len(rest):
        size = os.preadv(stream.fileno(), [rest], offset)
        if size == 0:
            expected = f"expected vertex records up to byte {offset + len(rest)}"
            message = f"changed while it was read: {expected}, found its end at {offset}"
            raise PlyError(path, "truncated_payload", message)
        rest, offset = rest[size:], offset + size


def write_rows(
    stream: BinaryIO,
    count: int,
    row_size: int,
    records_of: Callable[[slice], NDArray[np.void]],
) -> None:
    """Write binary records at a stream's place and go on behind them.

    Args:
        stream: a file opened for writing.
        count: number of records.
        row_size: bytes of one.
        records_of: makes the records of some rows; called from several threads.

    Raises:
        OSError: the file cannot be written.
    """
    stream.flush()
    start = stream.tell()

    def write_block(rows: slice) -> None:
        rest = memoryview(records_of(rows).view(np.uint8).data)
        offset = start + rows.start * row_size
        while len(rest):
            size = os.pwrite(stream.fileno(), rest, offset)
            rest, offset = rest[size:], offset + size

    for_each_block(count, row_size, write_block, WRITE_BYTES)
    stream.seek(start + count * row_size)


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
    _check_ascii(path, payload.records)
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


def _check_ascii(path: Path, text: NDArray[np.uint8]) -> None:
    """Refuse bytes that readers disagree on: some take 0xA0 and 0x85 for spaces.

    Raises:
        PlyError: there is one.
    """
    bad = np.flatnonzero(((text < 0x20) | (text > 0x7E)) & ~np.isin(text, _LINE_BYTES))
    if len(bad):
        row = int((text[: bad[0]] == ord("\n")).sum())
        message = f"element vertex, row {row}: expected ASCII, found byte 0x{text[bad[0]]:02X}"
        raise PlyError(path, "bad_payload", message)


def format_rows(records: NDArray[np.void]) -> bytes:  # [B]
    """Write records as ASCII lines with as many digits as their types hold."""
    digits = {"f4": "%.9g", "f8": "%.17g"}
    names = records.dtype.names or ()
    kinds = [records.dtype[name].str[1:] for name in names]
    row_format = " ".join(digits.get(kind, "%d") for kind in kinds) + "\n"
    return "".join(row_format % row for row in records.tolist()).encode()
