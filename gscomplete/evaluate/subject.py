"""Completions to be measured: P, O, V and the truth, all in one object frame.

Conventions
-----------
* If the object folder is known, its frame, V and truth are used, the same for every method;
  otherwise those of the run.
* A run's O begins with P's splats, and is refused if these are not the object's. Another system's
  result, a splat file, is used as it is; it contains P if its first splats lie where P's do.
* In a folder of runs, the completion of the object ``ID`` is ``ID`` or ``ID_completed`` (a run
  folder) or ``ID.ply`` (a splat file of any format, in P's file frame).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import torch
from scipy.spatial import cKDTree

from gscomplete.errors import UserError
from gscomplete.evaluate.doubts import MARK
from gscomplete.folders import (
    OBJECT_FILE,
    RUN_FILE,
    ObjectFolder,
    RunFolder,
    object_folder_of,
    read_object_folder,
    read_run_folder,
)
from gscomplete.splats import Splats, concatenate, read_splats, usable_rows
from gscomplete.splats.formats.any_file import READ, read_any_splats
from gscomplete.splats.transform import transform_splats
from gscomplete.views import ObjectFrame, ViewDistribution

_SAME_PLACE = 1e-4
"""Splats at most this far apart, in object sizes, are at the same place: float32 coordinates change
by less when they are transformed back and forth."""
_SAME_VALUE, _LEAST_SCALE = 1e-3, 1e-20
"""P's other values are the same within the first; scales are compared by their logarithms."""
_NEAR, _MOSTLY = 0.05, 0.5
"""A result is doubtful if a smaller share of P's splats has one of its own within this (object
sizes)."""
_TIMINGS = ("prepare_s", "optimise_s", "finish_s")
"""Stages of a run that count as completing; writing files and drawing pictures do not."""


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """One completion of one object, in the object frame."""

    method: str
    object: str
    subset: str | None
    prompt: str
    partial: Splats
    completed: Splats
    truth: Splats | None
    views: ViewDistribution
    frame: ObjectFrame
    """From the file frame to the object frame."""
    seconds: float | None = None
    notes: tuple[str, ...] = ()
    """What the run says of itself."""
    warnings: tuple[str, ...] = ()
    """What reading it found odd."""
    settings: str = ""
    """How it was made, for people; empty = not known."""
    timings: dict[str, float] = field(default_factory=dict)
    """Seconds by stage, as a run records them."""
    sources: dict[str, str] = field(default_factory=dict)
    """Where prompt, up axis, views and frame came from, as a run records it."""
    holds_partial: bool = True
    """Whether O begins with P's splats."""


def read_subject(path: Path, method: str, owner: Path | None = None) -> Subject:
    """Read a run folder, or a splat file together with the object that it completes.

    Args:
        path: run folder, ``run.json`` in it, or splat file.
        method: who completed it.
        owner: the object folder; None = as the run says, if it does and that is still there.

    Raises:
        UserError: a file is missing or broken, or completes another object.
    """
    folder = path.parent if path.name == RUN_FILE else path
    if (folder / RUN_FILE).is_file():
        return _read_run(folder, method, owner)
    if path.is_dir():
        raise UserError(f"{path}: expected a run folder with {RUN_FILE}, found another folder")
    if owner is None:
        raise UserError(
            f"{path}: --object: expected the folder of the object that it completes, found none"
        )
    return _read_result(path, method, read_object_folder(owner))


def find_completion(runs: Path, object_id: str) -> Path | None:
    """Return the finished completion of an object in a folder of runs; None = there is none."""
    for name in (object_id, f"{object_id}_completed"):
        if (runs / name / RUN_FILE).is_file():
            run = read_run_folder(runs / name)
            return run.folder if run.output.is_file() else None
    files = (runs / f"{object_id}.{kind}" for kind in READ)
    return next((file for file in files if file.is_file()), None)


def objects_of(dataset: Path) -> list[ObjectFolder]:
    """Return the objects of a dataset that have a part, in the order of their names.

    Raises:
        UserError: it holds none, or one cannot be read.
    """
    if not dataset.is_dir():
        raise UserError(f"{dataset}: --dataset: expected a folder of object folders, found none")
    folders = sorted(path.parent for path in dataset.glob(f"*/{OBJECT_FILE}"))
    found = [read_object_folder(path) for path in folders if not path.name.startswith(".")]
    found = [entry for entry in found if entry.partial.name in entry.files]
    if not found:
        raise UserError(f"{dataset}: --dataset: expected folders with {OBJECT_FILE}, found none")
    return found


def _read_run(folder: Path, method: str, owner: Path | None) -> Subject:
    run = read_run_folder(folder)
    owner = owner or run.object_folder
    known = object_folder_of(owner) if owner is not None else None
    partial, new = run.read()
    _check_count(run, len(new))
    partial, new = _drawable(partial), _drawable(new)
    frame = run.frame if known is None else known.frame
    truth = None
    warnings: tuple[str, ...] = ()
    if known is not None:
        given = read_splats(known.partial).splats
        if len(given) != run.partial_count:
            raise UserError(
                f"{run.folder}: expected a run of {known.partial} with {len(given)} splats, found "
                f"one of {run.partial_count}"
            )
        if not _is_same(partial, _drawable(given), frame.size_file):
            raise UserError(
                f"{run.output}: expected the splats of {known.partial} first, found others: it "
                "completes another part, or was changed"
            )
        truth = _truth(known)
        warnings = _other_views(run, known)
    elif owner is not None:
        warnings = (f"{owner}: the object's folder is not there, so there is no truth to compare",)
    to_object = frame.object_from_file
    return Subject(
        method,
        folder.resolve().name if known is None else known.id,
        None if known is None else known.subset,
        run.prompt or ("" if known is None else known.prompt),
        transform_splats(partial, to_object),
        transform_splats(concatenate([partial, new]), to_object),
        None if truth is None else transform_splats(truth, to_object),
        run.views if known is None else known.views,
        frame,
        _seconds(run),
        tuple(str(note) for note in run.content.get("notes", ())),
        warnings,
        _settings(run),
        dict(run.content.get("timings") or {}),
        dict(run.content["input"].get("sources") or {}),
    )


