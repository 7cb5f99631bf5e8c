"""What an object folder says: the contract between the data side and the method.

Conventions
-----------
* ``object.json`` holds prompt, frame of the complete object, input view c and V; ``partial.ply`` is
  P, ``complete.ply`` the complete object where it is known. The data side writes these and owns
  every other field; here only what a completion or an evaluation needs is read.
* ``frame`` is for evaluation. A completion may use its centre and size only where they are known
  without the complete object (``known_center``, ``known_size``); it may always use the up axis, c
  and V.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from gscomplete.errors import UserError
from gscomplete.util.file_names import COMPLETE_FILE, OBJECT_FILE, PARTIAL_FILE, is_plain_name
from gscomplete.util.jsonio import read_json
from gscomplete.util.parse import is_text
from gscomplete.views import FrameOrigin, GivenOfFrame, ObjectFrame, ViewDistribution

SCHEMA = "splatcomplete.object"
"""Name of the JSON form."""
SCHEMA_VERSION = 1
"""Version of the JSON form; other versions are refused."""

_ORIGINS: tuple[FrameOrigin, ...] = get_args(FrameOrigin)
_GIVEN: tuple[GivenOfFrame, ...] = get_args(GivenOfFrame)


@dataclass(frozen=True, slots=True)
class ObjectFolder:
    """An object folder, its splats not yet read."""

    folder: Path
    id: str
    """Name, unique within a dataset."""
    subset: str
    """Kind of source: multiview, singleview, lidar or mesh."""
    prompt: str
    """What the complete object is."""
    frame: ObjectFrame
    """Up axis, centre and size of the complete object in the file frame."""
    frame_origin: FrameOrigin
    """Where centre and size come from."""
    frame_given: frozenset[str]
    """Which of "center" and "size" the user gave."""
    views: ViewDistribution
    """Input view c and view distribution V."""
    files: frozenset[str]
    """Names of the files that it records."""

    @property
    def partial(self) -> Path:
        """File of P."""
        return self.folder / PARTIAL_FILE

    @property
    def complete(self) -> Path | None:
        """File of the complete object; None where it is not known."""
        return self.folder / COMPLETE_FILE if COMPLETE_FILE in self.files else None

    @property
    def known_center(self) -> tuple[float, float, float] | None:
        """The frame's centre if the user gave it; None if it is the truth's or a guess."""
        return self.frame.center_file if "center" in self.frame_given else None

    @property
    def known_size(self) -> float | None:
        """The frame's size if the user gave it; None if it is the truth's or a guess."""
        return self.frame.size_file if "size" in self.frame_given else None


def read_object_folder(folder: Path) -> ObjectFolder:
    """Read ``object.json`` of a folder.

    Args:
        folder: an object folder.

    Returns:
        What ``object.json`` says; files are named, not opened.

    Raises:
        UserError: it is missing, of another schema, or lacks what is read here.
    """
    path = folder / OBJECT_FILE
    if not path.is_file():
        raise UserError(f"{folder}: expected an object folder with {OBJECT_FILE}, found none")
    data = read_json(path)
    if not isinstance(data, dict):
        raise UserError(f"{path}: expected an object, found {type(data).__name__}")
    for name, expected in (("schema", SCHEMA), ("version", SCHEMA_VERSION)):
        if data.get(name) != expected:
            raise UserError(f"{path}: {name}: expected {expected!r}, found {data.get(name)!r}")
    origin = data.get("frame_origin")
    if origin not in _ORIGINS:
        expected = ", ".join(_ORIGINS)
        raise UserError(f"{path}: frame_origin: expected one of {expected}, found {origin!r}")
    given = data.get("frame_given")
    if given is None:
        given = list(_GIVEN) if origin == "given" else []
    if not isinstance(given, list) or any(name not in _GIVEN for name in given):
        expected = ", ".join(_GIVEN)
        raise UserError(f"{path}: frame_given: expected some of {expected}, found {given!r}")
    object_id = data.get("id")
    if not is_plain_name(object_id):
        raise UserError(f"{path}: id: expected a plain name, found {object_id!r}")
    files = data.get("files")
    if not isinstance(files, dict):
        raise UserError(f"{path}: files: expected an object, found {files!r}")
    return ObjectFolder(
        folder,
        object_id,
        _text(data, "subset", path),
        _text(data, "prompt", path),
        ObjectFrame.from_json(data.get("frame"), f"{path}: frame"),
        origin,
        frozenset(given),
        ViewDistribution.from_json(data.get("views"), f"{path}: views"),
        frozenset(files),
    )


def object_folder_of(path: Path) -> ObjectFolder | None:
    """Return the object folder that a path means: the folder itself, or any file that it records.

    Files that happen to lie beside an ``object.json`` without being recorded in it mean themselves.

    Args:
        path: a folder or a file.

    Returns:
        What the folder's ``object.json`` says; None = the path means none.

    Raises:
        UserError: the path means an object folder whose ``object.json`` cannot be read.
    """
    if path.is_dir() or path.name == OBJECT_FILE:
        folder = path if path.is_dir() else path.parent
        return read_object_folder(folder) if (folder / OBJECT_FILE).is_file() else None
    beside = path.with_name(OBJECT_FILE)
    if not (path.is_file() and beside.is_file()) or not _is_ours(beside):
        return None
    found = read_object_folder(path.parent)
    return found if path.name in found.files else None


def _is_ours(path: Path) -> bool:
    """Tell whether a file called object.json is one of ours: other programs may call theirs so."""
    try:
        data = read_json(path)
    except UserError:
        return False
    return isinstance(data, dict) and data.get("schema") == SCHEMA


def _text(data: dict[str, Any], name: str, path: Path) -> str:
    """Return a text field that is not empty."""
    value = data.get(name)
    if not isinstance(value, str) or not value.strip() or not is_text(value):
        raise UserError(f"{path}: {name}: expected a text, found {value!r}")
    return value
