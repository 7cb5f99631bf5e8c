"""Files of a batch: on this machine, or in any store that fsspec has a file system for.

Conventions
-----------
* A path with ``://`` in it is a URL, and fsspec (an optional dependency) reads and writes it; any
  other is a path of this machine. fsspec finds credentials and endpoints by itself
  (``AWS_ACCESS_KEY_ID``, ``AWS_ENDPOINT_URL``, ``FSSPEC_S3_...``).
* On this machine, a folder is published in one step, by a rename. A store has no such step: files
  are copied one by one, a marker file last, and a folder without its marker is not a result.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from gscomplete.errors import UserError

Signature = tuple[int, str]
"""Bytes of a file, and the time of its last change or the store's tag of its content."""


def is_url(path: str) -> bool:
    """Tell whether a path is one that fsspec is asked for."""
    return "://" in path


def absolute(path: str) -> str:
    """Return a path that other processes understand; URLs stay as they are, without a last "/"."""
    return path.rstrip("/") if is_url(path) else os.path.abspath(path)


def join(folder: str, name: str) -> str:
    """Return the path of a name in a folder."""
    return f"{folder.rstrip('/')}/{name}"


def read_text(path: str, errors: Literal["strict", "replace"] = "strict") -> str | None:
    """Return a file's text without a byte order mark; None where there is no such file.

    Args:
        path: path or URL.
        errors: whether bytes that are no text are refused, or read as U+FFFD.

    Raises:
        UserError: it cannot be read, or is no text.
    """
    try:
        if is_url(path):
            with _store(path) as (system, inner):
                return str(system.cat_file(inner).decode("utf-8-sig", errors))
        return Path(path).read_text(encoding="utf-8-sig", errors=errors)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: expected a text, found other bytes ({error})") from error
    except OSError as error:
        raise UserError(f"{path}: cannot read it ({error})") from error


def list_folder(folder: str) -> tuple[set[str], set[str]] | None:
    """Return the names of a folder's files and of its folders; None where there is no such folder.

    Raises:
        UserError: it cannot be listed.
    """
    try:
        if is_url(folder):
            with _store(folder) as (system, inner):
                system.invalidate_cache(inner)
                rows = system.ls(inner, detail=True)
            kinds = {str(row["name"]).rstrip("/").rpartition("/")[2]: row["type"] for row in rows}
            files = {name for name, kind in kinds.items() if kind == "file"}
            return files, set(kinds) - files
        with os.scandir(folder) as entries:
            is_folder = {entry.name: entry.is_dir() for entry in entries}
        return (
            {name for name, yes in is_folder.items() if not yes},
            {name for name, yes in is_folder.items() if yes},
        )
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise UserError(f"{folder}: cannot list it ({error})") from error


def folders_with(folder: str, name: str) -> list[str]:
    """Return the names of the folders in a folder that hold a file of that name, sorted.

    Raises:
        UserError: the folder cannot be listed.
    """
    if is_url(folder):
        try:
            with _store(folder) as (system, inner):
                found = system.glob(f"{inner.rstrip('/')}/*/{name}")
        except OSError as error:
            raise UserError(f"{folder}: cannot list it ({error})") from error
        return sorted(str(path).split("/")[-2] for path in found)
    listed = list_folder(folder)
    names = () if listed is None else listed[1]
    return sorted(inner for inner in names if os.path.isfile(f"{folder}/{inner}/{name}"))


def signature(path: str) -> Signature | None:
    """Return a file's size and time (or tag), to detect changes; None where there is no file."""
    try:
        if is_url(path):
            with _store(path) as (system, inner):
                info = system.info(inner)
            if info.get("type") != "file":
                return None
            stamp = next(
                (info[key] for key in ("ETag", "etag", "LastModified", "mtime") if key in info), ""
            )
            return int(info["size"]), str(stamp)
        status = os.stat(path)
    except OSError:
        return None
    return status.st_size, str(status.st_mtime_ns)


def fetch(path: str, folder: Path) -> Path:
    """Return a file on this machine: a URL's content is copied to ``folder``.

    Raises:
        UserError: there is no such file, or it cannot be read.
    """
    if not is_url(path):
        return Path(path)
    try:
        with _store(path) as (system, inner):
            copy = folder / inner.rpartition("/")[2]
            folder.mkdir(parents=True, exist_ok=True)
            system.get_file(inner, str(copy))
    except FileNotFoundError as error:
        raise UserError(f"{path}: no such file") from error
    except OSError as error:
        raise UserError(f"{path}: cannot copy it here ({error})") from error
    return copy


