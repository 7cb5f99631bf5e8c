"""What a user asks of a reconstruction from photos."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from splatcomplete_data.multiview.photos.images import MaskMeaning
from splatcomplete_data.multiview.sfm.structure_from_motion import SfmSettings
from splatcomplete_data.multiview.training.settings import TrainingSettings

Start = Literal["auto", "points", "random"]
"""``points``: the capture's sparse cloud, triangulated with pycolmap if it has none. ``random``:
random points that the cameras see. ``auto``: points where they can be had."""


@dataclass(frozen=True, slots=True)
class Request:
    """What a user asked for."""

    images: Path
    """Folder of the photos."""
    out: Path
    """Capture folder to write."""
    poses: str = "auto"
    """auto = those found with the photos, else sfm; sfm = structure from motion; or a path."""
    masks: Path | None = None
    """Folder of masks; None = looked for beside the photos."""
    mask_means: MaskMeaning = "object"
    """What is white in masks."""
    allow_outside: Path | None = None
    """Folder below which files that a transforms.json names are read, too."""
    max_side_px: int = 640
    """Photos are scaled down to this side."""
    hold_out: int = 0
    """Every this many-th photo is kept for measuring; 0 = all are trained on."""
    start: Start = "auto"
    """What training starts from."""
    random_points: int = 30_000
    """Most random points."""
    checkpoint_every: int = 500
    """Steps; 0 = only at the end."""
    resume: bool = False
    """Go on with the training in ``out``."""
    overwrite: bool = False
    """Replace a capture in ``out``."""
    training: TrainingSettings = field(default_factory=TrainingSettings)
    """How splats are trained."""
    sfm: SfmSettings = field(default_factory=SfmSettings)
    """How poses are found."""
