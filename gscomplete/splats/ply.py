"""Splat PLY files: read, write, and append while passing the old records on byte for byte.

Conventions
-----------
* ``read_splats`` takes binary little- or big-endian and ASCII files with the properties of the
  original 3DGS in any order and of any scalar type (``layout``); everything else in a file
  (comments, foreign properties, other elements) is tolerated and kept.
* ``load_splats`` reads the same files but keeps none of their bytes.
* ``write_splats`` writes the layout of the original 3DGS: little-endian float32, with the unused
  normals ``nx ny nz`` as zeros, since viewers exist that read its records by position.
* ``append_splats`` never decodes and encodes the source's records; their bytes are copied.
* Logits, logarithms and the channel-major order exist in the file only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch

from gscomplete.errors import UserError
from gscomplete.splats.ply_files.header import (
    MESH_FIRST,
    Element,
    PlyError,
    PlyHeader,
    Property,
    read_header,
)
from gscomplete.splats.ply_files.layout import REQUIRED, SplatLayout, find_layout
from gscomplete.splats.ply_files.payload import (
    BlockSink,
    Payload,
    format_rows,
    pass_records,
    read_payload,
    write_rows,
)
from gscomplete.splats.ply_files.records import Decoder, Encoder
from gscomplete.splats.record import Splats
from gscomplete.util.atomic import atomic_path
from gscomplete.util.file_names import SPLAT_SUFFIXES

_OTHER_SUFFIXES = (
    *(suffix for suffix in SPLAT_SUFFIXES if suffix != ".ply"),
    *(".usd", ".usda", ".usdc", ".html"),
)
"""Of files that are no plain PLY, ``.compressed.ply`` among them."""


@dataclass(frozen=True, slots=True, eq=False)
class SplatFile:
    """A splat PLY as read: its splats, and its bytes for passing on."""

    path: Path
    splats: Splats  # activated, float32, on the CPU, in the file frame
    header: PlyHeader
    element: Element  # the one that holds the splats
    layout: SplatLayout  # which of its properties hold what
    payload: Payload = field(repr=False)
    warnings: tuple[str, ...]  # oddities that did not stop the reading

    @property
    def n_rows(self) -> int:
        """Number of vertex records."""
        return self.element.count

    def released(self) -> SplatFile:
        """Return the file without what was decoded: its bytes are enough to append to."""
        return dataclasses.replace(self, splats=self.splats.select(torch.arange(0)))

    @property
    def comments(self) -> tuple[str, ...]:
        """Texts of the file's comments."""
        return self.header.comments


def read_splats(path: str | Path) -> SplatFile:
    """Read a splat PLY file.

    Rows with NaN or infinite values are read as they are; ``filters.usable_rows`` finds them.

    Args:
        path: a splat PLY in the layout of the original 3DGS.

    Returns:
        The splats (activated values, file frame), and what writing the file again needs.

    Raises:
        PlyError: (a ``UserError``) the file is missing, something else than splats, malformed or
            truncated; the message names the file, the field, what was expected and found.
    """
    path = Path(path)
    header = read_header(path)
    element = splat_element(header, path)
    layout = find_layout(element, path)
    opened = _DecoderOnDemand(header, element, layout)
    payload = read_payload(path, header, element, opened.sink)
    warnings = list(payload.warnings)
    if layout.dropped_bands:
        warnings.append("spherical harmonics above degree 3 are kept in the file but not used")
    if layout.integer:
        warnings.append(f"integer-typed splat properties: {', '.join(layout.integer)}")
    if element.count == 0:
        warnings.append("no splats: element vertex has 0 rows")
    return SplatFile(path, opened.splats(), header, element, layout, payload, tuple(warnings))


def load_splats(path: str | Path) -> Splats:
    """Read only the splats of a PLY file: half the memory and time of ``read_splats``.

    Args:
        path: a splat PLY in the layout of the original 3DGS.

    Returns:
        The splats: activated values, file frame.

    Raises:
        PlyError: as ``read_splats``.
    """
    path = Path(path)
    header = read_header(path)
    element = splat_element(header, path)
    opened = _DecoderOnDemand(header, element, find_layout(element, path))
    pass_records(path, header, element, opened.sink)
    return opened.splats()


class _DecoderOnDemand:
    """A decoder that has no arrays before the file is known to hold as many rows as it says."""

    def __init__(self, header: PlyHeader, element: Element, layout: SplatLayout) -> None:
        self._count, self._layout = element.count, layout
        self._dtype = element.row_dtype(header.byte_order)
        self._decoder: Decoder | None = None

    def sink(self) -> BlockSink:
        """Make the arrays; return what fills them."""
        self._decoder = Decoder.for_rows(self._count, self._layout, self._dtype)
        return self._decoder.fill

    def splats(self) -> Splats:
        """Return what was decoded."""
        assert self._decoder is not None
        return self._decoder.splats()


