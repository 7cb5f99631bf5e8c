"""PLY headers: parse them strictly, keep them verbatim, and say what else a file may be.

Conventions
-----------
* A header is kept as the bytes it was read as; what is parsed from it never replaces it.
* Sizes are in bytes, offsets count from the start of the file.
* Every fault is a ``PlyError``: a user error that also carries the name of the finding under
  which ``gscomplete validate`` lists it.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NoReturn

import numpy as np

from gscomplete.errors import UserError

MAX_HEADER_BYTES = 1 << 20
"""A header that has not ended after one MiB is not a header."""

MESH_FIRST = "make splats of it: splatcomplete-data mesh FILE --out DIR"
"""What to do with a mesh."""
_MESH_SUFFIXES = (".obj", ".stl", ".off", ".fbx", ".dae", ".gltf", ".3mf")

PlyFormat = Literal["ascii", "binary_little_endian", "binary_big_endian"]

FaultName = Literal[
    "unreadable_file",
    "not_a_splat_file",
    "compressed_splat_file",
    "bad_header",
    "missing_property",
    "mistyped_property",
    "truncated_payload",
    "bad_payload",
    "sh_layout",
]

SCALAR_CODES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
"""PLY scalar type names, old and new, with their numpy codes."""

_FORMATS: dict[str, PlyFormat] = {
    "ascii": "ascii",
    "binary_little_endian": "binary_little_endian",
    "binary_big_endian": "binary_big_endian",
}
_END = re.compile(rb"(?:^|\n)end_header[ \t]*(\r?\n|\r?$)")
_COUNT = re.compile(r"[0-9]{1,15}")


class PlyError(UserError):
    """A file that cannot be read as splats, with the name of the finding it is."""

    def __init__(self, path: Path, finding: FaultName, message: str) -> None:
        """Build the message ``path: message``."""
        super().__init__(f"{path}: {message}")
        self.finding: FaultName = finding


@dataclass(frozen=True, slots=True)
class Property:
    """One property of an element; a list property has a type for its length too."""

    name: str
    code: str  # numpy code of the value without byte order, "f4"
    count_code: str | None = None  # numpy code of a list's length; None = a scalar


@dataclass(frozen=True, slots=True)
class Element:
    """One element of a header: a table of ``count`` rows."""

    name: str
    count: int
    properties: tuple[Property, ...]
    line: int  # index of its line among ``PlyHeader.lines``

    @property
    def names(self) -> list[str]:
        """Names of the properties in order."""
        return [prop.name for prop in self.properties]

    @property
    def has_lists(self) -> bool:
        """True when rows differ in size."""
        return any(prop.count_code is not None for prop in self.properties)

    def row_dtype(self, order: str) -> np.dtype:
        """Packed record type of one row, with fields ``p0``, ``p1``, ... in file order.

        Args:
            order: numpy byte order, ``<`` or ``>``.

        Raises:
            ValueError: the element has list properties.
        """
        if self.has_lists:
            raise ValueError(f"element {self.name}: rows with lists have no fixed size")
        return np.dtype([(f"p{i}", order + prop.code) for i, prop in enumerate(self.properties)])


@dataclass(frozen=True, slots=True)
class PlyHeader:
    """A parsed header together with its own bytes."""

    format: PlyFormat
    elements: tuple[Element, ...]
    lines: tuple[bytes, ...] = field(repr=False)  # verbatim, each with its line ending

    @property
    def size(self) -> int:
        """Length of the header in bytes, which is where the payload starts."""
        return sum(len(line) for line in self.lines)

    @property
    def byte_order(self) -> str:
        """Numpy byte order of the payload (``<`` for ASCII, where none applies)."""
        return ">" if self.format == "binary_big_endian" else "<"

    @property
    def newline(self) -> bytes:
        """Line ending of the header."""
        return b"\r\n" if self.lines[0].endswith(b"\r\n") else b"\n"

    @property
    def comments(self) -> tuple[str, ...]:
        """Texts of the comment and obj_info lines, without their keyword."""
        texts = [line.decode("utf-8", "replace").strip() for line in self.lines]
        kept = [text for text in texts if text.split(" ", 1)[0] in ("comment", "obj_info")]
        return tuple(text.partition(" ")[2] for text in kept)

    def find(self, name: str) -> Element | None:
        """Return the element called ``name``, or None."""
        return next((element for element in self.elements if element.name == name), None)


def read_header(path: Path) -> PlyHeader:
    """Read and parse the header of a PLY file, whatever its elements.

    Raises:
        PlyError: the file cannot be opened, is something else, or its header is malformed.
    """
    try:
        if path.exists() and not path.is_file():
            kind = "a folder" if path.is_dir() else "a device or pipe"
            raise PlyError(path, "unreadable_file", f"expected a file, found {kind}")
        with path.open("rb") as stream:
            head = stream.read(MAX_HEADER_BYTES)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise PlyError(path, "unreadable_file", f"cannot read: {reason}") from error
    if not re.match(rb"ply[ \t]*(\r?\n|\r|$)", head):
        kind = describe_content(head, path)
        raise PlyError(path, "not_a_splat_file", f"expected a PLY file, found {kind}")
    end = _END.search(head)
    if end is None or (not end.group(1).endswith(b"\n") and end.end() < os.path.getsize(path)):
        limit = f"in the first {len(head)} bytes"
        raise PlyError(
            path, "bad_header", f"PLY header: expected a line 'end_header', none {limit}"
        )
    return _parse(path, _split_lines(head[: end.end()]))


def _split_lines(head: bytes) -> tuple[bytes, ...]:
    """Split at newlines only (``splitlines`` also splits at a carriage return in a comment)."""
    parts = head.split(b"\n")
    ended = [part + b"\n" for part in parts[:-1]]
    return tuple([*ended, parts[-1]] if parts[-1] else ended)


def _parse(path: Path, lines: tuple[bytes, ...]) -> PlyHeader:
    """Parse header lines, each verbatim with its ending."""
    found: PlyFormat | None = None
    elements: list[Element] = []
    properties: list[Property] = []

    def fail(number: int, expected: str) -> NoReturn:
        text = lines[number].decode("utf-8", "replace").strip()[:80]
        message = f"PLY header, line {number + 1}: expected {expected}, found '{text}'"
        raise PlyError(path, "bad_header", message)

    def close_element() -> None:
        if elements:
            last = elements[-1]
            elements[-1] = Element(last.name, last.count, tuple(properties), last.line)
            properties.clear()

    for number, line in enumerate(lines[1:], start=1):
        words = line.decode("utf-8", "replace").split()
        match words:
            case [] | ["comment", *_] | ["obj_info", *_] | ["end_header"]:
                continue
            case ["format", name, "1.0"] if name in _FORMATS and found is None:
                found = _FORMATS[name]
            case ["format", *_]:
                fail(number, f"once 'format' with one of {', '.join(_FORMATS)} and 1.0")
            case ["element", name, count] if _COUNT.fullmatch(count):
                close_element()
                if name in [element.name for element in elements]:
                    fail(number, f"element '{name}' once")
                elements.append(Element(name, int(count), (), number))
            case ["element", *_]:
                fail(number, "'element NAME COUNT' with a whole COUNT from 0")
            case ["property", "list", count_type, value_type, name] if elements:
                count_code = SCALAR_CODES.get(count_type, "f4")
                if value_type not in SCALAR_CODES or count_code.startswith("f"):
                    fail(number, "known scalar types, an integer one for the length")
                properties.append(Property(name, SCALAR_CODES[value_type], count_code))
            case ["property", value_type, name] if elements and value_type in SCALAR_CODES:
                properties.append(Property(name, SCALAR_CODES[value_type]))
            case ["property", *_]:
                fail(number, "'property TYPE NAME' with a known type, after an element")
            case _:
                fail(number, "a format, comment, element or property line")
    close_element()
    if found is None:
        raise PlyError(path, "bad_header", "PLY header: expected a 'format' line, found none")
    return PlyHeader(found, tuple(elements), lines)


def describe_content(head: bytes, path: Path) -> str:
    """Say in a few words what a file that is not a PLY looks like, from its first bytes."""
    start = head[:256].lstrip().lower()
    by_start = [
        (
            b"\x1f\x8b",
            "gzip data (unpack a PLY first; an .spz: splatcomplete-data convert IN.spz OUT.ply)",
        ),
        (
            b"ngsp",
            "an SPZ splat file (NGSP; convert it first: splatcomplete-data convert IN.spz OUT.ply)",
        ),
        (b"version https://git-lfs", "a git-lfs pointer (the real file was not downloaded)"),
        (b"<!doctype html", "an HTML page (a download that failed?)"),
        (b"<html", "an HTML page (a download that failed?)"),
        (b"<?xml", "an XML file"),
        (b"pk\x03\x04", "a ZIP archive (perhaps .sog or .usdz)"),
        (b"gltf", "a binary glTF file"),
        (b"\x89png", "a PNG image"),
        (b"\xff\xd8\xff", "a JPEG image"),
        (b"# .pcd", "a PCD point cloud; make splats of it: splatcomplete-data scan FILE --out DIR"),
        (b"{", "a JSON file"),
    ]
    if not head:
        return "an empty file"
    if path.suffix.lower() == ".splat":
        return "a .splat file (convert it first: splatcomplete-data convert IN.splat OUT.ply)"
    if path.suffix.lower() == ".ksplat":
        return "a .ksplat file (convert it to PLY first)"
    if path.suffix.lower() in _MESH_SUFFIXES:
        return f"a mesh; {MESH_FIRST}"
    for magic, kind in by_start:
        if start.startswith(magic):
            return kind
    if not head.strip(b"\x00"):
        return "zero bytes only"
    return f"bytes starting with {head[:12]!r}"
