"""Object folders: one partial splat object with all that is known about it.

Conventions
-----------
* A folder holds ``object.json`` (this module's ``ObjectRecord``), ``partial.ply``,
  ``complete.ply`` where the truth is known, and ``preview.png``.
* All splats are in one frame, the file frame, in the source's own units and axes.
  ``file_from_source`` says how it came from the source's frame: null where it is the source's.
* ``frame`` is the object frame of the complete object within the file frame; ``views`` holds the
  input view c and the ranges of V, in degrees in that object frame.
* ``object.json`` is the same bytes for the same input, options and version: no times, no paths
  of this machine other than those the user gave.
* Folders are written whole or not at all (``atomic_folder``); SHA-256 covers every other file.

Schema of object.json: the fields of ``ObjectRecord`` plus ``schema`` and ``version``. Unknown
fields are errors, and so are missing ones that have no default. Fields with a default may be new,
and records of earlier versions lack them; a new version number announces any other change.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gscomplete import __version__
from gscomplete.errors import UserError
from gscomplete.folders.object_folder import (
    COMPLETE_FILE,
    PARTIAL_FILE,
    SCHEMA,
    SCHEMA_VERSION,
    Subset,
    read_views,
)
from gscomplete.folders.object_folder import OBJECT_FILE as RECORD_FILE
from gscomplete.splats import Similarity, Splats, read_splats, write_splats
from gscomplete.util import jsonio
from gscomplete.util.digests import sha256_of
from gscomplete.util.file_names import is_plain_name
from gscomplete.util.parse import has_controls, is_text
from gscomplete.views import FrameOrigin, GivenOfFrame, ObjectFrame, ViewDistribution
from splatcomplete_data.atomic_folder import atomic_folder
from splatcomplete_data.cuts.boxes import CropBox

if TYPE_CHECKING:
    from PIL import Image

PREVIEW_FILE = "preview.png"
BOXES_FILE = "boxes.png"
"""Picture of crop boxes: part of a cropped object, or what ``crop --propose`` leaves."""
CLUSTERS_FILE = "clusters.png"
"""Picture of what stands in a scan: what ``scan --propose`` leaves."""
PROPOSED_FILES = (BOXES_FILE, CLUSTERS_FILE)
"""A folder that holds only these is no object's yet; they may be lost."""


@dataclass(frozen=True, slots=True)
class SourceRecord:
    """Where the object comes from."""

    file: str
    """Source file or folder, as the user named it."""
    sha256: str | None = None
    """Hash of the source file; None for a folder."""
    licence: str | None = None
    """Licence of the source; None = not stated."""
    origin: str | None = None
    """Who made it, or where it was found; None = not stated."""


@dataclass(frozen=True, slots=True)
class StepRecord:
    """What one step of the making did to the number of points or splats."""

    name: str
    """The step, such as ``flying_pixels``."""
    before: int
    """Number before it."""
    after: int
    """Number after it."""
    reasons: dict[str, int] = field(default_factory=dict)
    """How many were removed for which reason."""
    note: str = ""
    """Anything else notable, such as a chosen threshold."""

    def summary(self) -> str:
        """One line for people."""
        removed = self.before - self.after
        text = f"{self.name}: {self.before:,} -> {self.after:,}"
        if removed:
            why = ", ".join(f"{count:,} {name}" for name, count in self.reasons.items())
            text += f" (removed {why or f'{removed:,}'})"
        return f"{text}; {self.note}" if self.note else text


@dataclass(frozen=True, slots=True)
class FileRecord:
    """One file of the folder."""

    sha256: str
    bytes: int


