"""A completion as a user runs it: file in, run folder out.

A run folder holds ``completed.ply`` (P's records first and byte for byte), ``run.json`` (everything
that decided the result, and what came of it), ``preview.png``, ``turntable.webp``, ``log.jsonl``
(one line per step) and ``checkpoints/``. All but the log are written atomically.
"""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

import gscomplete
from gscomplete.completion.alternatives import alternatives_sheet, guess_alternatives
from gscomplete.completion.finish import finish_splats
from gscomplete.completion.optimise import Completion, NonFiniteError, StepReport
from gscomplete.completion.settings import CompletionSettings
from gscomplete.errors import UserError
from gscomplete.evaluate.pictures import preview_sheet, save_image, save_turntable
from gscomplete.evaluate.report import evaluate
from gscomplete.fitting.checkpoint import FILE_NAME, check_fits, load_checkpoint
from gscomplete.fitting.step_loop import (
    CHECKPOINTS,
    LOG_FILE,
    require_same_identity,
    take_steps,
)
from gscomplete.folders.run_folder import OUTPUT_FILE, RUN_FILE
from gscomplete.framing.check import check_given_frame, largest_side
from gscomplete.framing.guess import guess_framing
from gscomplete.priors.base import Conditioning, Prior, prior_identity
from gscomplete.render import render
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.ply import SplatFile, append_splats, read_splats, require_appendable
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.splats.working_set import WorkingSet, working_set
from gscomplete.util import jsonio
from gscomplete.util.atomic import atomic_path, forget_leftovers
from gscomplete.util.device import peak_gpu_bytes
from gscomplete.util.digests import sha256_of
from gscomplete.util.folder_lock import FolderLock, create_folder, lock_folder
from gscomplete.views import ObjectFrame, UpAxis, ViewDistribution, radius_to_fit, up_rotation

ALTERNATIVES_FILE = "alternatives.png"
_FILES = (
    *(RUN_FILE, OUTPUT_FILE, ALTERNATIVES_FILE, "preview.png", "turntable.webp"),
    *(LOG_FILE, FILE_NAME),
)
VISIBILITY_PX = 128
"""Side of the picture in which P must be seen."""
COARSE = 1e-3
"""A spacing of float32 coordinates above this share of the object's size is worth a note: less than
a third of a pixel where the object fills 256."""


@dataclass(frozen=True, slots=True)
class Request:
    """What a user asked for; None means that a heuristic decides, and its reasons are recorded."""

    partial_path: Path
    prompt: str
    out: Path
    settings: CompletionSettings
    negative_prompt: str | None = None
    up: UpAxis = "Z"
    view_deg: tuple[float, float] | None = None  # azimuth, elevation of the input view c
    azimuth_range_deg: float = 50.0
    elevation_range_deg: float = 15.0
    center_file: tuple[float, float, float] | None = None
    size_file: float | None = None
    resume: bool = False
    alternatives: int = 0  # planes of symmetry whose guesses are drawn beside the result
    object_folder: Path | None = None  # what P belongs to, where that is known
    sources: dict[str, str] = field(default_factory=dict)  # which of these came from where
    notes: tuple[str, ...] = ()  # what is odd about the request


@dataclass(slots=True)
class Run:
    """A completion set up and ready to go, with all that decides its result."""

    request: Request
    source: SplatFile
    working: WorkingSet
    frame: ObjectFrame
    distribution: ViewDistribution
    first_views: ViewDistribution  # V as the prior's first guess was made with; see input_view
    prior: Prior
    conditioning: Conditioning
    notes: tuple[str, ...]
    completion: Completion
    identity: dict[str, Any]
    lock: FolderLock | None = None
    """No other process works in the run folder; None = as yet, or where there are no locks."""
    timings: dict[str, float] = field(default_factory=dict)


