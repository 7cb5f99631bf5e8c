"""Which splats a path stands for, and which way is up in them: files, object and run folders.

Conventions
-----------
* A run folder stands for its ``completed.ply``, an object folder for its ``partial.ply``. A file
  stands for itself, but its frame still comes from the folder that it belongs to, if the record
  there is one of ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gscomplete.errors import UserError
from gscomplete.folders.object_folder import OBJECT_FILE, object_folder_of
from gscomplete.folders.run_folder import (
    OUTPUT_FILE,
    RUN_FILE,
    is_run_file,
    read_run_folder,
)
from gscomplete.util.file_names import SPLAT_SUFFIXES, splat_stem
from gscomplete.views import ObjectFrame, ViewDistribution


@dataclass(frozen=True, slots=True)
class Drawable:
    """A splat file, with what its folder says."""

    file: Path
    frame: ObjectFrame | None = None
    """Frame of the complete object; None = nobody says."""
    views: ViewDistribution | None = None
    """Input view c and V in that frame."""


def drawable_of(path: Path) -> Drawable:
    """Return what a path means.

    Args:
        path: a splat file, a run folder or an object folder.

    Returns:
        The splat file, and frame and V where they are recorded.

    Raises:
        UserError: it is a folder of another kind, or its record cannot be read.
    """
    folder = path if path.is_dir() else path.parent
    means_run = path.is_dir() or path.name == RUN_FILE
    if path.name == OUTPUT_FILE and path.is_file():
        means_run = is_run_file(folder / RUN_FILE)
    if means_run and (folder / RUN_FILE).is_file():
        run = read_run_folder(folder)
        return Drawable(run.output, run.frame, run.views)
    found = object_folder_of(path)
    if found is not None:
        is_splats = splat_stem(path.name) is not None
        return Drawable(path if is_splats else found.partial, found.frame, found.views)
    if path.is_dir():
        raise UserError(
            f"{path}: expected a splat file, a run folder ({RUN_FILE}) or an object folder "
            f"({OBJECT_FILE}), found another folder"
        )
    return Drawable(path)


def splat_files_of(path: Path) -> list[Path]:
    """List the splat files of a folder, in the order of their names; a file is its own list.

    Args:
        path: a folder or a splat file.

    Returns:
        At least one path.

    Raises:
        UserError: the folder holds none.
    """
    if not path.is_dir():
        return [path]
    found = sorted(p for p in path.iterdir() if p.is_file() and splat_stem(p.name) is not None)
    if not found:
        expected = ", ".join(SPLAT_SUFFIXES)
        raise UserError(f"{path}: expected a run folder or splat files ({expected}), found none")
    return found
