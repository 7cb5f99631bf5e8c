"""A completion as a user runs it: file in, run folder out.

A run folder holds ``completed.ply`` (P's records first and byte for byte), ``run.json`` (everything
that decided the result, and what came of it), ``preview.png``, ``turntable.webp``, ``log.jsonl``
(one line per step), ``checkpoints/`` and, where asked for, ``alternatives/`` (the new splats of
other guesses). All but the log are written atomically.
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from gscomplete.completion import pipeline
from gscomplete.completion.alternatives import alternatives_sheet, guess_alternatives
from gscomplete.completion.optimise import Optimisation, StepReport
from gscomplete.completion.pipeline import Completed, Prepared
from gscomplete.errors import UserError
from gscomplete.evaluate.doubts import doubts_of_change
from gscomplete.evaluate.pictures import (
    draw_turntable,
    preview_sheet,
    save_image,
    save_turntable,
)
from gscomplete.evaluate.report import evaluate
from gscomplete.fitting.checkpoint import FILE_NAME, check_fits, load_checkpoint
from gscomplete.fitting.finite import NonFiniteError
from gscomplete.fitting.step_loop import (
    CHECKPOINTS,
    LOG_FILE,
    logged_seconds,
    require_same_identity,
    run_steps,
)
from gscomplete.folders import OUTPUT_FILE, RUN_FILE, alternative_file
from gscomplete.folders.run_folder import SCHEMA
from gscomplete.priors.base import Prior
from gscomplete.splats import transform_splats, write_splats
from gscomplete.splats.formats.any_file import read_splat_file
from gscomplete.splats.ply import SplatFile, require_appendable
from gscomplete.util import jsonio
from gscomplete.util.atomic import atomic_path, forget_leftovers
from gscomplete.util.device import peak_gpu_bytes
from gscomplete.util.digests import sha256_of
from gscomplete.util.folder_lock import FolderLock, create_folder, lock_folder, require_free
from gscomplete.util.stages import current_profile, stage
from gscomplete.util.versions import differences_note, made_with

ALTERNATIVES_FILE = "alternatives.png"
_FILES = (
    *(RUN_FILE, OUTPUT_FILE, ALTERNATIVES_FILE, "preview.png", "turntable.webp"),
    *(LOG_FILE, FILE_NAME),
)


@dataclass(frozen=True, slots=True)
class RunRequest:
    """What a user asked for."""

    partial_path: Path
    """P's file."""
    out: Path
    """The run folder."""
    completion: pipeline.Request
    """Prompt, settings, and what is known of P's frame."""
    resume: bool = False
    """Continue the run in ``out`` from its last checkpoint."""
    alternatives: int = 0
    """Planes of symmetry whose guesses are drawn beside the result."""
    object_folder: Path | None = None
    """Folder of the object that P belongs to; None = unknown."""
    sources: dict[str, str] = field(default_factory=dict)
    """Where each given value came from, by its name."""
    notes: tuple[str, ...] = ()
    """Warnings about the request."""
    new_only: Path | None = None
    """PLY file for the new splats alone, file frame; None = none."""


@dataclass(slots=True)
class Run:
    """A completion set up and ready to go, with all that decides its result."""

    request: RunRequest
    source: SplatFile  # without what was decoded
    prepared: Prepared
    identity: dict[str, Any]
    notes: tuple[str, ...]
    lock: FolderLock | None = None
    """Keeps other processes out of the run folder; None = not taken yet, or locks do not exist."""
    timings: dict[str, float] = field(default_factory=dict)

    @property
    def steps(self) -> Optimisation:
        """The steps, taken and to take."""
        return self.prepared.steps


