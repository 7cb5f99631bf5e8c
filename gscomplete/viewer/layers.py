"""What the viewer shows: named sets of splats in one object frame.

Conventions
-----------
* Layers are in the object frame of the run or the object folder; without either, the frame is that
  of the first layer's bounding box, outlying splats (floaters) excluded.
* A run folder gives two layers, ``P`` and ``new``, and one for each alternative that it kept; one
  alternative at a time can be shown instead of ``new``. Any other folder gives one layer per splat
  file in it.
* A run that has not finished gives P and what its newest checkpoint holds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.folders import (
    RUN_FILE,
    RunFolder,
    object_folder_of,
    read_run_folder,
    splat_files_of,
)
from gscomplete.splats import Splats, read_splats
from gscomplete.splats.filters import usable_rows
from gscomplete.splats.formats.any_file import read_any_splats
from gscomplete.splats.thinning import thinned
from gscomplete.splats.transform import transform_splats
from gscomplete.viewer.live import newest
from gscomplete.views import ObjectFrame, UpAxis, ViewDistribution

_REACH = 0.8
"""Distance from the middle, in sizes of the frame, beyond which splats are reported, because
``render`` would not show them."""


@dataclass(frozen=True, slots=True)
class Layer:
    """Splats that are shown or hidden together."""

    name: str
    splats: Splats
    note: str
    """How many there are, cannot be drawn, lie outside the frame, and are shown."""
    is_alternative: bool = False
    """Whether it stands for ``new`` when chosen."""


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything that is looked at."""

    layers: tuple[Layer, ...]
    views: ViewDistribution | None
    """V, where a run or an object folder tells it."""
    running: Path | None = None
    """Folder of the run, while it has not finished."""


def read_scene(paths: Sequence[Path], up: UpAxis, most_splats: int) -> Scene:
    """Read a run folder, or splat files and folders of them.

    Args:
        paths: what to read; a run folder must be the only path.
        up: axis of the files that points up; runs and object folders record their own.
        most_splats: most splats per layer; of larger layers an even subset is shown.

    Raises:
        UserError: a path holds nothing to show, or a file is broken.
    """
    if len(paths) == 1 and (paths[0] / RUN_FILE).is_file():
        return _read_run(paths[0], most_splats)
    files = [file for path in paths for file in splat_files_of(path)]
    layers = []
    known = object_folder_of(paths[0]) if len(paths) == 1 else None
    frame = None if known is None else known.frame
    for name, path in zip(_names(files), files, strict=True):
        splats = read_any_splats(path).splats
        usable, _ = usable_rows(splats)
        if not bool(usable.any()):
            raise UserError(f"{path}: expected splats that can be drawn, found none")
        frame = frame or ObjectFrame.without_floaters(splats.select(usable), up)
        layers.append(_layer(name, splats, usable, frame, most_splats))
    return Scene(tuple(layers), None if known is None else known.views)


def _read_run(folder: Path, most_splats: int) -> Scene:
    """Read P, what was added to it, and V.

    Raises:
        UserError: the run has not finished, or its files do not fit each other.
    """
    run = read_run_folder(folder)
    running = run.content.get("status") == "running" and not run.output.is_file()
    layers = []
    for name, splats in _parts_of(run) if running else zip(("P", "new"), run.read(), strict=True):
        usable, _ = usable_rows(splats)
        if bool(usable.any()):
            layers.append(_layer(name, splats, usable, run.frame, most_splats))
    for option, path in run.alternatives():
        splats = read_splats(path).splats
        usable, _ = usable_rows(splats)
        if bool(usable.any()):
            layer = _layer(option, splats, usable, run.frame, most_splats)
            layers.append(dataclasses.replace(layer, is_alternative=True))
    return Scene(tuple(layers), run.views, run.folder if running else None)


def _parts_of(run: RunFolder) -> list[tuple[str, Splats]]:
    """Return P and the newest new splats of an unfinished run, in the file frame.

    Raises:
        UserError: P is not where it was.
    """
    path = Path(str(run.content["input"].get("path")))
    if not path.is_file():
        raise UserError(
            f"{run.folder}: the run is in progress, and its input {path} does not exist"
        )
    found = [("P", read_any_splats(path).splats)]
    progress = newest(run.folder)
    if progress is not None:
        found.append(("new", transform_splats(progress.splats, run.frame.file_from_object)))
    return found


def live_layer(splats: Splats, most: int) -> Layer:
    """Return the layer ``new`` of splats that are in the object frame."""
    usable, _ = usable_rows(splats)
    unit = ObjectFrame("Z", (0.0, 0.0, 0.0), 1.0)
    return _layer("new", splats, usable, unit, most)


def _layer(
    name: str,
    splats: Splats,
    usable: Tensor,  # [N] bool
    frame: ObjectFrame,
    most: int,
) -> Layer:
    """Transform the drawable splats into the object frame, and report those left out."""
    drawn = splats.select(usable)
    shown = thinned(drawn, most, torch.Generator().manual_seed(0))
    outside = frame.count_outside(drawn, _REACH)
    note = f"{len(splats):,} splats"
    if len(drawn) < len(splats):
        note += f", {len(splats) - len(drawn):,} of them not finite or too large to draw"
    if outside:
        note += f", {outside:,} of them outside the frame"
    if len(shown) < len(drawn):
        note += f", {len(shown):,} of them drawn, enlarged to match"
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
