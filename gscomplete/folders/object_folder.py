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

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from gscomplete.errors import UserError
from gscomplete.util.digests import sha256_of
from gscomplete.util.file_names import COMPLETE_FILE, OBJECT_FILE, PARTIAL_FILE, is_plain_name
from gscomplete.util.jsonio import has_schema, read_json
from gscomplete.util.parse import has_controls, is_text
from gscomplete.views import FrameOrigin, GivenOfFrame, ObjectFrame, ViewDistribution

SCHEMA = "splatcomplete.object"
"""Name of the JSON form."""
SCHEMA_VERSION = 1
"""Version of the JSON form; other versions are refused."""

Subset = Literal["multiview", "singleview", "lidar", "mesh"]
"""Kinds of source, as in the paper's section "Dataset"."""

_SUBSETS: tuple[Subset, ...] = get_args(Subset)
_ORIGINS: tuple[FrameOrigin, ...] = get_args(FrameOrigin)
_GIVEN: tuple[GivenOfFrame, ...] = get_args(GivenOfFrame)
_HALF_DIAGONAL = math.sqrt(3) / 2
"""Of a cube that holds the object, object sizes."""


@dataclass(frozen=True, slots=True)
class ObjectFolder:
    """An object folder, its splats not yet read."""

    folder: Path
    id: str
    """Name, unique within a dataset."""
    subset: Subset
    """Kind of source."""
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
    digests: Mapping[str, str] = field(default_factory=dict, compare=False)
    """SHA-256 of these files by their names, where it is recorded."""

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

    def is_replaced(self, path: Path) -> bool:
        """Tell whether one of its files is there, but not the one that was recorded."""
        digest = self.digests.get(path.name)
        return digest is not None and path.is_file() and sha256_of(path) != digest


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
    subset = data.get("subset")
    if subset not in _SUBSETS:
        expected = ", ".join(_SUBSETS)
        raise UserError(f"{path}: subset: expected one of {expected}, found {subset!r}")
    return ObjectFolder(
        folder,
        object_id,
        subset,
        _text(data, "prompt", path),
        ObjectFrame.from_json(data.get("frame"), f"{path}: frame"),
        origin,
        frozenset(given),
        read_views(data.get("views"), str(path)),
        frozenset(files),
        _digests(files),
    )


def read_views(data: Any, source: str) -> ViewDistribution:
    """Read the view distribution of an object, whose views see it.

    Args:
        data: JSON values.
        source: the file named in errors.

    Returns:
        Input view c and V.

    Raises:
        UserError: a field is missing, unknown or wrong, or the views look past the object.
    """
    views = ViewDistribution.from_json(data, f"{source}: views")
    seen = views.radius * math.tan(math.radians(views.fov_deg / 2))  # to either side of the target
    limit = seen + _HALF_DIAGONAL
    if not math.hypot(*views.target) <= limit:
        found = ",".join(f"{value:g}" for value in views.target)
        raise UserError(
            f"{source}: views: target: expected a point from which the object is in sight, at most "
            f"{limit:.3g} object sizes from its centre, found {found}"
        )
    return views


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
    if not (path.is_file() and beside.is_file()) or not has_schema(beside, SCHEMA):
        return None
    found = read_object_folder(path.parent)
    return found if path.name in found.files else None


def _digests(files: dict[str, Any]) -> dict[str, str]:
    """Return the SHA-256 of the files of which it is recorded."""
    found = {name: file.get("sha256") for name, file in files.items() if isinstance(file, dict)}
    return {name: digest for name, digest in found.items() if isinstance(digest, str)}


def _text(data: dict[str, Any], name: str, path: Path) -> str:
    """Return a text field that is not empty and can be shown."""
    value = data.get(name)
    if not isinstance(value, str) or not value.strip() or not is_text(value):
        raise UserError(f"{path}: {name}: expected a text, found {value!r}")
    if has_controls(value):
        raise UserError(
            f"{path}: {name}: expected a text without control characters, found {value!r}"
        )
    return value