def prepare(request: Request, prior: Prior, device: torch.device | str = "cpu") -> Run:
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
    if request.resume:
        if not (request.out / RUN_FILE).exists():
            raise UserError(
                f"{request.out}: nothing to resume: there is no {RUN_FILE}; start without --resume"
            )
        lock = lock_folder(request.out)
        forget_leftovers(request.out, _FILES)
    source = read_splats(request.partial_path)
    require_appendable(source)
    chosen = working_set(
        source.splats, request.settings.max_working_splats, str(request.partial_path)
    )
    frame, distribution, notes = _decide_frame(request, chosen.splats, prior)
    conditioning = prior.condition(request.prompt, request.negative_prompt)
    partial = transform_splats(chosen.splats, frame.object_from_file)
    _require_visible(partial, distribution, request.partial_path)
    completion = Completion(
        partial,
        prior,
        conditioning,
        distribution,
        request.settings,
        largest_side(chosen.splats) / frame.size_file,
        device,
        view_is_guess=request.view_deg is None,
    )
    identity = {
        "input_sha256": sha256_of(request.partial_path),
        "prompt": request.prompt,
        "negative_prompt": request.negative_prompt,
        "prior": prior_identity(prior),
        "frame": frame.to_json(),
        "views": completion.distribution.to_json(),
        "settings": jsonio.to_json(request.settings),
    }
    del identity["settings"]["checkpoint_every"]  # decides nothing about the result
    oddities = (f"{request.partial_path}: {warning}" for warning in source.warnings)
    notes = (
        *request.notes,
        *oddities,
        *notes,
        chosen.summary(),
        *completion.start_notes,
        *conditioning.report,
    )
    if request.negative_prompt and not completion.heeds_negative_prompt:
        notes = (*notes, "negative prompt: without effect here (with this prior: --text-only)")
    run = Run(
        request,
        source.released(),
        chosen,
        frame,
        completion.distribution,
        distribution,
        prior,
        conditioning,
        notes,
        completion,
        identity,
        lock,
    )
    if request.resume:
        require_same_identity(request.out / RUN_FILE, identity)
        state = load_checkpoint(request.out / CHECKPOINTS)
        if state is not None:
            path = request.out / CHECKPOINTS / FILE_NAME
            check_fits(path, state, completion.state(), request.settings.steps)
            try:
                completion.restore(state)
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
    out, completion = run.request.out, run.completion
    started = time.perf_counter()
    try:
        take_steps(completion, out, run.request.settings.checkpoint_every, on_step)
    except NonFiniteError as error:
        stopped = NonFiniteError(error.step, error.tensor, _way_back(out / CHECKPOINTS))
        _write_run_file(run, "stopped", {"error": str(stopped)})
        raise stopped from error
    run.timings["optimise_s"] = time.perf_counter() - started
    return _finish(run)


def completing_seconds(timings: dict[str, float]) -> float:
    """Return the time that completing took, by ``run.json``'s timings: no files, no pictures."""
    return sum(timings[stage] for stage in ("prepare_s", "optimise_s", "finish_s"))


def _way_back(folder: Path) -> str:
    """Tell which checkpoint a stopped run can go on from."""
    state = load_checkpoint(folder)
    if state is None:
        return "; there is no checkpoint yet"
    return f"; the last good checkpoint is kept: {folder / FILE_NAME}, step {int(state['step'])}"


def _finish(run: Run) -> dict[str, Any]:
    """Write the completed splats, measure, and draw the pictures."""
    out = run.request.out
    started = time.perf_counter()
    partial = run.completion.partial.to("cpu")
    last = run.completion.new_splats().to("cpu")
    finished = finish_splats(last, partial, run.distribution, run.request.settings)
    new = finished.splats
    run.notes = (*run.notes, *finished.notes)
    run.timings["finish_s"] = time.perf_counter() - started
    started = time.perf_counter()
    in_file = transform_splats(new, run.frame.file_from_object)
    append_splats(
        out / OUTPUT_FILE,
        run.source,
        in_file,
        (
            f"gscomplete version {gscomplete.__version__}",
            f"gscomplete new_splats {len(new)}",
        ),
    )
    run.timings["write_s"] = time.perf_counter() - started
    whole = concatenate([partial, new])
    started = time.perf_counter()
    metrics = jsonio.to_json(evaluate(whole, partial, run.distribution))
    run.timings["measure_s"] = time.perf_counter() - started
    started = time.perf_counter()
    sheet = preview_sheet(partial, whole, run.distribution, title=run.request.prompt)
    save_image(sheet, out / "preview.png")
    save_turntable(whole, run.distribution, out / "turntable.webp")
    run.timings["pictures_s"] = time.perf_counter() - started
    started = time.perf_counter()
    alternatives = _draw_alternatives(run, partial, whole)
    run.timings["alternatives_s"] = time.perf_counter() - started
    result = {
        "metrics": metrics,
        "measured_with": run.working.stands_for,
        "new_splats": len(new),
        "peak_gpu_bytes": peak_gpu_bytes(),
        "seam_colors": jsonio.to_json(finished.seam_colors),
        "hard_preservation": jsonio.to_json(finished.hard_preservation),
        "alternatives": alternatives,
    }
    return _write_run_file(run, "finished", result)


