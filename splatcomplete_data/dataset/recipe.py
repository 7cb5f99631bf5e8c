"""Recipe files: which objects a dataset has, and the command and options that make each.

Conventions
-----------
* A recipe is YAML: ``schema: splatcomplete.recipe``, ``version: 1``, ``name``, an optional list
  ``captures`` and a list ``objects``. Every entry has an ``id``, a ``command`` (that of
  ``splatcomplete-data``), and that command's options by their names in Python (``seed_point``, not
  ``--seed-point``); positional ones too (``file``, ``image``, ``depth``, ``images``).
* Paths are relative to the data folder given to ``build``. ``capture:ID`` names what a capture
  wrote; captures are made before all objects and are no part of the dataset.
* Options are checked before anything is built: an unknown one is an error that names the entry.
* A recipe names nothing outside the data folder, unless the user allows it (``named_files``). Links
  within the data folder are the user's, and followed.
"""

from __future__ import annotations

import dataclasses
import importlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gscomplete.errors import UserError
from gscomplete.util import jsonio
from gscomplete.util.file_names import DATASET_FILE, OBJECT_FILE, is_plain_name
from splatcomplete_data.cuts.boxes import BOXES_SUFFIX
from splatcomplete_data.cuts.named import parse_cut
from splatcomplete_data.dataset.plain_yaml import read_yaml

SCHEMA = "splatcomplete.recipe"
SCHEMA_VERSION = 1
CAPTURE_PREFIX = "capture:"
OBJECT_COMMANDS = {
    "crop": "CropOptions",
    "depth": "DepthOptions",
    "mesh": "MeshOptions",
    "partial": "PartialOptions",
    "scan": "ScanOptions",
}
CAPTURE_COMMANDS = {"images": "ImagesOptions"}
_RENAMED = {"size": "splat_size", "size_whole": "object_size"}
"""Old names of options, which are understood for one version."""
_TAKEN_IDS = (DATASET_FILE, OBJECT_FILE)
"""Names that say what a dataset folder is, in any case, as some file systems know none."""
_RESERVED = ("out", "json", "overwrite", "resume", "propose", "pick", "allow_outside")


@dataclass(frozen=True, slots=True)
class Entry:
    """One object, or one capture, of a recipe."""

    id: str
    command: str
    values: dict[str, Any]
    """Options by name, as in the recipe."""
    is_capture: bool = False

    def options(self, out: Path, captures: Path) -> Any:
        """Return the command's options, writing to ``out``.

        Args:
            out: the folder to write.
            captures: the folder of all captures, for ``capture:ID``.

        Raises:
            UserError: an option is unknown or of the wrong type, or no cut is called so.
        """
        table = CAPTURE_COMMANDS if self.is_capture else OBJECT_COMMANDS
        module = importlib.import_module(f"splatcomplete_data.cli.{self.command}")
        cls = getattr(module, table[self.command])
        values = {}
        for field in dataclasses.fields(cls):
            if field.default is not dataclasses.MISSING:
                values[field.name] = jsonio.to_json(field.default)
        for word, value in self.values.items():
            name = _RENAMED.get(word, word)
            is_capture = isinstance(value, str) and value.startswith(CAPTURE_PREFIX)
            values[name] = (
                str(captures / value.removeprefix(CAPTURE_PREFIX)) if is_capture else value
            )
        known = [field.name for field in dataclasses.fields(cls)]
        unknown = sorted(set(values) - set(known))
        if unknown:
            expected = ", ".join(name for name in known if name not in (*_RESERVED, "id"))
            raise UserError(
                f"recipe entry {self.id!r}: unknown option {unknown[0]!r}; expected {expected}"
            )
        values |= {"out": str(out)} | ({} if self.is_capture else {"id": self.id})
        options = jsonio.from_json(cls, values, f"recipe entry {self.id!r}")
        for text in getattr(options, "cut", ()):
            parse_cut(text)
        return options

    def captures(self) -> tuple[str, ...]:
        """Return the ids of the captures that the entry needs."""
        found = [v for v in self.values.values() if isinstance(v, str)]
        return tuple(v.removeprefix(CAPTURE_PREFIX) for v in found if v.startswith(CAPTURE_PREFIX))

    def check_reach(self, data: Path, allowed: Path | None) -> None:
        """Check that the options name no path outside the data folder.

        Args:
            data: the data folder.
            allowed: a folder below which paths may be, too.

        Raises:
            UserError: one does; the message names it.
        """
        folders = [os.path.abspath(folder) for folder in (data, allowed) if folder is not None]
        options = self.options(Path("out"), data)  # what captures write counts as below data
        named = [("box", text) for text in _box_files(self.values)]
        for field in dataclasses.fields(options):
            value = getattr(options, field.name)
            is_path = isinstance(value, Path) or field.name == "poses"
            if field.name != "out" and is_path:
                named.append((field.name, value))
        for name, value in named:
            path = os.path.abspath(data / value)
            if not any(os.path.commonpath([path, folder]) == folder for folder in folders):
                raise UserError(
                    f"recipe entry {self.id!r}: {name}: {value} lies outside {folders[0]} "
                    f"and is not read (to read it: --allow-outside {os.path.dirname(path)})"
                )

    def sources(self, data: Path) -> tuple[Path, ...]:
        """Return the files and folders below ``data`` that the options name."""
        texts = [v for v in self.values.values() if isinstance(v, str) and "\n" not in v]
        texts += _box_files(self.values)
        paths = [data / text for text in texts if text and len(text) < 1000]
        return tuple(path for path in paths if path.exists() and path != data)


