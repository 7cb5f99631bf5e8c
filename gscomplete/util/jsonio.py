r"""Dataclasses to JSON and back, strictly.

Conventions
-----------
* A JSON object holds every field of its dataclass by name: nothing missing, nothing unknown.
* Numbers are finite; an integer is accepted where a float is expected, never the reverse.
* Tuples are JSON arrays; ``Path`` is a string; ``None`` is null; nested dataclasses are objects.
* A lone surrogate (a byte of a file name that is no text) is written as ``\udcff``, its escape in
  JSON, and is read back as it was.
* Files are written atomically: a reader sees the old text or the new one, never half of it.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from gscomplete.errors import UserError
from gscomplete.util.atomic import atomic_path

T = TypeVar("T")


def to_json(value: Any) -> Any:
    """Turn dataclasses, tuples, paths and numbers into plain JSON values.

    Raises:
        TypeError: a value has no JSON form here, or a number is not finite.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return {field.name: to_json(getattr(value, field.name)) for field in fields}
    if isinstance(value, dict):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(item) for item in value]
    if isinstance(value, Path):
        return value.as_posix()
    if isinstance(value, float) and not math.isfinite(value):
        raise TypeError(f"to_json: {value} is not a finite number, so it has no JSON form")
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"to_json: no JSON form for {type(value).__name__}")


def from_json(cls: type[T], data: Any, source: str) -> T:
    """Build the dataclass ``cls`` from plain JSON values.

    Args:
        cls: the dataclass to build.
        data: what ``json.loads`` returned.
        source: the file or option named in error messages.

    Raises:
        UserError: a field is missing, unknown, of the wrong type, or refused by the dataclass.
    """
    return _dataclass_from_json(cls, data, source, "")


def dumps(value: Any) -> str:
    """Write a value as indented JSON text ending in a newline, stable for a given value."""
    text = json.dumps(to_json(value), indent=2, ensure_ascii=False, allow_nan=False)
    return with_surrogates_escaped(text) + "\n"


def with_surrogates_escaped(text: str) -> str:
    """Return JSON text that UTF-8 can hold: lone surrogates become their escapes.

    Args:
        text: JSON, in which surrogates stand inside strings only.
    """
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON, replacing ``path`` in one step.

    Raises:
        UserError: the folder cannot be written.
    """
    text = dumps(value)
    with atomic_path(path) as temporary:
        Path(temporary).write_text(text, encoding="utf-8")


def has_schema(path: Path, schema: str) -> bool:
    """Tell whether a JSON file is of a kind of ours: other programs' may have the same name."""
    try:
        content = read_json(path)
    except UserError:
        return False
    return isinstance(content, dict) and content.get("schema") == schema


