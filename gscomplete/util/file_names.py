"""Names of the files that make object, run and dataset folders, of splat files, and of objects."""

import os
import re
from pathlib import Path
from typing import Any, TypeGuard

from gscomplete.errors import UserError

OBJECT_FILE = "object.json"
PARTIAL_FILE = "partial.ply"
COMPLETE_FILE = "complete.ply"
RUN_FILE = "run.json"
OUTPUT_FILE = "completed.ply"
DATASET_FILE = "dataset.json"
ALTERNATIVES_FOLDER = "alternatives"
SPLAT_SUFFIXES = (".compressed.ply", ".ply", ".splat", ".spz", ".glb", ".sog", ".ksplat")
"""Of the splat files that are read; the longer of two that fit comes first."""
_LONGEST_NAME = 200
"""In characters."""


def is_plain_name(name: Any) -> TypeGuard[str]:
    """Tell whether a name is one path component that is printable and not hidden."""
    if not isinstance(name, str) or not 0 < len(name) <= _LONGEST_NAME:
        return False
    return not name.startswith(".") and not set(name) & set("/\\") and name.isprintable()


def shown_name(name: str) -> str:
    """Return a name as text: bytes that are no text become U+FFFD.

    Args:
        name: of a file, as Python gives it: a lone surrogate for each such byte.
    """
    return re.sub("[\ud800-\udfff]", "\ufffd", name)


def splat_stem(name: str) -> str | None:
    """Return a splat file's name without its suffix.

    Args:
        name: of a file.

    Returns:
        None = it is no splat file, or hidden: macOS's ._NAME, what a kill left.
    """
    if name.startswith("."):
        return None
    fitting = (suffix for suffix in SPLAT_SUFFIXES if name.lower().endswith(suffix))
    suffix = next(fitting, None)
    return None if suffix is None else name[: -len(suffix)] or None


def require_destination(name: str, path: Path | None, suffixes: tuple[str, ...]) -> None:
    """Check, before any work is done for it, that a file can be written, or replaced.

    Args:
        name: the option that names it.
        path: the file; None = none is written.
        suffixes: of files of its kind, in lower case.

    Raises:
        UserError: it has another suffix, as a splat file named by mistake has; its folder is not
            there or not writable, or it is a folder itself.
    """
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        kinds = ", ".join(suffixes)
        raise UserError(f"{name}: expected a file name ending in {kinds}, found {str(path)!r}")
    if path.is_dir():
        raise UserError(f"{name}: {path}: expected a file, found a folder")
    if not path.parent.is_dir():
        raise UserError(f"{name}: {path}: expected a folder that exists, found no {path.parent}")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise UserError(f"{name}: {path}: no permission to write into {path.parent}")