@dataclass(frozen=True, slots=True)
class Recipe:
    """A recipe as read."""

    name: str
    captures: tuple[Entry, ...]
    objects: tuple[Entry, ...]


def read_recipe(path: Path) -> Recipe:
    """Read and check a recipe.

    Raises:
        UserError: it is missing, no YAML, or an entry is wrong; the message names the entry.
    """
    data = read_yaml(path, "reading recipes")
    if not isinstance(data, dict):
        raise UserError(f"{path}: expected a mapping, found {type(data).__name__}")
    for name, expected in (("schema", SCHEMA), ("version", SCHEMA_VERSION)):
        if data.get(name) != expected:
            found = jsonio.describe(data.get(name))
            raise UserError(f"{path}: {name}: expected {expected!r}, found {found}")
    unknown = sorted(set(map(str, data)) - {"schema", "version", "name", "captures", "objects"})
    if unknown:
        raise UserError(f"{path}: unknown field {unknown[0]!r}")
    captures = _entries(path, data.get("captures") or [], is_capture=True)
    objects = _entries(path, data.get("objects") or [], is_capture=False)
    if not objects:
        raise UserError(f"{path}: objects: expected at least one, found none")
    known = {entry.id for entry in captures}
    for entry in objects:
        if entry.id in known:  # they would share one state of the build
            raise UserError(f"{path}: {entry.id}: expected each id once, found a capture's too")
    for entry in objects:
        for needed in entry.captures():
            if needed not in known:
                raise UserError(f"{path}: {entry.id}: no capture is called {needed!r}")
    name = data.get("name") or path.stem
    if isinstance(name, list | dict):
        raise UserError(f"{path}: name: expected a text, found {jsonio.describe(name)}")
    return Recipe(str(name), captures, objects)


def _box_files(values: dict[str, Any]) -> list[str]:
    """Return the files of boxes that an entry's options name."""
    return [text for text in values.get("box", ()) if text.endswith(BOXES_SUFFIX)]


def _entries(path: Path, rows: Any, *, is_capture: bool) -> tuple[Entry, ...]:
    """Check a list of entries."""
    if not isinstance(rows, list):
        raise UserError(f"{path}: expected a list of entries, found {type(rows).__name__}")
    commands = CAPTURE_COMMANDS if is_capture else OBJECT_COMMANDS
    entries: list[Entry] = []
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, dict) or "id" not in row:
            found = f"expected a mapping with an id, found {jsonio.describe(row)}"
            raise UserError(f"{path}: entry {number}: {found}")
        name, command = row["id"], row.get("command")
        if not is_plain_name(name):
            hint = "" if isinstance(name, str) else ", which is no text (put it in quotes)"
            found = f"expected a plain name, found {jsonio.describe(name)}{hint}"
            raise UserError(f"{path}: entry {number}: id: {found}")
        if not is_capture and name.lower() in _TAKEN_IDS:
            found = f"expected another name than the dataset's {' and '.join(_TAKEN_IDS)}"
            raise UserError(f"{path}: entry {number}: id: {found}, found {name!r}")
        if name in [entry.id for entry in entries]:
            raise UserError(f"{path}: {name}: expected each id once, found it twice")
        if not isinstance(command, str) or command not in commands:
            found = f"expected one of {', '.join(commands)}, found {jsonio.describe(command)}"
            raise UserError(f"{path}: {name}: command: {found}")
        values = {str(k): v for k, v in row.items() if k not in ("id", "command")}
        reserved = sorted(set(values) & set(_RESERVED))
        if reserved:
            raise UserError(f"{path}: {name}: {reserved[0]}: set by build, not by a recipe")
        entry = Entry(name, command, values, is_capture)
        try:
            entry.options(Path("out"), Path("captures"))
        except UserError as error:
            raise UserError(f"{path}: {error}") from error
        entries.append(entry)
    return tuple(entries)