def _draw_alternatives(run: Run, partial: Splats, whole: Splats) -> list[str]:
    """Draw the guesses that the user asked for; return the options that give them."""
    request = run.request
    if not request.alternatives:
        return []
    found = guess_alternatives(
        run.prior,
        partial,
        run.first_views,
        run.conditioning,
        request.settings,
        request.alternatives,
    )
    sheet = alternatives_sheet(found, partial, whole, run.distribution, request.prompt)
    save_image(sheet, request.out / ALTERNATIVES_FILE)
    return [alternative.option for alternative in found]


def _decide_frame(
    request: Request, splats: Splats, prior: Prior
) -> tuple[ObjectFrame, ViewDistribution, tuple[str, ...]]:
    """Take frame and input view from the request, and what is missing from the heuristic.

    Raises:
        UserError: nothing can be guessed from P, or the frame that is given is not P's.
    """
    notes: list[str] = []
    rotation = up_rotation(request.up)
    anchor = splats.means.double().median(dim=0).values
    level = transform_splats(splats, Similarity(1.0, rotation, -(rotation @ anchor)))
    center_file, size_file, view_deg = request.center_file, request.size_file, request.view_deg
    if center_file is None or size_file is None or view_deg is None:
        guess = guess_framing(level)
        is_boxed = center_file is not None and size_file is not None
        notes += guess.reasons(view=view_deg is None, box=not is_boxed)
        if center_file is None:
            lifted = rotation.T @ torch.tensor(guess.center, dtype=torch.float64) + anchor
            x, y, z = lifted.tolist()
            center_file = (x, y, z)
        size_file = guess.size if size_file is None else size_file
        if view_deg is None:
            view_deg = guess.view_azimuth_deg, guess.view_elevation_deg
    frame = ObjectFrame(request.up, center_file, size_file)
    if request.center_file is not None or request.size_file is not None:
        notes += check_given_frame(splats, frame, request.partial_path)
    fov_deg = prior.views.fov_deg
    distribution = ViewDistribution(
        *view_deg,
        azimuth_range_deg=request.azimuth_range_deg,
        elevation_range_deg=request.elevation_range_deg,
        radius=radius_to_fit(sum(prior.views.extent_range) / 2, fov_deg),
        fov_deg=fov_deg,
    )
    x, y, z = center_file
    notes.append(
        f"frame: up {request.up}, centre {x:.9g},{y:.9g},{z:.9g}, size {size_file:.6g} (file "
        f"units), input view {view_deg[0]:g},{view_deg[1]:g} degrees"
    )
    spacing = float(np.spacing(np.float32(max(map(abs, center_file)))))
    if spacing > COARSE * size_file:
        notes.append(
            f"far from the origin: float32 coordinates there are {spacing:.3g} apart, "
            f"{100 * spacing / size_file:.2g} % of the object's size; splats can lie no finer"
        )
    return frame, distribution, tuple(notes)


def _require_visible(partial: Splats, distribution: ViewDistribution, path: Path) -> None:
    """Refuse a P that the input view does not show: nothing could be preserved or measured.

    Raises:
        UserError: no pixel of the input view shows P.
    """
    with torch.no_grad():
        alpha = render(partial, distribution.input_camera(VISIBILITY_PX)).alpha
    if not bool(alpha.any()):
        raise UserError(
            f"{path}: expected splats that the input view shows, found none that it does; they "
            "are transparent, or the centre, the size or the input view is wrong"
        )


def _write_run_file(run: Run, status: str, result: dict[str, Any] | None) -> dict[str, Any]:
    """Write and return the content of ``run.json``."""
    folder = run.request.object_folder
    content = {
        "schema": "gscomplete.run",
        "version": 1,
        "status": status,
        "input": {
            "path": str(run.request.partial_path),
            "splats": run.source.n_rows,
            "object": None if folder is None else str(folder),
            "sources": run.request.sources,
        },
        "identity": run.identity,
        "notes": list(run.notes),
        "versions": {
            "gscomplete": gscomplete.__version__,
            "python": platform.python_version(),
            "torch": torch.__version__,
            "numpy": np.__version__,
        },
        "timings": {name: round(seconds, 3) for name, seconds in run.timings.items()},
        "result": result,
    }
    with atomic_path(run.request.out / RUN_FILE) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return content
