"""What a run folder says: P, what was added to it, and how they were measured.

Conventions
-----------
* ``completed.ply`` holds P's records first, then the new splats; ``run.json`` counts both.
* Frame and V are those that the run ended with.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from gscomplete.errors import UserError
from gscomplete.splats import Splats, read_splats
from gscomplete.util.file_names import ALTERNATIVES_FOLDER, OUTPUT_FILE, RUN_FILE
from gscomplete.util.jsonio import has_schema, read_json
from gscomplete.views import ObjectFrame, ViewDistribution

SCHEMA = "gscomplete.run"
"""Name of the JSON form of ``run.json``."""


@dataclass(frozen=True, slots=True)
class RunFolder:
    """A run folder, its splats not yet read."""

    folder: Path
    content: dict[str, Any]
    """``run.json`` as it is."""
    prompt: str
    frame: ObjectFrame
    views: ViewDistribution
    partial_count: int
    """How many of the completed splats, from the first, are P's."""

    @property
    def output(self) -> Path:
        """File of the completed object."""
        return self.folder / OUTPUT_FILE

    @property
    def object_folder(self) -> Path | None:
        """The object folder that was completed; None = another file, or not recorded."""
        found = self.content["input"].get("object")
        return Path(found) if isinstance(found, str) else None

    def alternatives(self) -> list[tuple[str, Path]]:
        """Return the guesses that were kept: the option that gives each, and its new splats."""
        result = self.content.get("result") or {}
        options = [str(option) for option in result.get("alternatives") or ()]
        files = [self.folder / alternative_file(number) for number in range(len(options))]
        return [pair for pair in zip(options, files, strict=True) if pair[1].is_file()]

    def read(self) -> tuple[Splats, Splats]:
        """Read P and the new splats, both in the file frame.

        Raises:
            UserError: the run has not finished, or its files do not fit each other.
        """
        if not self.output.is_file():
            status = self.content.get("status", "unfinished")
            raise UserError(f"{self.output}: no such file; the run is {status}")
        splats = read_splats(self.output).splats
        if len(splats) < self.partial_count:
            raise UserError(
                f"{self.output}: expected at least P's {self.partial_count} splats, found "
                f"{len(splats)}"
            )
        is_partial = torch.arange(len(splats)) < self.partial_count
        return splats.select(is_partial), splats.select(~is_partial)


def alternative_file(number: int) -> str:
    """Return where a run keeps the new splats of a guess that was drawn beside its result.

    Args:
        number: of the guess, from 0, in the order of ``run.json``.

    Returns:
        The path within the run folder.
    """
    return f"{ALTERNATIVES_FOLDER}/{number}.ply"


def is_run_file(path: Path) -> bool:
    """Tell whether a file is the record of a run: other programs may call theirs so."""
    return has_schema(path, SCHEMA)


def read_run_folder(folder: Path) -> RunFolder:
    """Read ``run.json`` of a folder.

    Args:
        folder: a run folder.

    Returns:
        What ``run.json`` says; files are named, not opened.

    Raises:
        UserError: it is missing or no record of a run.
    """
    path = folder / RUN_FILE
    if not path.is_file():
        raise UserError(f"{folder}: expected a run folder with {RUN_FILE}, found none")
    content = read_json(path)
    try:
        count, identity = int(content["input"]["splats"]), content["identity"]
        frame = ObjectFrame.from_json(identity["frame"], str(path))
        views = ViewDistribution.from_json(identity["views"], str(path))
        prompt = str(identity.get("prompt", ""))
    except (KeyError, OverflowError, TypeError, ValueError) as error:
        raise UserError(f"{path}: expected the record of a run, found none ({error!r})") from error
    return RunFolder(folder, content, prompt, frame, views, count)