def read_json(path: Path) -> Any:
    """Read JSON values from a file.

    Raises:
        UserError: the file is missing, unreadable or not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: cannot read it ({error})") from error
    except json.JSONDecodeError as error:
        raise UserError(
            f"{path}: expected JSON, found something else at line {error.lineno} ({error.msg})"
        ) from error
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits, deep nesting
        raise UserError(f"{path}: expected JSON, found what cannot be held ({error})") from error


def describe(data: Any) -> str:
    """Show a value of JSON or YAML, which has dates too, briefly in an error message."""
    try:
        text = json.dumps(data, default=str, skipkeys=True)
    except (ValueError, RecursionError):  # it holds itself, or is nested too deeply
        text = f"a {type(data).__name__} that cannot be shown"
    return text if len(text) <= 40 else text[:37] + "..."


def _dataclass_from_json(cls: type[T], data: Any, source: str, where: str) -> T:
    """Build ``cls`` from ``data`` found at field path ``where`` of ``source``."""
    name = where or "the top level"
    if not isinstance(data, dict):
        raise UserError(f"{source}: {name}: expected an object, found {describe(data)}")
    hints = get_type_hints(cls)
    names = [field.name for field in dataclasses.fields(cls)]  # type: ignore[arg-type]
    unknown = sorted(set(data) - set(names))
    missing = [field for field in names if field not in data]
    if unknown:
        raise UserError(
            f"{source}: {name}: unknown field {unknown[0]!r}; expected {', '.join(names)}"
        )
    if missing:
        raise UserError(f"{source}: {name}: missing field {missing[0]!r}")
    prefix = f"{where}." if where else ""
    values = {key: _convert(hints[key], data[key], source, prefix + key) for key in names}
    try:
        return cls(**values)
    except ValueError as error:
        raise UserError(f"{source}: {name}: {error}") from error


def _convert(hint: Any, data: Any, source: str, where: str) -> Any:
    """Convert one JSON value to the type that a field's hint asks for."""
    origin = get_origin(hint)
    if origin in (Union, types.UnionType):
        return _convert_union(get_args(hint), data, source, where)
    if origin is Literal:
        if data in get_args(hint) and not isinstance(data, bool):
            return data
        choices = ", ".join(repr(choice) for choice in get_args(hint))
        raise UserError(f"{source}: {where}: expected one of {choices}, found {describe(data)}")
    if origin in (tuple, list):
        return _convert_sequence(origin, get_args(hint), data, source, where)
    if origin is dict or hint is dict:
        if not isinstance(data, dict):
            raise UserError(f"{source}: {where}: expected an object, found {describe(data)}")
        item = get_args(hint)[1] if get_args(hint) else Any
        return {key: _convert(item, value, source, f"{where}.{key}") for key, value in data.items()}
    if hint is Any:
        return data
    if dataclasses.is_dataclass(hint):
        return _dataclass_from_json(hint, data, source, where)  # type: ignore[arg-type]
    return _convert_scalar(hint, data, source, where)


def _convert_union(choices: tuple[Any, ...], data: Any, source: str, where: str) -> Any:
    """Convert to the first member of a union that fits."""
    if data is None and type(None) in choices:
        return None
    failure: UserError | None = None
    for choice in choices:
        if choice is type(None):
            continue
        try:
            return _convert(choice, data, source, where)
        except UserError as error:
            failure = error
    raise failure or UserError(f"{source}: {where}: expected null, found {describe(data)}")


def _convert_sequence(
    origin: type, items: tuple[Any, ...], data: Any, source: str, where: str
) -> Any:
    """Convert an array to a list, a homogeneous tuple or a tuple of fixed length."""
    if not isinstance(data, list):
        raise UserError(f"{source}: {where}: expected an array, found {describe(data)}")
    fixed = origin is tuple and Ellipsis not in items
    if fixed and len(data) != len(items):
        raise UserError(f"{source}: {where}: expected {len(items)} values, found {len(data)}")
    hints = items if fixed else (items[0],) * len(data)
    pairs = enumerate(zip(hints, data, strict=True))
    return origin(_convert(hint, item, source, f"{where}[{i}]") for i, (hint, item) in pairs)


def _convert_scalar(hint: Any, data: Any, source: str, where: str) -> Any:
    """Convert a number, string, boolean or path."""
    is_number = isinstance(data, int | float) and not isinstance(data, bool)
    if hint is float and is_number and _is_finite(data):
        return float(data)
    if hint is int and is_number and isinstance(data, int):
        return data
    if hint in (str, bool) and isinstance(data, hint):
        return data
    if hint is Path and isinstance(data, str):
        return Path(data)
    expected = {float: "a finite number", int: "an integer", str: "a string", Path: "a path"}
    wanted = expected.get(hint, "true or false" if hint is bool else getattr(hint, "__name__", "?"))
    raise UserError(f"{source}: {where}: expected {wanted}, found {describe(data)}")


def _is_finite(number: float) -> bool:
    """Tell whether a number is finite as a float; integers may be too large for one."""
    try:
        return math.isfinite(number)
    except OverflowError:
        return False
