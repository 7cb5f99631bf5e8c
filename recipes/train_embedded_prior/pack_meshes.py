"""Pack a folder of meshes to train on: ``python -m recipes.train_embedded_prior.pack_meshes``.

``--meshes FOLDER --out PACK --licence CC0-1.0`` reads every mesh file of a folder and its
subfolders as ``splatcomplete-data mesh`` does, turns it upright, reduces it to few faces and a
small texture, and adds it to the pack. The same command goes on where it was stopped, and makes
anew what has changed. Each file should hold one object.

Conventions
-----------
* An object's id is made of SOURCE and the file's path within FOLDER, its caption of the last part
  of that path that says anything ("chairs/red_stool/model.obj": "red stool"), its noun of the
  caption. ``--words`` says it better.
* Objects are held out by their noun, all or none: a function of the noun alone.
* A texture that changes beside its mesh is not noticed: remove the object's file to make it anew.
"""

from __future__ import annotations

import csv
import hashlib
import math
import multiprocessing
import re
import sys
import zipfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from gscomplete.errors import UserError
from gscomplete.shape.bank.nouns import head_noun
from gscomplete.util.atomic import atomic_path
from gscomplete.views import parse_up, up_rotation
from recipes.entry_point import start
from recipes.train_embedded_prior.data.mesh_pack import MANIFEST, PackEntry
from recipes.train_embedded_prior.data.pack_writer import MOST_FACES, packed, write_packed
from splatcomplete_data.mesh.files.file_checks import GLTF_SUFFIXES
from splatcomplete_data.mesh.files.load import load_mesh
from splatcomplete_data.mesh.files.up_axis import up_of_mesh_file

_SUFFIXES = (".glb", ".gltf", ".obj", ".dae", ".ply", ".stl", ".off", ".3mf")
"""If files differ only in their suffix, the one whose suffix stands first is taken."""
_SAYS_NOTHING = frozenset(
    ("model", "mesh", "meshes", "textured", "scene", "object", "visual", "nontextured", "models")
)
"""Words that are left out of captions."""
_COLUMNS = (
    *("id", "split", "noun", "caption", "source", "licence", "author", "colour"),
    *("faces", "faces_source", "size_m", "origin"),
)
_WORDS_COLUMNS = ("noun", "caption", "split", "licence", "author")
_READER_VERSION = 1
"""When this number changes, every object is made anew."""


@dataclass(frozen=True)
class Options:
    """Pack a folder of meshes."""

    meshes: Path
    """Folder of mesh files."""
    out: Path
    """Folder of the pack; objects are added to those that it has."""
    licence: str
    """Licence of the meshes, as their authors state it, such as CC0-1.0; weights' cards name it."""
    author: str = ""
    """Author to name, as CC-BY asks."""
    source: str | None = None
    """Source of the meshes, the first part of ids; None = the folder's name."""
    words: Path | None = None
    """Table (.tsv or .csv) with a column path (within FOLDER) and any of noun, caption, split,
    licence, author; empty cells count as missing. None = by names."""
    up: str | None = None
    """Axis of the files that points up, such as Y; None = as each format says, else Z."""
    validation_share: float = 0.0
    """About this share of the nouns is held out (split ``validation``), in [0, 1]."""
    faces: int = 4000
    """Meshes with more faces are decimated to about so many."""
    workers: int = 2
    """Processes, at least one."""


_Result = tuple[dict[str, str] | None, str]
"""A row of the manifest, or None if the mesh could not be packed, and a message for the user."""


@dataclass(frozen=True, slots=True)
class _Task:
    """One mesh file to pack."""

    path: Path
    folder: Path
    """Folder in which textures may lie."""
    out: Path
    entry: PackEntry
    up: str | None
    faces: int