@dataclass(frozen=True, slots=True)
class ObjectRecord:
    """Content of ``object.json``."""

    id: str
    """Name, unique within a dataset; the folder's name by default."""
    subset: Subset
    """Kind of source."""
    prompt: str
    """What the complete object is."""
    source: SourceRecord
    """Where it comes from."""
    frame: ObjectFrame
    """Up axis, centre and size of the complete object in the file frame."""
    frame_origin: FrameOrigin
    """Whether centre and size come from the known complete object, a guess from the part, or the
    user."""
    views: ViewDistribution
    """Input view c and view distribution V."""
    frame_given: tuple[GivenOfFrame, ...] | None = None
    """What the user gave of the frame; None = both if ``frame_origin`` says so, as records of
    earlier versions do."""
    file_from_source: dict[str, Any] | None = None
    """Similarity from the source's frame to the file frame (JSON form); None = identity."""
    boxes: tuple[CropBox, ...] = ()
    """Crop boxes, in the source's frame."""
    splat_size: float | None = None
    """Standard deviation of fixed-size splats in file units; None = sizes differ."""
    steps: tuple[StepRecord, ...] = ()
    """What each step kept and removed, in order."""
    notes: tuple[str, ...] = ()
    """Warnings and reasons of guesses, for people."""
    details: dict[str, Any] = field(default_factory=dict)
    """What only this kind of source has, such as the camera of a single view."""
    options: dict[str, Any] = field(default_factory=dict)
    """Resolved options of the command that made it."""
    tool_version: str = __version__
    """Version of the tool that made it."""
    counts: dict[str, int] = field(default_factory=dict)
    """Splats per PLY file and ``sh_degree``; filled in by ``write_object``."""
    files: dict[str, FileRecord] = field(default_factory=dict)
    """Hash and size of every other file; filled in by ``write_object``."""

    def __post_init__(self) -> None:
        """Check what would make the object useless.

        Raises:
            ValueError: the id or a file's name is no plain file name, or the prompt is empty, no
                Unicode text, or holds control characters.
        """
        for name in self.files:
            if not is_plain_name(name):
                raise ValueError(f"files: expected plain file names, found {name!r}")
        if not is_plain_name(self.id):
            raise ValueError(f"id: expected a plain file name, found {self.id!r}")
        if not self.prompt.strip():
            raise ValueError("prompt: expected a name of the complete object, found an empty text")
        if not is_text(self.prompt):
            raise ValueError(f"prompt: expected Unicode text, found {self.prompt!r}")
        if has_controls(self.prompt):
            raise ValueError(
                f"prompt: expected a text without control characters, found {self.prompt!r}"
            )

    def to_json(self) -> dict[str, Any]:
        """Return the JSON form."""
        data = jsonio.to_json(self)
        data["views"] = self.views.to_json()
        return {"schema": SCHEMA, "version": SCHEMA_VERSION, **data}

    @classmethod
    def from_json(cls, data: Any, source: str) -> ObjectRecord:
        """Read the JSON form; ``source`` names the file in errors.

        Raises:
            UserError: another schema or version, or a field missing, unknown or wrong.
        """
        if not isinstance(data, dict):
            raise UserError(f"{source}: expected an object, found {type(data).__name__}")
        for name, expected in (("schema", SCHEMA), ("version", SCHEMA_VERSION)):
            if data.get(name) != expected:
                raise UserError(
                    f"{source}: {name}: expected {expected!r}, found {data.get(name)!r}"
                )
        values = {key: value for key, value in data.items() if key not in ("schema", "version")}
        views = read_views(values.get("views"), source)
        record = jsonio.from_json(cls, {**values, "views": jsonio.to_json(views)}, source)
        if record.file_from_source is not None:
            try:
                Similarity.from_json(record.file_from_source)
            except ValueError as error:
                raise UserError(f"{source}: file_from_source: {error}") from error
        return record


@dataclass(frozen=True, slots=True, eq=False)
class SplatObject:
    """An object folder as read."""

    folder: Path
    record: ObjectRecord
    partial: Splats
    complete: Splats | None


