"""Which objects a batch has: planned from a manifest, a dataset, or a folder.

Conventions
-----------
* A manifest is a text file with one object a line: JSON objects (``.jsonl``), or a table with names
  in its first line (``.csv``, ``.tsv``). ``partial`` names a splat file or an object folder,
  relative to the manifest's folder, absolute, or a URL; ``id`` names the object's run folder (else
  the name of ``partial``); every other field is an option of that object alone.
* A dataset is a folder with ``dataset.json``. Of any other folder, the folders in it with an
  ``object.json`` are the objects, and the PLY files in it.
* Planning opens only the manifest. Whatever is wrong with an object shows when it is done, and
  fails that object alone.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any

from gscomplete.batch import storage
from gscomplete.errors import UserError
from gscomplete.util.file_names import (
    DATASET_FILE,
    OBJECT_FILE,
    SPLAT_SUFFIXES,
    is_plain_name,
    splat_stem,
)

FieldKind = type[str] | type[float] | type[int] | tuple[str, ...]
"""Of an option: its type, or the texts that it may be."""
_KINDS: dict[object, str] = {str: "a text", float: "a number", int: "an integer"}


@dataclass(frozen=True, slots=True)
class Item:
    """One object of a batch."""

    id: str
    """Name of its run folder."""
    source: str
    """Splat file or object folder: absolute path or URL."""
    options: dict[str, Any] = field(default_factory=dict)
    """Options of this object alone, by name."""


def plan(source: str, fields: Mapping[str, FieldKind]) -> list[Item]:
    """Return the objects of a manifest, dataset or folder, in its order.

    Args:
        source: path or URL.
        fields: options that a manifest may give to an object, with their types.

    Raises:
        UserError: there is no object, two have one name, or a line is wrong.
    """
    source = storage.absolute(source)
    suffix = PurePosixPath(source).suffix.lower()
    if suffix in (".jsonl", ".csv", ".tsv"):
        items = _from_manifest(source, suffix, fields)
    else:
        items = _from_folder(source)
    if not items:
        raise UserError(
            f"{source}: expected objects ({OBJECT_FILE} in folders, splat files "
            f"{', '.join(SPLAT_SUFFIXES)}, or a manifest .jsonl, .csv, .tsv), found none"
        )
    return items


def _from_folder(folder: str) -> list[Item]:
    """Return the objects of a dataset or of another folder.

    Raises:
        UserError: there is no such folder, or its ``dataset.json`` is damaged.
    """
    if PurePosixPath(folder).name == DATASET_FILE:
        folder = folder.rpartition("/")[0]
    listed = storage.list_folder(folder)
    if listed is None:
        raise UserError(f"{folder}: expected a folder, a dataset or a manifest, found none")
    files, _ = listed
    if DATASET_FILE in files:
        return [Item(name, storage.join(folder, name)) for name in _dataset_ids(folder)]
    items = [
        Item(name, storage.join(folder, name))
        for name in storage.folders_with(folder, OBJECT_FILE)
        if not name.startswith(".")
    ]
    for name in sorted(files):
        stem = splat_stem(name)
        if stem is not None:
            items.append(Item(stem, storage.join(folder, name)))
    return list(_checked(folder, items))


def _dataset_ids(folder: str) -> list[str]:
    """Return the names of a dataset's objects.

    Raises:
        UserError: ``dataset.json`` is damaged.
    """
    path = storage.join(folder, DATASET_FILE)
    try:
        rows = json.loads(storage.read_text(path) or "")["objects"]
        names = [row["id"] for row in rows]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise UserError(f"{path}: objects: expected a list with ids, found none") from error
    return [item.id for item in _checked(path, (Item(name, "") for name in names))]


def _from_manifest(path: str, suffix: str, fields: Mapping[str, FieldKind]) -> list[Item]:
    """Return the objects of a manifest.

    Raises:
        UserError: it is not there, or a line is wrong.
    """
    text = storage.read_text(path)
    if text is None:
        raise UserError(f"{path}: no such file")
    folder = path.rpartition("/")[0]
    rows = _json_rows(path, text) if suffix == ".jsonl" else _table_rows(path, text, suffix)
    items = (_item(f"{path}:{line}", folder, row, fields) for line, row in rows)
    return list(_checked(path, items))


def _json_rows(path: str, text: str) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the objects of a JSONL file with their lines.

    Raises:
        UserError: a line is no JSON object.
    """
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        try:
            row = json.loads(line, object_pairs_hook=_each_once)
        except (ValueError, RecursionError) as error:
            raise UserError(f"{path}:{number}: expected a JSON object ({error})") from error
        if not isinstance(row, dict):
            raise UserError(f"{path}:{number}: expected a JSON object, found {line[:40]}")
        yield number, row


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Make a JSON object of its names and values.

    Raises:
        ValueError: a name is there twice.
    """
    row = dict(pairs)
    names = [name for name, _ in pairs]
    if len(row) < len(pairs):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"expected every name once, found {twice!r} again")
    return row


def _table_rows(path: str, text: str, suffix: str) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the rows of a table with their line numbers; an empty cell counts as not given.

    Raises:
        UserError: a name is there twice, a row has more cells than the first line, or a quote is
            not closed.
    """
    delimiter = "\t" if suffix == ".tsv" else ","
    reader = csv.DictReader(io.StringIO(text), delimiter=delimiter, strict=True)
    try:
        names = list(reader.fieldnames or ())
        twice = sorted({name for name in names if name and names.count(name) > 1})
        if twice:
            raise UserError(f"{path}:1: expected every name once, found {twice[0]!r} again")
        for row in reader:
            if None in row:
                raise UserError(f"{path}:{reader.line_num}: more cells than names in line 1")
            yield reader.line_num, {name: value for name, value in row.items() if value}
    except csv.Error as error:
        hint = " (is a quote not closed?)" if "unexpected end" in str(error) else ""
        raise UserError(f"{path}:{reader.line_num + 1}: {error}{hint}") from error