def _check_outputs(out: Path, new_only: Path | None, *, resume: bool) -> None:
    """Check, before any work is done, that a run can write where it is asked to.

    Args:
        out: the run folder.
        new_only: file for the new splats alone; None = none.
        resume: whether the run in ``out`` is continued; then it may have written ``new_only``.

    Raises:
        UserError: there is nothing to continue, or something to overwrite.
    """
    if not resume:
        require_free(out)
    elif not (out / RUN_FILE).exists():
        raise UserError(f"{out}: nothing to resume: there is no {RUN_FILE}; start without --resume")
    if new_only is None:
        return
    if new_only.suffix.lower() != ".ply":
        raise UserError(f"--new-only: expected the name of a .ply file, found {str(new_only)!r}")
    if not new_only.parent.is_dir():
        raise UserError(f"--new-only: {new_only}: expected a folder that exists, found none")
    place = new_only.parent.resolve()
    if out.resolve() in (place, *place.parents):
        raise UserError(f"--new-only: {new_only}: expected a file outside the run folder {out}")
    if new_only.exists() and not (resume and _is_written_by(out / RUN_FILE, new_only)):
        raise UserError(f"--new-only: {new_only}: it exists; choose another name")


def _is_written_by(run_file: Path, new_only: Path) -> bool:
    """Tell whether a run says that it writes its new splats to this file."""
    content = jsonio.read_json(run_file)
    return isinstance(content, dict) and content.get("new_only") == str(new_only.resolve())


def prepare(request: RunRequest, prior: Prior, device: torch.device | str = "cpu") -> Run:
    """Read P, decide the frame and views, and set up step 0 or the step of the last checkpoint.

    Args:
        request: what the user asked for.
        prior: the model that guides.
        device: where splats are rendered and moved.

    Raises:
        UserError: the input, an option or the output folder is wrong.
    """
    started = time.perf_counter()
    lock = None
    _check_outputs(request.out, request.new_only, resume=request.resume)
    if request.resume:
        lock = lock_folder(request.out)
        forget_leftovers(request.out, _FILES)
    with stage("read"):
        source = read_splat_file(request.partial_path)
        require_appendable(source)
    prepared = pipeline.prepare(source, request.completion, prior, device)
    with stage("read"):
        identity = {"input_sha256": sha256_of(request.partial_path), **prepared.identity}
    notes = (*request.notes, *prepared.notes)
    run = Run(request, source.released(), prepared, identity, notes, lock)
    if request.resume:
        require_same_identity(request.out / RUN_FILE, identity)
        versions = jsonio.read_json(request.out / RUN_FILE).get("versions")
        odd = differences_note(versions)
        run.request = dataclasses.replace(request, notes=(*request.notes, *odd))
        run.notes = (*notes, *odd)
        state = load_checkpoint(request.out / CHECKPOINTS)
        if state is not None:
            path = request.out / CHECKPOINTS / FILE_NAME
            check_fits(path, state, run.steps.state(), request.completion.settings.steps)
            try:
                run.steps.restore(state)
            except ValueError as error:
                raise UserError(f"{path}: {error}") from error
    else:
        run.lock = create_folder(request.out, _FILES)
    run.timings["prepare_s"] = time.perf_counter() - started
    _write_run_file(run, "running", None)
    return run


def execute(run: Run, on_step: Callable[[StepReport], None]) -> dict[str, Any]:
    """Take all remaining steps, write the results, and return the content of ``run.json``.

    A run that is interrupted (also by Ctrl-C) can be resumed from its last checkpoint.

    Raises:
        UserError: a value stopped being finite, or a file cannot be written.
    """
    _take_steps(run, on_step)
    out = run.request.out
    started = time.perf_counter()
    completed = pipeline.finish(run.prepared, run.source)
    run.notes = (*run.request.notes, *completed.notes)
    run.timings["finish_s"] = time.perf_counter() - started
    completing_s = sum(run.timings.values())
    started = time.perf_counter()
    with stage("write"):
        completed.save(out / OUTPUT_FILE)
        if run.request.new_only is not None:
            completed.save_new(run.request.new_only)
    run.timings["write_s"] = time.perf_counter() - started
    started = time.perf_counter()
    together = completed.in_object_frame
    with stage("metrics"):
        metrics = jsonio.to_json(evaluate(together, completed.partial, completed.views))
    change = metrics["all_views"]
    doubts = doubts_of_change(change["color"], change["depth"])
    run.notes += doubts
    run.timings["measure_s"] = time.perf_counter() - started
    started = time.perf_counter()
    title = run.request.completion.prompt
    with stage("pictures"):
        views = completed.views.to_show(together.means.double().numpy())
        frames = draw_turntable(together, views)
        sheet = preview_sheet(completed.partial, frames, views, title=title)
        save_image(sheet, out / "preview.png")
        save_turntable(frames, out / "turntable.webp")
    run.timings["pictures_s"] = time.perf_counter() - started
    started = time.perf_counter()
    with stage("alternatives"):
        alternatives = _draw_alternatives(run, completed) if run.request.alternatives else []
    run.timings["alternatives_s"] = time.perf_counter() - started
    result = {
        "metrics": metrics,
        "measured_with": run.prepared.working.stands_for,
        "new_splats": len(completed.new),
        "seconds": round(completing_s, 3),
        "peak_gpu_bytes": peak_gpu_bytes(),
        "seam_colors": jsonio.to_json(completed.seam_colors),
        "hard_preservation": jsonio.to_json(completed.hard_preservation),
        "alternatives": alternatives,
        "doubts": [*completed.doubts, *doubts],
    }
    return _write_run_file(run, "finished", result)