def write_object(
    folder: Path,
    record: ObjectRecord,
    partial: Splats | None,
    complete: Splats | None = None,
    *,
    overwrite: bool = False,
    partial_file: Path | None = None,
    pictures: Mapping[str, Image.Image] | None = None,
) -> ObjectRecord:
    """Write an object folder, whole or not at all.

    Args:
        folder: the folder to create.
        record: what is known; ``counts`` and ``files`` are filled in here.
        partial: the part, finite, in the file frame. None = only the complete object is known, and
            ``complete`` must be given.
        complete: the complete object, in the same frame; None = not known.
        overwrite: replace an object folder that exists.
        partial_file: a splat PLY with exactly the part, copied instead of writing ``partial``
            anew (for crops that pass records on byte for byte).
        pictures: to store, by file name ending in ``.png``; ``preview.png`` is drawn here from six
            views, part above complete, unless it is among them.

    Returns:
        The record as written.

    Raises:
        UserError: there is no splat to write, the folder cannot be written, or it holds something
            and is not an object folder to be replaced.
    """
    if partial is None and complete is None:
        raise UserError(f"{folder}: expected a part or a complete object, found neither")
    for name, splats in ((PARTIAL_FILE, partial), (COMPLETE_FILE, complete)):
        if splats is not None and len(splats) == 0:
            raise UserError(f"{folder}: {name}: no splats are left to write")
    drawn = partial if partial is not None else complete
    assert drawn is not None
    counts = {"sh_degree": drawn.sh_degree}
    comments = (f"splatcomplete-data {record.tool_version}", f"object {record.id}")
    place = atomic_folder(
        folder,
        marker=RECORD_FILE,
        spare=PROPOSED_FILES,
        overwrite=overwrite,
        written=_written_names,
    )
    with place as temporary:
        for name, splats in ((PARTIAL_FILE, partial), (COMPLETE_FILE, complete)):
            if splats is None:
                continue
            counts[name.removesuffix(".ply")] = len(splats)
            if name == PARTIAL_FILE and partial_file is not None:
                (temporary / name).write_bytes(partial_file.read_bytes())
            else:
                write_splats(temporary / name, splats, comments)
        drawings = dict(pictures or {})
        if PREVIEW_FILE not in drawings:
            drawings[PREVIEW_FILE] = draw_preview(record, partial, complete)
        for name, picture in drawings.items():
            picture.save(temporary / name, format="PNG")
        files = {path.name: file_record(path) for path in sorted(temporary.iterdir())}
        written = dataclasses.replace(record, counts=counts, files=files)
        jsonio.write_json(temporary / RECORD_FILE, written.to_json())
    return written


def _written_names(folder: Path) -> set[str]:
    """Return the names of the files of an object folder that were written with its record."""
    names = {PARTIAL_FILE, COMPLETE_FILE, PREVIEW_FILE}
    try:
        return names | set(read_record(folder).files)
    except UserError:
        return names


def read_record(folder: Path) -> ObjectRecord:
    """Read ``object.json`` of a folder.

    Raises:
        UserError: it is missing or not what it should be.
    """
    path = folder / RECORD_FILE
    if not path.is_file():
        raise UserError(f"{folder}: expected an object folder with {RECORD_FILE}, found none")
    return ObjectRecord.from_json(jsonio.read_json(path), str(path))


def record_of_file(path: Path) -> ObjectRecord | None:
    """Return the record beside a file of an object folder, if that file is still the recorded one.

    Raises:
        UserError: the file cannot be read.
    """
    try:
        record = read_record(path.parent)
    except UserError:
        return None  # other folders may hold anything
    file = record.files.get(path.name)
    return record if file is not None and file.sha256 == sha256_of(path) else None


def read_object(folder: Path) -> SplatObject:
    """Read an object folder; hashes are ``dataset validate``'s business.

    Raises:
        UserError: a file is missing or broken.
    """
    record = read_record(folder)
    complete = None
    if COMPLETE_FILE in record.files:
        complete = read_splats(folder / COMPLETE_FILE).splats
    if PARTIAL_FILE in record.files:
        partial = read_splats(folder / PARTIAL_FILE).splats
    elif complete is not None:
        partial = complete
    else:
        raise UserError(f"{folder}: files: expected {PARTIAL_FILE}, found none")
    return SplatObject(folder, record, partial, complete)


def file_record(path: Path) -> FileRecord:
    """Return hash and size of a file."""
    return FileRecord(sha256_of(path), path.stat().st_size)


def draw_preview(
    record: ObjectRecord, partial: Splats | None, complete: Splats | None, size_px: int = 192
) -> Image.Image:
    """Draw part above complete object from six views, the input view c first."""
    from gscomplete.evaluate.pictures import contact_sheet, render_images
    from gscomplete.splats import transform_splats, usable_rows

    cameras = record.views.preview_cameras(size_px)
    rows, labels = [], []
    for name, splats in (("partial", partial), ("complete", complete)):
        if splats is None:
            continue
        drawable = splats.select(usable_rows(splats)[0])
        rows.append(
            render_images(transform_splats(drawable, record.frame.object_from_file), cameras)
        )
        labels.append(name)
    columns = [f"c + {60 * index}" if index else "c (input view)" for index in range(6)]
    return contact_sheet(
        rows, row_labels=labels, column_labels=columns, title=f"{record.id}: {record.prompt}"
    )
