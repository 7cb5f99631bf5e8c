"""Read and write splat files of any format.

Conventions
-----------
* Splats are handed over in the frame of a PLY, -Y up: formats with axes of their own are turned,
  and ``notes`` says so. Splats whose up is known to be another are written by ``y_up``.
* PLY is the native form, ``.glb`` and USD hold all that its splats have; everything else is lossy.
  What a file or a format cannot pass on is named, never dropped silently.
* ``read_splat_file`` is for commands that pass a PLY's records on byte for byte: files of other
  formats are converted to a PLY first.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from gscomplete.errors import UserError
from gscomplete.splats.filters import in_words, reason_in_words, usable_rows
from gscomplete.splats.formats import compressed_ply, dot_splat, glb, ksplat, sog, spz, usd
from gscomplete.splats.ply import SplatFile, read_splats, write_splats
from gscomplete.splats.ply_files.header import PlyError, read_header
from gscomplete.splats.record import Splats
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.util.file_names import COMPLETE_FILE, OBJECT_FILE, PARTIAL_FILE

SplatFormat = Literal[
    "ply", "compressed.ply", "splat", "spz", "glb", "sog", "ksplat", "usd", "usda", "usdc"
]
READ: tuple[SplatFormat, ...] = ("ply", "compressed.ply", "splat", "spz", "glb", "sog", "ksplat")
"""Formats that are read."""
WRITTEN: tuple[SplatFormat, ...] = (
    *("ply", "compressed.ply", "splat", "spz", "glb", "sog"),
    *("usd", "usda", "usdc"),
)
"""Formats that are written."""
_Y_UP: tuple[SplatFormat, ...] = ("spz", "glb", "usd", "usda", "usdc")
"""Formats that say which way is up."""

_NORMALS = ("nx", "ny", "nz")
_COMMENTS_SHOWN = 5


@dataclass(frozen=True, slots=True, eq=False)
class Imported:
    """Splats of any file, as a PLY of the same object would have them."""

    splats: Splats
    format: SplatFormat
    notes: tuple[str, ...] = ()
    file_from_source: Similarity | None = None
    """What took the file's axes to those of a PLY; None = they are the same."""
    left: tuple[str, ...] = ()
    """What a plain PLY holds beside its splats: no converted file has it."""


def format_of(path: Path) -> SplatFormat:
    """Return the format that a file's name says; a folder with a meta.json is SOG.

    Raises:
        UserError: it says none of them.
    """
    name = path.name.lower()
    if name == sog.META_FILE or (path.is_dir() and (path / sog.META_FILE).is_file()):
        return "sog"
    names: tuple[SplatFormat, ...] = get_args(SplatFormat)
    fitting = [kind for kind in names if name.endswith("." + kind)]
    if not fitting:
        if (path / OBJECT_FILE).is_file():
            parts = f"{COMPLETE_FILE} or {PARTIAL_FILE}"
            raise UserError(f"{path}: expected a splat file, found an object folder: name {parts}")
        expected = ", ".join(f".{kind}" for kind in names)
        raise UserError(f"{path}: expected one of {expected}, found {path.name!r}")
    return max(fitting, key=len)


def read_any_splats(path: Path) -> Imported:
    """Read a splat file of any format.

    Raises:
        UserError: it is missing, of another kind, or damaged.
    """
    if not path.exists():
        raise UserError(f"{path}: expected a splat file, found none")
    kind = format_of(path)
    if kind not in READ:
        expected = ", ".join(f".{name}" for name in READ)
        raise UserError(f"{path}: .{kind} files are written, not read; expected {expected}")
    if kind == "spz":
        note = "SPZ axes (right, up, back) turned by 180 degrees about x to PLY's"
        return Imported(spz.read_spz(path), kind, (note,), spz.TURN)
    if kind == "glb":
        raw, others = glb.read_glb_splats(path)
        note = "glTF axes (y up) turned by 180 degrees about z to PLY's"
        left = (f"{others} primitives without splats",) if others else ()
        return Imported(transform_splats(raw, glb.TURN), kind, (note,), glb.TURN, left)
    if kind in _READERS:
        return Imported(_READERS[kind](path), kind)
    try:
        if kind == "ply":
            file = read_splats(path)
            return Imported(file.splats, kind, file.warnings, left=_beside_splats(file))
    except PlyError as error:
        if error.finding != "compressed_splat_file":
            raise
    return Imported(compressed_ply.read_compressed_ply(path), "compressed.ply")


_READERS: dict[SplatFormat, Callable[[Path], Splats]] = {
    "splat": dot_splat.read_dot_splat,
    "sog": sog.read_sog,
    "ksplat": ksplat.read_ksplat,
}
"""Formats in the frame of a PLY that hold nothing but splats."""


def read_splat_file(path: str | Path) -> SplatFile:
    """Read a splat file of any format as a PLY whose records can be passed on.

    Args:
        path: a PLY, or a file of another format, which is converted in a temporary folder.

    Returns:
        A PLY as ``read_splats`` gives it; of another format the PLY it was converted to, with a
        warning that says so.

    Raises:
        UserError: it is missing, of another kind, or damaged.
    """
    with as_ply(Path(path)) as (plain, warnings):
        file = read_splats(plain)
    return dataclasses.replace(file, path=Path(path), warnings=(*warnings, *file.warnings))