def main(options: Options) -> int:
    """Run from the command line; the exit code is 1 if a file could not be packed."""
    tasks = list(_tasks(options))
    if not tasks:
        suffixes = ", ".join(_SUFFIXES)
        raise UserError(f"{options.meshes}: expected mesh files ({suffixes}), found none")
    options.out.mkdir(parents=True, exist_ok=True)
    rows = _rows_of(options.out)
    failed = 0
    console = Console(file=sys.stderr)
    results = _results(tasks, options.workers)
    for task in track(tasks, "meshes", console=console):
        row, told = next(results)
        if told:
            console.print(f"{task.path}: {told}", markup=False, soft_wrap=True)
        if row is None:
            failed += 1
        else:
            rows[row["id"]] = row
    _write_rows(options.out, rows)
    done = len(tasks) - failed
    sys.stdout.write(f"{done} of {len(tasks)} meshes packed, {len(rows)} in {options.out}\n")
    return 1 if failed else 0


def _results(tasks: list[_Task], workers: int) -> Iterator[_Result]:
    """Pack meshes in so many processes, or in this one if it is one; yield results in order.

    Raises:
        UserError: a process was killed.
    """
    if workers == 1:
        yield from map(_made, tasks)
        return
    try:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, mp_context=context) as pool:
            yield from pool.map(_made, tasks)
    except BrokenProcessPool as error:
        hint = "with --workers 1 progress stops at the mesh to blame"
        raise UserError(f"a mesh killed the process that packed it (memory?): {hint}") from error


def _tasks(options: Options) -> Iterator[_Task]:
    """Yield the tasks of all meshes, in the order of their paths.

    Raises:
        UserError: an option or the table of words is wrong, or two files have the same id.
    """
    if not options.meshes.is_dir():
        raise UserError(f"{options.meshes}: expected a folder of mesh files, found none")
    if not 0.0 <= options.validation_share <= 1.0:
        raise UserError(f"--validation-share: expected 0 to 1, found {options.validation_share}")
    if not 4 <= options.faces <= MOST_FACES:
        raise UserError(f"--faces: expected 4 to {MOST_FACES}, found {options.faces}")
    if options.workers < 1:
        raise UserError(f"--workers: expected 1 or more, found {options.workers}")
    parse_up(options.up)
    source = _plain(options.source or options.meshes.resolve().name)
    words = {} if options.words is None else _words(options.words)
    taken: dict[str, Path] = {}
    for path in _mesh_files(options.meshes):
        relative = path.relative_to(options.meshes)
        parts = [*relative.parent.parts, relative.stem]
        id_ = f"{source}/{_plain('_'.join(parts))}"
        if id_ in taken:
            if taken[id_].with_suffix("") == path.with_suffix(""):
                continue
            raise UserError(f"{path}: its id would be {id_}, as that of {taken[id_]}: rename it")
        taken[id_] = path
        given = words.pop(relative.as_posix(), {})
        names = (_caption(part) for part in reversed(parts))
        caption = given.get("caption") or next(filter(None, names), relative.stem.lower())
        noun = given.get("noun") or head_noun(caption) or caption
        split = "validation" if _chance(noun) < options.validation_share else "train"
        entry = PackEntry(
            id=id_, split=given.get("split") or split, noun=noun, caption=caption, source=source,
            licence=given.get("licence") or options.licence,
            author=given.get("author") or options.author, colour="",
        )  # fmt: skip
        yield _Task(path, options.meshes, options.out, entry, options.up, options.faces)
    if words:
        raise UserError(f"{options.words}: {next(iter(words))}: no such mesh file")


