"""A reconstruction as a user runs it: photos in, capture folder out.

A capture folder holds ``splats.ply`` (in the world frame of the poses), ``capture.json`` (all that
decided the result, the cameras, and what came of it), ``preview.png`` (photos above renders),
``log.jsonl`` (one line per step), ``checkpoints/`` and, after structure from motion, ``sfm/``. All
but the log are written atomically, and an old capture stays until a new run is set up
(``capture_folder``).
"""

from __future__ import annotations

import dataclasses
import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from PIL import Image

import gscomplete
from gscomplete.errors import UserError
from gscomplete.evaluate.pictures import contact_sheet, save_image, to_image
from gscomplete.fitting.checkpoint import FILE_NAME, check_fits, load_checkpoint
from gscomplete.fitting.step_loop import (
    CHECKPOINTS,
    LOG_FILE,
    logged_seconds,
    require_same_identity,
    run_steps,
)
from gscomplete.render import render
from gscomplete.render.settings import RenderSettings
from gscomplete.splats import Splats, write_splats
from gscomplete.util import jsonio
from gscomplete.util.folder_lock import FolderLock
from splatcomplete_data.multiview.capture_folder import (
    CAPTURE_FILE,
    PREVIEW_FILE,
    SFM_FOLDER,
    SPLATS_FILE,
    capture_folder,
)
from splatcomplete_data.multiview.photos.capture import (
    Capture,
    find_masks,
    open_capture,
    up_direction,
)
from splatcomplete_data.multiview.photos.images import (
    View,
    load_views,
    orientation_note,
)
from splatcomplete_data.multiview.photos.posed import PosedPhotos
from splatcomplete_data.multiview.request import Request
from splatcomplete_data.multiview.sfm.structure_from_motion import (
    Progress,
    has_pycolmap,
    triangulate,
)
from splatcomplete_data.multiview.training.initial import (
    initial_splats,
    masked_points,
    near_points,
    random_points,
)
from splatcomplete_data.multiview.training.settings import TrainingSettings
from splatcomplete_data.multiview.training.train import StepReport, Training, evaluate_views
from splatcomplete_data.scan import PointCloud

SCHEMA = "splatcomplete.capture"
TRIANGULATED = "triangulated with the given poses"
"""Origin of initial points that structure from motion finds for poses that are not its own."""
_FEWEST_POINTS = 100
"""If the sparse cloud has fewer points, training starts from random ones."""


@dataclass(slots=True)
class Reconstruction:
    """A reconstruction set up and ready to go."""

    request: Request
    capture: Capture
    training: Training
    train_views: list[View]
    held_out: list[View]
    identity: dict[str, Any]
    notes: tuple[str, ...]
    timings: dict[str, float]
    lock: FolderLock | None = None
    """Keeps other processes out of the capture folder; None = not taken yet, or no locks exist."""


def prepare(
    request: Request, device: torch.device, progress: Progress | None = None
) -> Reconstruction:
    """Read photos, find what is missing, and set up step 0 or that of the last checkpoint.

    Raises:
        UserError: the photos, an option or the output folder is wrong.
    """
    chosen = {"resume": request.resume, "overwrite": request.overwrite}
    with capture_folder(request.out, **chosen) as lock:
        run = _set_up(request, device, progress)
        run.lock = lock
        _write_capture_file(run, "running", None)
    return run


def _set_up(
    request: Request, device: torch.device, progress: Progress | None = None
) -> Reconstruction:
    """Do what ``prepare`` does, in an output folder that is ready for it."""
    started = time.perf_counter()
    begun = request.resume and (request.out / CAPTURE_FILE).is_file()
    if begun:
        _require_same_options(request)
    work = request.out / SFM_FOLDER
    # Training that has begun goes on from its own poses and points only.
    capture = open_capture(
        request.images,
        request.poses,
        work,
        request.sfm,
        progress,
        anew=not begun,
        allow_outside=request.allow_outside,
    )
    timings = {"poses_s": time.perf_counter() - started}
    started = time.perf_counter()
    masks = request.masks or find_masks(request.images)
    views = load_views(
        capture.posed,
        max_side_px=request.max_side_px,
        masks=masks,
        mask_means=request.mask_means,
    )
    train, held_out = _divide(views, request.hold_out)
    timings["photos_s"] = time.perf_counter() - started
    started = time.perf_counter()
    points, origin, points_notes = _initial_points(request, capture, train, progress, begun)
    initial, thinning = initial_splats(points, request.training)
    timings["points_s"] = time.perf_counter() - started
    turned = orientation_note([photo.path for photo in capture.posed.photos])
    notes = (
        *capture.posed.notes,
        *([turned] if turned else []),
        f"{len(train)} photos to train on, {len(held_out)} held out, "
        f"{views[0].camera.width} x {views[0].camera.height} pixels",
        *points_notes,
        *thinning,
    )
    training = Training(train, initial, capture.posed.extent(), request.training, device)
    uses_sfm = capture.world_from_source is not None or origin == TRIANGULATED
    identity = _identity(request, views, initial, uses_sfm)
    if begun:
        require_same_identity(request.out / CAPTURE_FILE, identity)
        state = load_checkpoint(request.out / CHECKPOINTS)
        if state is not None:
            path = request.out / CHECKPOINTS / FILE_NAME
            check_fits(path, state, training.state(), request.training.steps)
            training.restore(state)
    return Reconstruction(request, capture, training, train, held_out, identity, notes, timings)