def _other_views(run: RunFolder, known: ObjectFolder) -> tuple[str, ...]:
    """Tell that the user gave the run another V than the one that completions are measured over."""
    sources = run.content["input"].get("sources") or {}
    given = [sources.get(name) for name in ("input_view", "V")]
    if not any(str(source).startswith("--") for source in given):
        return ()
    ours, theirs = known.views, run.views
    return (
        f"{run.folder}: P's appearance was kept from other views ({_in_words(theirs)}) than those "
        f"of {OBJECT_FILE} that it is measured from ({_in_words(ours)})",
    )


def _in_words(views: ViewDistribution) -> str:
    """Return V as options give it."""
    return (
        f"--view={views.azimuth_deg:g},{views.elevation_deg:g} --range={views.azimuth_range_deg:g}"
    )


def _check_count(run: RunFolder, count: int) -> None:
    """Refuse a result of which splats are missing, or to which some were added.

    Raises:
        UserError: the run records another number of new splats.
    """
    recorded = (run.content.get("result") or {}).get("new_splats")
    if isinstance(recorded, int) and recorded != count:
        raise UserError(
            f"{run.output}: expected {recorded:,} new splats, as {RUN_FILE} says, found {count:,}: "
            "it was changed"
        )


def _read_result(path: Path, method: str, known: ObjectFolder) -> Subject:
    to_object = known.frame.object_from_file
    truth = _truth(known)
    partial = transform_splats(_drawable(read_splats(known.partial).splats), to_object)
    completed = transform_splats(_drawable(read_any_splats(path).splats), to_object)
    return Subject(
        method,
        known.id,
        known.subset,
        known.prompt,
        partial,
        completed,
        None if truth is None else transform_splats(truth, to_object),
        known.views,
        known.frame,
        warnings=_doubts_of_result(path, completed, partial),
        holds_partial=_begins_with(completed, partial, 1.0),
    )


def _begins_with(completed: Splats, partial: Splats, size: float) -> bool:
    """Tell whether a completion's first splats lie where P's do.

    Args:
        completed: O, or its first splats.
        partial: P.
        size: of the object, in the units of both.
    """
    if len(completed) < len(partial):
        return False
    away = (completed.means[: len(partial)] - partial.means).abs()
    return bool((away < _SAME_PLACE * size).all())


def _is_same(partial: Splats, given: Splats, size: float) -> bool:
    """Tell whether splats are P's, in every value."""
    if len(partial) != len(given) or not _begins_with(partial, given, size):
        return False
    pairs = [
        (partial.opacities, given.opacities),
        (partial.scales.clamp_min(_LEAST_SCALE).log(), given.scales.clamp_min(_LEAST_SCALE).log()),
        (partial.quaternions, given.quaternions),
        (partial.sh, given.sh),
    ]
    return all(
        mine.shape == theirs.shape and torch.allclose(mine, theirs, rtol=0, atol=_SAME_VALUE)
        for mine, theirs in pairs
    )


def _doubts_of_result(path: Path, completed: Splats, partial: Splats) -> tuple[str, ...]:
    """Return what makes another system's result doubtful as a completion of P."""
    if not len(completed) or not len(partial):
        return ()
    distances, _ = cKDTree(completed.means.double().numpy()).query(partial.means.double().numpy())
    near = float((distances < _NEAR).mean())
    if near >= _MOSTLY:
        return ()
    return (
        f"{MARK}{path}: only {near:.0%} of P's splats have a splat of the result within {_NEAR:g} "
        "object sizes: expected a completion of P in the coordinates of P's file",
    )


def _truth(known: ObjectFolder) -> Splats | None:
    return None if known.complete is None else _drawable(read_splats(known.complete).splats)


def _drawable(splats: Splats) -> Splats:
    return splats.select(usable_rows(splats)[0])


def _seconds(run: RunFolder) -> float | None:
    """Return how long completing took; None where it is not recorded."""
    timings = run.content.get("timings") or {}
    found = [timings[name] for name in _TIMINGS if isinstance(timings.get(name), int | float)]
    return float(sum(found)) if len(found) == len(_TIMINGS) else None


def _settings(run: RunFolder) -> str:
    """Say which prior and seed a run was made with, and in how many steps."""
    identity = run.content.get("identity", {})
    prior, settings = identity.get("prior"), identity.get("settings") or {}
    name = prior.get("name") if isinstance(prior, dict) else prior
    parts = [f"prior {name}" if name else ""]
    parts += [f"{key} {settings[key]}" for key in ("start", "steps", "seed") if key in settings]
    return ", ".join(part for part in parts if part)