def _take_steps(run: Run, on_step: Callable[[StepReport], None]) -> None:
    """Take all remaining steps.

    Raises:
        NonFiniteError: a value stopped being finite; the message names the last good checkpoint.
        UserError: the log or a checkpoint cannot be written.
    """
    out = run.request.out
    every = run.request.completion.settings.checkpoint_every
    earlier_s = logged_seconds(out / LOG_FILE, run.steps.step_number)  # of a run that is resumed
    started = time.perf_counter()
    try:
        with stage("steps"):
            run_steps(run.steps, out, every, on_step)
    except NonFiniteError as error:
        stopped = NonFiniteError(error.step, error.tensor, _way_back(out / CHECKPOINTS))
        _write_run_file(run, "stopped", {"error": str(stopped)})
        raise stopped from error
    run.timings["optimise_s"] = earlier_s + time.perf_counter() - started


def _way_back(folder: Path) -> str:
    """Tell the user from which checkpoint a stopped run can continue."""
    state = load_checkpoint(folder)
    if state is None:
        return "; there is no checkpoint yet"
    return f"; the last good checkpoint is kept: {folder / FILE_NAME}, step {int(state['step'])}"


def _draw_alternatives(run: Run, completed: Completed) -> list[str]:
    """Draw and keep the guesses that the user asked for; return the options that give them."""
    request, prepared = run.request, run.prepared
    found = guess_alternatives(
        prepared.prior,
        prepared.heeded,
        prepared.guessed_views,
        prepared.conditioning,
        request.completion.settings,
        request.alternatives,
    )
    sheet = alternatives_sheet(
        found,
        completed.partial,
        completed.in_object_frame,
        completed.views,
        request.completion.prompt,
    )
    save_image(sheet, request.out / ALTERNATIVES_FILE)
    for number, alternative in enumerate(found):
        placed = transform_splats(alternative.splats, prepared.frame.file_from_object)
        path = request.out / alternative_file(number)
        path.parent.mkdir(exist_ok=True)
        write_splats(path, placed)
    return [alternative.option for alternative in found]


def _write_run_file(run: Run, status: str, result: dict[str, Any] | None) -> dict[str, Any]:
    """Write and return the content of ``run.json``."""
    folder, new_only = run.request.object_folder, run.request.new_only
    content = {
        "schema": SCHEMA,
        "version": 1,
        "status": status,
        "input": {
            "path": str(run.request.partial_path),
            "splats": run.source.n_rows,
            "object": None if folder is None else str(folder.resolve()),
            "sources": run.request.sources,
        },
        "identity": run.identity,
        "new_only": None if new_only is None else str(new_only.resolve()),
        "notes": list(run.notes),
        "versions": made_with(),
        "timings": {name: round(seconds, 3) for name, seconds in run.timings.items()},
        "result": result,
    }
    profile = current_profile()
    if profile is not None:
        content["profile"] = profile.to_json()
    with atomic_path(run.request.out / RUN_FILE) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return content
