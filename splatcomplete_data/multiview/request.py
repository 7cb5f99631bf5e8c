"""What a user asks of a reconstruction, and what of it decides the result."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from gscomplete.fitting.step_loop import require_same_identity
from gscomplete.splats import Splats
from gscomplete.util import jsonio
from splatcomplete_data.multiview.capture_folder import CAPTURE_FILE
from splatcomplete_data.multiview.photos.images import MaskMeaning, View
from splatcomplete_data.multiview.sfm.structure_from_motion import SfmSettings
from splatcomplete_data.multiview.training.settings import TrainingSettings

Start = Literal["auto", "points", "random"]
"""``points``: the capture's sparse cloud, triangulated with pycolmap if it has none. ``random``:
random points that the cameras see. ``auto``: points where they can be had."""


@dataclass(frozen=True, slots=True)
class Request:
    """What a user asked for."""

    images: Path
    out: Path
    poses: str = "auto"
    masks: Path | None = None  # None = looked for beside the photos
    mask_means: MaskMeaning = "object"
    allow_outside: Path | None = None
    """Folder below which files that a transforms.json names are read, too."""
    max_side_px: int = 640
    hold_out: int = 0
    """Every this many-th photo is kept for measuring; 0 = all are trained on."""
    start: Start = "auto"
    random_points: int = 30_000
    checkpoint_every: int = 500
    resume: bool = False
    overwrite: bool = False
    training: TrainingSettings = field(default_factory=TrainingSettings)
    sfm: SfmSettings = field(default_factory=SfmSettings)


def identity_of(
    request: Request, views: list[View], initial: Splats, uses_sfm: bool
) -> dict[str, Any]:
    """Return what a resumed run must have in common with the first: all that training sees."""
    digest = hashlib.sha256()
    for view in views:
        camera = view.camera
        shown = "everything" if view.alpha is None else "an object"
        digest.update(f"{view.name}\n{camera.width} {camera.height} {shown}\n".encode())
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
    return {
        "max_side_px": request.max_side_px,
        "hold_out": request.hold_out,
        "mask_means": request.mask_means,
        "training": jsonio.to_json(request.training),
    }


def require_same_options(request: Request) -> None:
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