def execute(run: Reconstruction, on_step: Callable[[StepReport], None]) -> dict[str, Any]:
    """Take all remaining steps, write the results, and return the content of ``capture.json``.

    Raises:
        UserError: a value stopped being finite, no splat is left, or a file cannot be written.
    """
    out, training = run.request.out, run.training
    earlier_s = logged_seconds(out / LOG_FILE, training.step_number)  # of a run that is resumed
    started = time.perf_counter()
    run_steps(training, out, run.request.checkpoint_every, on_step)
    run.timings["train_s"] = earlier_s + time.perf_counter() - started
    return _finish(run)


def _finish(run: Reconstruction) -> dict[str, Any]:
    """Write the splats, measure, and draw the preview.

    Raises:
        UserError: no splat is left, or a file cannot be written.
    """
    out, settings = run.request.out, run.request.training
    splats = run.training.splats()
    if len(splats) == 0:
        raise UserError(
            f"{run.request.images}: expected splats at the end of the training, found none left; "
            "--steps or --random-points may be too few"
        )
    write_splats(
        out / SPLATS_FILE, splats, (f"splatcomplete-data images {gscomplete.__version__}",)
    )
    extent = run.training.extent
    result: dict[str, Any] = {"splats": len(splats)}
    sample = run.train_views[:: max(1, len(run.train_views) // 8)]
    result["train_psnr_db"] = float(np.mean(evaluate_views(splats, sample, extent, settings)))
    if run.held_out:
        values = evaluate_views(splats, run.held_out, extent, settings)
        result["held_out_psnr_db"] = float(np.mean(values))
        names = [view.name for view in run.held_out]
        result["held_out_psnr_db_per_photo"] = dict(zip(names, values, strict=True))
    shown = run.held_out or run.train_views
    save_image(_preview(splats, shown, extent, settings), out / PREVIEW_FILE)
    return _write_capture_file(run, "finished", result)


def _preview(
    splats: Splats, views: Sequence[View], extent: float, settings: TrainingSettings
) -> Image.Image:
    """Show up to six photos above the renders of their views."""
    chosen = views[:: max(1, -(-len(views) // 6))]
    photos, renders = [], []
    draw = RenderSettings(near=settings.near_extent * extent)
    for view in chosen:
        with torch.no_grad():
            color = render(splats, view.camera.to(dtype=torch.float32), settings=draw).color[0]
        size = (max(1, view.camera.width * 240 // view.camera.height), 240)
        renders.append(to_image(color).resize(size))
        photos.append(Image.fromarray(view.colors).resize(size))
    return contact_sheet(
        [photos, renders], row_labels=["photo", "splats"], column_labels=[v.name for v in chosen]
    )


def _initial_points(
    request: Request, capture: Capture, views: list[View], progress: Progress | None, begun: bool
) -> tuple[PointCloud, str, tuple[str, ...]]:
    """Return the points to start from, where they come from, and notes.

    Points that the cameras are far from, or that lie outside the photos' masks, do not count.

    Raises:
        UserError: points are asked for and cannot be had.
    """
    posed = capture.posed
    notes: tuple[str, ...] = ()
    if request.start != "random":
        points, origin = posed.points, "the capture's own"
        # Where COLMAP found the poses, it has given all the points that it can find.
        is_given = capture.world_from_source is None
        if points is None and is_given and (request.start == "points" or has_pycolmap()):
            points, notes = _triangulated(request, posed, views, progress, begun)
            origin = TRIANGULATED
        if points is not None:
            points = masked_points(near_points(points, posed), views)
        if points is not None and len(points) >= _FEWEST_POINTS:
            return points, origin, (*notes, f"{len(points):,} initial points, {origin}")
        if request.start == "points":
            raise UserError(
                f"{request.images}: expected at least {_FEWEST_POINTS} matched points (on the "
                f"object, where there are masks) to start from, found "
                f"{0 if points is None else len(points)}; --start random does without"
            )
    cloud = random_points(posed, views, request.random_points, request.training.seed)
    cloud = masked_points(near_points(cloud, posed), views)
    return cloud, "random", (*notes, f"{len(cloud):,} initial points, random")


def _triangulated(
    request: Request,
    posed: PosedPhotos,
    views: list[View],
    progress: Progress | None,
    begun: bool,
) -> tuple[PointCloud | None, tuple[str, ...]]:
    """Return the points that the photos trained on show, None without any, and notes."""
    trained = {view.name for view in views}
    named = zip(posed.names, posed.photos, strict=True)
    known = dataclasses.replace(
        posed, photos=tuple(photo for name, photo in named if name in trained)
    )
    return triangulate(known, request.out / SFM_FOLDER, request.sfm, progress, anew=not begun)


def _divide(views: list[View], hold_out: int) -> tuple[list[View], list[View]]:
    """Divide views into those trained on and every ``hold_out``-th, the first among them."""
    if hold_out == 0:
        return views, []
    if hold_out < 2:
        raise UserError(f"--hold-out: expected 0 or at least 2, found {hold_out}")
    return [v for i, v in enumerate(views) if i % hold_out], views[::hold_out]


def _identity(
    request: Request, views: list[View], initial: Splats, uses_sfm: bool
) -> dict[str, Any]:
    """Return what a resumed run must have in common with the first: all that training sees."""
    digest = hashlib.sha256()
    for view in views:
        camera = view.camera
        shown = "everything" if view.alpha is None else "an object"
        facts = f"{view.name}\n{camera.width} {camera.height} {shown}\n"
        digest.update(facts.encode(errors="surrogatepass"))
        for values in (camera.camera_from_world, camera.focal_px, camera.center_px):
            digest.update(values.numpy().tobytes())
        for pixels in (view.colors, view.weight, view.alpha):
            digest.update(b"" if pixels is None else pixels.tobytes())
    for values in (initial.means, initial.sh):
        digest.update(values.numpy().tobytes())
    return {
        **_option_identity(request),
        "sfm": jsonio.to_json(request.sfm) if uses_sfm else None,
        "views_points_sha256": digest.hexdigest(),
    }


def _option_identity(request: Request) -> dict[str, Any]:
    """Return the part of the identity that is known before anything is read."""
    training = dataclasses.replace(request.training, rates=request.training.step_sizes)
    return {
        "max_side_px": request.max_side_px,
        "hold_out": request.hold_out,
        "mask_means": request.mask_means,
        "training": jsonio.to_json(training),
    }


def _require_same_options(request: Request) -> None:
    """Refuse other options than those that a run began with, before any work is done.

    Raises:
        UserError: they differ.
    """
    path = request.out / CAPTURE_FILE
    data = jsonio.read_json(path)
    stored = data.get("identity") if isinstance(data, dict) else None
    identity = _option_identity(request)
    if isinstance(stored, dict) and stored.get("sfm") is not None:
        identity["sfm"] = jsonio.to_json(request.sfm)
    require_same_identity(path, identity)


def _write_capture_file(
    run: Reconstruction, status: str, result: dict[str, Any] | None
) -> dict[str, Any]:
    """Write and return the content of ``capture.json``."""
    posed, world = run.capture.posed, run.capture.world_from_source
    held_out = {view.name for view in run.held_out}
    cameras = [
        {
            "name": view.name,
            "width": view.camera.width,
            "height": view.camera.height,
            "focal_px": view.camera.focal_px[0].tolist(),
            "center_px": view.camera.center_px[0].tolist(),
            "camera_from_world": view.camera.camera_from_world[0].tolist(),
            "held_out": view.name in held_out,
        }
        for view in sorted([*run.train_views, *run.held_out], key=lambda view: view.name)
    ]
    content = {
        "schema": SCHEMA,
        "version": 1,
        "status": status,
        "source": {"images": str(run.request.images), "poses": posed.source},
        "identity": run.identity,
        "notes": list(run.notes),
        "world_from_source": None if world is None else world.to_json(),
        "look_at": posed.look_at().tolist(),
        "up": up_direction(posed).tolist(),
        "extent": run.training.extent,
        "tool_version": gscomplete.__version__,
        "timings": {name: round(seconds, 3) for name, seconds in run.timings.items()},
        "result": result,
        "cameras": cameras,
    }
    jsonio.write_json(run.request.out / CAPTURE_FILE, content)
    return content