@contextlib.contextmanager
def as_ply(path: Path) -> Iterator[tuple[Path, tuple[str, ...]]]:
    """Yield a plain PLY of a splat file, and what there is to say of how it was made.

    Args:
        path: a PLY, which is yielded as it is, or a file of another format, which is converted in
            a temporary folder; splats that cannot be drawn are left out, and counted.

    Raises:
        UserError: a file of another format cannot be read.
    """
    if _is_plain(path):
        yield path, ()
        return
    found = read_any_splats(path)
    usable, reasons = usable_rows(found.splats)
    if not bool(usable.any()):
        raise UserError(
            f"{path}: expected splats that can be drawn, found {in_words(reasons) or 'none'}"
        )
    left = tuple(
        f"{count:,} splats left out: {reason_in_words(reason)}" for reason, count in reasons.items()
    )
    with tempfile.TemporaryDirectory(prefix="splats.") as folder:
        converted = Path(folder) / "converted.ply"
        write_splats(converted, found.splats.select(usable))
        yield converted, (f"converted from .{found.format} to PLY", *found.notes, *left)


def _is_plain(path: Path) -> bool:
    """Tell whether a file is to be read as a plain PLY, as a file of an unknown name is."""
    try:
        if format_of(path) != "ply":
            return False
    except UserError:
        return True
    try:
        header = read_header(path)
    except PlyError:
        return True  # whoever reads it says what is wrong
    vertex = header.find("vertex")
    return vertex is None or "packed_position" not in vertex.names


def write_any_splats(
    path: Path,
    splats: Splats,
    *,
    spz_version: spz.SpzVersion = 3,
    y_up: Similarity | None = None,
) -> tuple[str, ...]:
    """Write splats in the format of the name; return what is lost.

    Args:
        path: destination, replaced atomically.
        splats: activated splats in the frame of a PLY.
        spz_version: version of SPZ files.
        y_up: the turn from the splats' axes to y up, for formats that are y up; None = that of
            a PLY, whose up is -Y.

    Raises:
        UserError: the name says no format that is written, a splat is not finite, there are no
            splats and the format is not PLY, or the file cannot be written.
    """
    kind = writable_format_of(path)
    if len(splats) == 0 and kind != "ply":
        raise UserError(f"{path}: expected splats that can be drawn, found none")
    usable, reasons = usable_rows(splats)
    if not bool(usable.all()):
        raise UserError(
            f"{path}: expected splats that can be drawn, found {in_words(reasons)} (left out by "
            "splatcomplete-data clean)"
        )
    if kind == "splat":
        return dot_splat.write_dot_splat(path, splats)
    if kind == "sog":
        return sog.write_sog(path, splats)
    if kind == "spz":
        return spz.write_spz(path, splats, spz_version, y_up or spz.TURN)
    if kind == "compressed.ply":
        return compressed_ply.write_compressed_ply(path, splats)
    if kind == "ply":
        write_splats(path, splats)
    elif kind == "glb":
        glb.write_glb_splats(path, transform_splats(splats, y_up or glb.TURN))
    else:
        usd.write_usd(path, transform_splats(splats, y_up or glb.TURN))
    return ()


def writable_format_of(path: Path) -> SplatFormat:
    """Return the format that a destination's name says.

    Raises:
        UserError: it says none that is written.
    """
    name = path.name.lower()
    fitting = [kind for kind in WRITTEN if name.endswith("." + kind)]
    if not fitting or name == sog.META_FILE:
        expected = ", ".join(f".{kind}" for kind in WRITTEN)
        raise UserError(f"{path}: expected a format that is written: {expected}; found {name!r}")
    return max(fitting, key=len)


def axes_note(path: Path, y_up: Similarity | None = None) -> str | None:
    """Tell how a written file's axes differ from the splats'; None = its format has none.

    Args:
        path: destination.
        y_up: as ``write_any_splats`` is given it.
    """
    kind = format_of(path)
    if kind not in _Y_UP:
        return None
    axes = "in SPZ axes (right, up, back)" if kind == "spz" else "y up"
    if y_up is None:
        return f"written {axes}: turned by 180 degrees about {'x' if kind == 'spz' else 'z'}"
    cosine = (float(y_up.rotation.trace()) - 1) / 2
    angle = math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
    return f"written {axes}: " + (f"turned by {angle:.0f} degrees" if angle > 0.5 else "not turned")


def _beside_splats(file: SplatFile) -> tuple[str, ...]:
    """Name what a PLY file holds that is no splat value: properties, elements, comments."""
    element, layout = file.element, file.layout
    left = []
    unused = [name for name in layout.foreign if name not in _NORMALS]
    unused += _NORMALS if _has_normals(file) else ()
    if unused:
        left.append(f"properties {', '.join(unused)}")
    if layout.dropped_bands:
        left.append(f"harmonics above degree {file.splats.sh_degree}")
    others = [other.name for other in file.header.elements if other.name != element.name]
    if others:
        left.append(f"elements {', '.join(others)}")
    if file.comments:
        more = len(file.comments) - _COMMENTS_SHOWN
        shown = [repr(text) for text in file.comments[:_COMMENTS_SHOWN]]
        left.append(f"comments {', '.join(shown)}" + (f" and {more:,} more" if more > 0 else ""))
    return tuple(left)


def _has_normals(file: SplatFile) -> bool:
    """Tell whether a file's normals say anything: most are zeros, and are written as such."""
    element = file.element
    places = [element.names.index(name) for name in _NORMALS if name in element.names]
    if not places or element.count == 0:
        return False
    if file.header.format == "ascii":
        words = np.array(file.payload.records.tobytes().split(), np.float64)
        return bool(words.reshape(element.count, -1)[:, places].any())
    rows = file.payload.records.reshape(-1).view(element.row_dtype(file.header.byte_order))
    return any(bool(rows[f"p{place}"].any()) for place in places)