def put(local: Path, path: str) -> None:
    """Copy a file of this machine to a path or URL, whose folder is created.

    Raises:
        UserError: it cannot be written.
    """
    try:
        if is_url(path):
            with _store(path) as (system, inner):
                system.makedirs(inner.rpartition("/")[0], exist_ok=True)
                system.put_file(str(local), inner)
        elif not os.path.exists(path) or not os.path.samefile(local, path):
            Path(path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(local, path)
    except OSError as error:
        raise UserError(f"{path}: cannot write it ({error})") from error


def publish(work: Path, folder: str, marker: str) -> None:
    """Move a finished folder of this machine to the result ``folder``.

    Args:
        work: the finished folder; for a result on this machine, on the same file system.
        folder: path or URL. A result that is there already is replaced.
        marker: the file of ``work`` that makes a folder a result.

    Raises:
        UserError: it cannot be written, or the existing folder is not a result of a batch.
    """
    try:
        if is_url(folder):
            with _store(folder) as (system, inner):
                _upload(work, folder, marker, system, inner)
            shutil.rmtree(work)
            return
        old = work.with_name(f".{work.name}.old")
        shutil.rmtree(old, ignore_errors=True)
        if os.path.isdir(folder) and os.listdir(folder):
            if not os.path.isfile(join(folder, marker)):
                raise UserError(
                    f"{folder}: expected nothing or a result of a batch, found a folder without "
                    f"{marker}; move it away"
                )
            os.rename(folder, old)
        os.rename(work, folder)
        shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise UserError(f"{folder}: cannot write it ({error})") from error


def _upload(work: Path, folder: str, marker: str, system: Any, inner: str) -> None:
    """Copy a folder to a store; its marker is absent until all other files are there."""
    if system.exists(inner):
        if not system.exists(f"{inner}/{marker}"):
            _require_leftover(folder, system, inner, work)
        else:
            system.rm_file(f"{inner}/{marker}")
        system.rm(inner, recursive=True)
    files = sorted(path for path in work.rglob("*") if path.is_file())
    names = [path.relative_to(work).as_posix() for path in files]
    for inner_folder in sorted({f"{inner}/{name}".rpartition("/")[0] for name in names}):
        system.makedirs(inner_folder, exist_ok=True)
    for name in sorted(names, key=lambda name: name == marker):
        system.put_file(str(work / name), f"{inner}/{name}")


def _require_leftover(folder: str, system: Any, inner: str, work: Path) -> None:
    """Require that a folder without a marker holds only files that an interrupted upload left.

    Raises:
        UserError: it holds a file that ``work`` does not have.
    """
    ours = {path.relative_to(work).as_posix() for path in work.rglob("*") if path.is_file()}
    found = {str(path).removeprefix(inner).strip("/") for path in system.find(inner)}
    if not found <= ours:
        raise UserError(
            f"{folder}: expected nothing or a result of a batch, found {min(found - ours)}; move "
            "it away"
        )


@contextlib.contextmanager
def _store(url: str) -> Iterator[tuple[Any, str]]:
    """Give the file system of a URL and the path in it; whatever it raises becomes an OSError.

    Raises:
        UserError: as ``_open``.
        OSError: of the file system, or in place of an error of its library's own.
    """
    system, inner = _open(url)
    try:
        yield system, inner
    except (OSError, UserError, UnicodeDecodeError):
        raise
    except Exception as error:
        raise OSError(f"{type(error).__name__}: {error}") from error


def _open(url: str) -> tuple[Any, str]:
    """Return the file system of a URL and the path in it.

    Raises:
        UserError: fsspec is not installed, or knows no such file system.
    """
    try:
        core = importlib.import_module("fsspec.core")
        system, inner = core.url_to_fs(url)
    except ImportError as error:
        raise UserError(
            f'{url}: needs an optional dependency: pip install "gscomplete[s3]", or fsspec and the '
            f"package that it needs for this kind of store ({error})"
        ) from error
    except ValueError as error:
        raise UserError(f"{url}: {error}") from error
    return system, str(inner)