def _item(where: str, folder: str, row: dict[str, Any], fields: Mapping[str, FieldKind]) -> Item:
    """Turn a row of a manifest into an object.

    Raises:
        UserError: a field is missing, unknown or of the wrong type.
    """
    row = dict(row)
    partial = row.pop("partial", None)
    if not isinstance(partial, str) or not partial:
        raise UserError(f"{where}: partial: expected a splat file or object folder, found none")
    partial = partial.rstrip("/")
    name = row.pop("id", None)
    if name is None:
        last = partial.rpartition("/")[2]
        name = splat_stem(last) or last
    is_complete = storage.is_url(partial) or partial.startswith("/")
    source = partial if is_complete else storage.join(folder, partial)
    options = {
        key: _value(where, key, value, fields) for key, value in row.items() if value is not None
    }
    return Item(name, source, options)


def _value(where: str, key: str, value: Any, fields: Mapping[str, FieldKind]) -> Any:
    """Return an option's value in its type.

    Raises:
        UserError: there is no such option, or the value is of another type.
    """
    kind = fields.get(key)
    if kind is None:
        known = ", ".join(("id", "partial", *fields))
        raise UserError(f"{where}: unknown field {key!r}; expected {known}")
    if isinstance(kind, tuple):
        if value in kind:
            return value
        raise UserError(f"{where}: {key}: expected one of {', '.join(kind)}, found {value!r}")
    if kind is str and isinstance(value, str):
        return value
    if kind is not str and isinstance(value, str | int | float) and not isinstance(value, bool):
        try:
            number = kind(value)
        except (ValueError, OverflowError):
            number = None
        if number is not None and (isinstance(value, str) or number == value):
            return number
    raise UserError(f"{where}: {key}: expected {_KINDS[kind]}, found {value!r}")


def _checked(where: str, items: Iterable[Item]) -> Iterator[Item]:
    """Check that every object's name can be a folder's name, and that no two are the same.

    Raises:
        UserError: a name cannot be a folder's, or occurs twice.
    """
    seen: set[str] = set()
    for item in items:
        name = item.id
        if not is_plain_name(name):
            raise UserError(f"{where}: id: expected a plain name, found {name!r}")
        if name in seen:
            raise UserError(f"{where}: id: expected each name once, found {name!r} twice")
        seen.add(name)
        yield item
