"""What is looked at: sets of splats with names, in one object frame.

Conventions
-----------
* Layers are in the object frame: of the run where there is one, else about the first layer's box,
  floaters apart.
* A run folder gives two layers, ``P`` and ``new``; any other folder one per splat file in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from gscomplete.completion.run_folder import OUTPUT_FILE, RUN_FILE
from gscomplete.errors import UserError
from gscomplete.splats import Splats, read_splats
from gscomplete.splats.filters import thinned, usable_rows
from gscomplete.splats.transform import transform_splats
from gscomplete.util.jsonio import read_json
from gscomplete.views import ObjectFrame, UpAxis, ViewDistribution

_REACH = 0.8
"""What is farther from the middle, in sizes of the frame, is told: ``render`` would not show it."""


@dataclass(frozen=True, slots=True)
class Layer:
    """Splats that are shown or hidden together."""

    name: str
    splats: Splats
    note: str
    """How many there are, cannot be drawn, lie outside the frame, and are shown."""


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything that is looked at."""

    layers: tuple[Layer, ...]
    views: ViewDistribution | None
    """V, where a run tells it."""


def read_scene(paths: Sequence[Path], up: UpAxis, most_splats: int) -> Scene:
    """Read a run folder, or splat files and folders of them.

    Args:
        paths: what to read; a run folder comes alone.
        up: axis of the files that points up; a run knows its own.
        most_splats: of each layer; of larger ones an even choice is shown.

    Raises:
        UserError: a path holds nothing to show, or a file is broken.
    """
    if len(paths) == 1 and (paths[0] / RUN_FILE).is_file():
        return _read_run(paths[0], most_splats)
    files = _splat_files(paths)
    layers = []
    frame: ObjectFrame | None = None
    for name, path in zip(_names(files), files, strict=True):
        splats = read_splats(path).splats
        usable, _ = usable_rows(splats)
        if not bool(usable.any()):
            raise UserError(f"{path}: expected splats that can be drawn, found none")
        frame = frame or ObjectFrame.without_floaters(splats.select(usable), up)
        layers.append(_layer(name, splats, usable, frame, most_splats))
    return Scene(tuple(layers), None)


def _read_run(folder: Path, most_splats: int) -> Scene:
    """Read P, what was added to it, and V.

    Raises:
        UserError: the run has not finished, or its files do not fit each other.
    """
    path = folder / RUN_FILE
    record = read_json(path)
    try:
        count, identity = int(record["input"]["splats"]), record["identity"]
        frame = ObjectFrame.from_json(identity["frame"], str(path))
        views = ViewDistribution.from_json(identity["views"], str(path))
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path}: expected the record of a run, found none ({error!r})") from error
    output = folder / OUTPUT_FILE
    if not output.is_file():
        raise UserError(f"{output}: no such file; the run is {record.get('status', 'unfinished')}")
    splats = read_splats(output).splats
    if len(splats) < count:
        raise UserError(f"{output}: expected at least P's {count} splats, found {len(splats)}")
    usable, _ = usable_rows(splats)
    row = torch.arange(len(splats))
    layers = [
        _layer(name, splats.select(part), usable[part], frame, most_splats)
        for name, part in (("P", row < count), ("new", row >= count))
        if bool(usable[part].any())
    ]
    return Scene(tuple(layers), views)


def _splat_files(paths: Sequence[Path]) -> list[Path]:
    """List the splat files that paths stand for.

    Raises:
        UserError: a folder holds none.
    """
    files: list[Path] = []
    for path in paths:
        if not path.is_dir():
            files.append(path)
            continue
        # hidden files are no splats: macOS's ._NAME, what a killed write left
        found = sorted(p for p in path.glob("*.ply") if not p.name.startswith("."))
        if not found:
            raise UserError(f"{path}: expected a run folder or splat files (*.ply), found none")
        files += found
    return files


def _layer(
    name: str,
    splats: Splats,
    usable: Tensor,  # [N] bool
    frame: ObjectFrame,
    most: int,
) -> Layer:
    """Carry what can be drawn into the frame, and tell what is left out."""
    drawn = splats.select(usable)
    shown = thinned(drawn, most, torch.Generator().manual_seed(0))
    outside = frame.count_outside(drawn, _REACH)
    note = f"{len(splats):,} splats"
    if len(drawn) < len(splats):
        note += f", {len(splats) - len(drawn):,} of them not finite or too large to draw"
    if outside:
        note += f", {outside:,} of them outside the frame"
    if len(shown) < len(drawn):
        note += f", {len(shown):,} of them shown, widened to match"
    return Layer(name, transform_splats(shown, frame.object_from_file), note)


def _names(files: Sequence[Path]) -> list[str]:
    """Name files by their stems, with as many of their folders as tell them apart.

    A file given twice gets a number.
    """
    paths = [file.absolute().with_suffix("").parts for file in files]
    names = []
    for number, path in enumerate(paths):
        others = [other for other in paths if other != path]
        length = next(
            (n for n in range(1, len(path)) if all(o[-n:] != path[-n:] for o in others)), len(path)
        )
        repeats = paths[:number].count(path)
        names.append("/".join(path[-length:]) + (f" ({repeats + 1})" if repeats else ""))
    return names