def splat_element(header: PlyHeader, path: Path) -> Element:
    """Return the vertex element of a header that may hold splats.

    Raises:
        PlyError: there is no vertex element, the file is SuperSplat's compressed form, or the
            vertices belong to a mesh.
    """
    element = header.find("vertex")
    if element is None:
        names = ", ".join(e.name for e in header.elements) or "none"
        message = f"expected an element 'vertex', found elements: {names}"
        raise PlyError(path, "not_a_splat_file", message)
    if "packed_position" in element.names:
        message = (
            "a SuperSplat compressed PLY (packed_position, packed_rotation, ...), expected plain "
            "splats; convert it first: splatcomplete-data convert IN.compressed.ply OUT.ply"
        )
        raise PlyError(path, "compressed_splat_file", message)
    faces = header.find("face")
    if faces is not None and not set(REQUIRED) <= set(element.names):
        counts = f"{element.count} vertices, {faces.count} faces"
        message = f"expected splats, found a mesh PLY ({counts}); {MESH_FIRST}"
        raise PlyError(path, "not_a_splat_file", message)
    return element


def write_splats(path: str | Path, splats: Splats, comments: Sequence[str] = ()) -> None:
    """Write splats as a new binary little-endian PLY file in the layout of the original 3DGS.

    Opacities of 0 and 1 and scales of 0 are clamped to finite logits and logarithms.

    Args:
        path: the file to create or replace, atomically.
        splats: finite splats, in the file frame.
        comments: texts of comment lines; line breaks in them become spaces.

    Raises:
        UserError: the file cannot be written, or its name is that of another format.
        ValueError: a value is not finite or out of range (``Encoder``).
    """
    if isinstance(splats, SplatFile):
        raise TypeError("splats: expected Splats, found a SplatFile; its .splats are meant")
    _require_ply(Path(path))
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{i}" for i in range(3 * (splats.sh.shape[1] - 1))]
    names += [name for name in REQUIRED if name not in names]  # opacity, scale, rot
    element = Element("vertex", len(splats), tuple(Property(name, "f4") for name in names), 0)
    layout = find_layout(element, Path(path))
    lines = ["ply", "format binary_little_endian 1.0", *_comment_lines(comments)]
    lines += [f"element vertex {len(splats)}", *(f"property float {name}" for name in names)]
    encoder = Encoder.of_splats(splats, layout, element.row_dtype("<"))
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write("\n".join([*lines, "end_header\n"]).encode())
        write_rows(stream, len(splats), encoder.dtype.itemsize, encoder.records)


def append_splats(
    path: str | Path, source: SplatFile, new: Splats, comments: Sequence[str] = ()
) -> None:
    """Write a file with the records of ``source`` first, byte for byte, and new splats after.

    Format, property list, comments and other elements are those of the source. Foreign
    properties of the new records are 0, as are SH bands that the new splats lack.

    Args:
        path: the file to create or replace, atomically; may be the source's own path.
        source: a file as read.
        new: finite splats in the file frame.
        comments: texts to add after the source's comments, such as ``gscomplete new_splats 5000``.

    Raises:
        UserError: the source's records cannot hold the new splats (fewer SH bands, integer
            types), or the file cannot be written, or its name is that of another format.
        ValueError: a new value is not finite or out of range (``Encoder``).
    """
    _require_ply(Path(path))
    require_appendable(source)
    element, layout = source.element, source.layout
    if new.sh.shape[1] > layout.coefficients:
        raise UserError(
            f"{source.path}: has {layout.coefficients} SH coefficients per channel, cannot append "
            f"splats with {new.sh.shape[1]}; expected new.with_sh_degree({source.splats.sh_degree})"
        )
    dtype = element.row_dtype(source.header.byte_order)
    payload = source.payload
    ascii_rows = source.header.format == "ascii"
    encoder = Encoder.of_splats(new, layout, dtype)
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        count = element.count + len(new)
        stream.write(_extended_header(source.header, element, count, comments))
        stream.write(payload.before)
        stream.write(payload.records.data)
        if ascii_rows and payload.records.size and payload.records[-1] != ord("\n"):
            stream.write(source.header.newline)
        if ascii_rows:
            stream.writelines(format_rows(block) for block in encoder.blocks())
        else:
            write_rows(stream, len(new), dtype.itemsize, encoder.records)
        stream.write(payload.after)


def _require_ply(path: Path) -> None:
    """Refuse a file that would be named as one of another format.

    Raises:
        UserError: it would.
    """
    name = path.name.lower()
    others = [suffix for suffix in _OTHER_SUFFIXES if name.endswith(suffix)]
    if others:
        raise UserError(
            f"{path}: expected the name of a .ply file, found {others[0]}; write a PLY and convert "
            "it (splatcomplete-data convert)"
        )


def require_appendable(source: SplatFile) -> None:
    """Refuse a file whose records cannot hold new splats, before anything is computed for it.

    Raises:
        UserError: properties of splats are integers.
    """
    if source.layout.integer:
        fields = ", ".join(source.layout.integer)
        raise UserError(
            f"{source.path}: expected float properties, found integer-typed {fields}: new splats "
            "cannot be appended to them"
        )


def _comment_lines(comments: Sequence[str]) -> list[str]:
    """Comment lines without ending, each on one line whatever the text holds."""
    return [f"comment {' '.join(text.split())}" for text in comments]


def _extended_header(
    header: PlyHeader, element: Element, count: int, comments: Sequence[str]
) -> bytes:
    """The header's own lines with another vertex count, and comments before the first element."""
    ending = header.newline
    lines = list(header.lines)
    lines[element.line] = f"element {element.name} {count}".encode() + ending
    first = min(other.line for other in header.elements)
    added = [line.encode() + ending for line in _comment_lines(comments)]
    return b"".join([*lines[:first], *added, *lines[first:]])