def _made(task: _Task) -> _Result:
    """Pack one mesh, unless it is packed already."""
    target = task.out / f"{task.entry.id}.npz"
    try:
        up = parse_up(task.up) or up_of_mesh_file(task.path)
        digest = hashlib.sha256(task.path.read_bytes())
        digest.update(f"{_READER_VERSION} {up} {task.faces}".encode())
        told = ""
        if _stored(target).get("made_of") != digest.hexdigest():
            mesh = load_mesh(task.path, allow_outside=task.folder)
            result = packed(mesh, up_rotation(up).double().numpy(), task.faces)
            unit_m = 1.0 if task.path.suffix.lower() in GLTF_SUFFIXES else math.nan
            write_packed(target, result, unit_m=unit_m, made_of=digest.hexdigest())
            told = "; ".join(mesh.notes)
        stored = _stored(target)
        entry = task.entry
        row = {name: getattr(entry, name) for name in PackEntry.__dataclass_fields__}
        row |= {name: stored[name] for name in ("colour", "faces", "faces_source", "size_m")}
        return row | {"origin": task.path.name}, told
    except UserError as error:
        return None, str(error).removeprefix(f"{task.path}: ")
    except OSError as error:
        return None, f"cannot be read ({error})"


def _stored(path: Path) -> dict[str, str]:
    """Return what an object's file says about itself; nothing if it is missing or damaged."""
    try:
        with np.load(path) as file:
            told = {
                name: str(file[name]) for name in ("made_of", "colour", "faces_source", "size_m")
            }
            return told | {"faces": str(len(file["f"]))}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return {}


def _mesh_files(folder: Path) -> list[Path]:
    """Return the mesh files in a folder and its subfolders, without hidden ones."""
    found = [
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in _SUFFIXES
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    ]
    return sorted(found, key=lambda p: (p.with_suffix(""), _SUFFIXES.index(p.suffix.lower())))


def _words(path: Path) -> dict[str, dict[str, str]]:
    """Read the table of words; return the words of each path.

    Raises:
        UserError: it cannot be read, or a column is missing or unknown.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: expected a table of words ({error})") from None
    delimiter = "," if path.suffix.lower() == ".csv" else "\t"
    reader = csv.DictReader(text.splitlines(), delimiter=delimiter)
    columns = set(reader.fieldnames or ())
    if "path" not in columns or columns - {"path", *_WORDS_COLUMNS}:
        expected = ", ".join(_WORDS_COLUMNS)
        found = ", ".join(sorted(columns)) or "none"
        raise UserError(f"{path}: expected the column path and any of {expected}, found {found}")
    return {row["path"]: {k: v for k, v in row.items() if k != "path" and v} for row in reader}


def _rows_of(pack: Path) -> dict[str, dict[str, str]]:
    """Return the rows that the pack has so far, by id."""
    path = pack / MANIFEST
    if not path.is_file():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE)
        return {row["id"]: row for row in reader}


def _write_rows(pack: Path, rows: dict[str, dict[str, str]]) -> None:
    """Write the manifest, in the order of ids."""
    further = {name for row in rows.values() for name in row} - set(_COLUMNS)
    with (
        atomic_path(pack / MANIFEST) as temporary,
        temporary.open("w", encoding="utf-8", newline="") as file,
    ):
        file.write("\t".join((*_COLUMNS, *sorted(further))) + "\n")
        for id_ in sorted(rows):
            cells = (rows[id_].get(name, "") for name in (*_COLUMNS, *sorted(further)))
            file.write("\t".join(re.sub(r"\s+", " ", cell) for cell in cells) + "\n")


def _caption(name: str) -> str:
    """Return the words of a name that say something: "red stool" for "RedStool_02"."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])|[\W\d_]+", " ", name).lower().split()
    return " ".join(word for word in words if len(word) > 1 and word not in _SAYS_NOTHING)


def _plain(name: str) -> str:
    """Return a name made of lower-case letters, digits and underscores."""
    return re.sub(r"\W+", "_", name.lower()).strip("_") or "_"


def _chance(noun: str) -> float:  # in [0, 1)
    """Return a number that depends only on the noun and is evenly distributed over nouns."""
    return int.from_bytes(hashlib.sha256(noun.encode()).digest()[:6], "big") / 2**48


if __name__ == "__main__":
    start(main, Options, __doc__)
