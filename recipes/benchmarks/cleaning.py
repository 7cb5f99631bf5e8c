"""Measure ``clean`` on trained captures: what each rule removes, and what that costs.

``python -m recipes.benchmarks.cleaning CAPTURE...``: for capture folders that ``images --hold-out``
wrote, the PSNR of held-out photos before and after, over the pixels that the object covers: those
where the splats of the box that ``crop --box auto`` proposes have an alpha above 1/2.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.render import RenderSettings, render
from gscomplete.splats import Splats
from gscomplete.util import jsonio
from gscomplete.util.atomic import atomic_path
from gscomplete.views import Cameras
from recipes.entry_point import start
from splatcomplete_data.clean.rules import clean_rows
from splatcomplete_data.multiview.capture_folder import SFM_FOLDER
from splatcomplete_data.multiview.crop import kept_rows
from splatcomplete_data.multiview.photos.capture import open_capture
from splatcomplete_data.multiview.photos.images import load_views
from splatcomplete_data.multiview.propose_box import propose_box
from splatcomplete_data.multiview.scene import Scene, read_scene
from splatcomplete_data.multiview.sfm.folder import MADE_FROM_FILE
from splatcomplete_data.multiview.sfm.structure_from_motion import SfmSettings
from splatcomplete_data.multiview.training.train import Target


@dataclass(frozen=True)
class Options:
    """Measure clean on trained captures."""

    captures: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Capture folders."""
    strengths: tuple[float, ...] = (0.25, 0.5, 0.75, 1.0)
    """Strengths measured."""
    json: Path | None = None
    """Write the numbers to this file."""


@dataclass(frozen=True)
class Cost:
    """One capture at one strength."""

    capture: str
    strength: float
    splats: int
    removed: dict[str, int]
    photos: int
    before_db: float
    """Mean over the photos."""
    after_db: float


def held_out(scene: Scene, folder: Path) -> list[Target]:
    """Return the photos of a capture that were held out, as its training saw them.

    Raises:
        UserError: none was, or they have gone.
    """
    assert scene.capture is not None
    source = scene.capture["source"]
    names = {camera["name"] for camera in scene.capture["cameras"] if camera["held_out"]}
    if not names:
        raise UserError(f"{folder}: expected photos that were held out (--hold-out), found none")
    poses, work = source["poses"], folder / SFM_FOLDER
    settings = None
    if poses == "structure from motion":
        made_from = work / MADE_FROM_FILE
        recorded = jsonio.read_json(made_from)["settings"]
        poses, settings = "sfm", jsonio.from_json(SfmSettings, recorded, str(made_from))
    posed = open_capture(Path(source["images"]), poses, work, settings, anew=False).posed
    photos = tuple(photo for photo in posed.photos if photo.path.name in names)
    size = scene.capture["identity"]["max_side_px"]
    views = load_views(dataclasses.replace(posed, photos=photos), max_side_px=size)
    return [Target.of(view, torch.device("cpu")) for view in views]


def measure(folder: Path, strengths: tuple[float, ...]) -> list[Cost]:
    """Clean one capture at every strength."""
    scene = read_scene(folder)
    if scene.capture is None:
        raise UserError(f"{folder}: expected a capture folder, found a splat file")
    photos = held_out(scene, folder)
    splats = scene.drawable()
    box = propose_box(scene.file.splats, scene.focus()).box
    inside, _ = kept_rows(scene.file, [box])
    subject = scene.file.splats.select(torch.from_numpy(inside))
    draw = RenderSettings(near=scene.near)
    masks = [_drawn(subject, photo.camera, draw)[1] > 0.5 for photo in photos]
    before = [_psnr(splats, *pair, draw) for pair in zip(photos, masks, strict=True)]
    costs = []
    for strength in strengths:
        cleaned = clean_rows(scene.file.splats, strength)
        kept = scene.file.splats.select(torch.from_numpy(cleaned.keep))
        after = [_psnr(kept, *pair, draw) for pair in zip(photos, masks, strict=True)]
        means = float(np.mean(before)), float(np.mean(after))
        total = len(scene.file.splats)
        costs.append(Cost(folder.name, strength, total, cleaned.reasons, len(photos), *means))
    return costs


def _drawn(splats: Splats, camera: Cameras, settings: RenderSettings) -> tuple[Tensor, Tensor]:
    """Return colours [H, W, 3] in [0, 1] and alpha [H, W]."""
    with torch.no_grad():
        drawn = render(splats, camera, settings=settings)
    return drawn.color[0].clamp(0, 1), drawn.alpha[0]


def _psnr(splats: Splats, photo: Target, mask: Tensor, settings: RenderSettings) -> float:
    """Return the PSNR in dB over a mask [H, W]."""
    color, _ = _drawn(splats, photo.camera, settings)
    error = float((color - photo.colors)[mask].double().square().mean())
    return -10.0 * float(np.log10(max(error, 1e-10)))


def main(options: Options) -> None:
    """Measure and report."""
    costs = []
    for folder in options.captures:
        for cost in measure(folder, options.strengths):
            costs.append(cost)
            removed = ", ".join(f"{count:,} {rule}" for rule, count in cost.removed.items())
            sys.stdout.write(
                f"{cost.capture} at {cost.strength:g}: {removed or 'nothing'} of {cost.splats:,} "
                f"removed; {cost.photos} photos, inside the object {cost.before_db:.2f} dB before, "
                f"{cost.after_db - cost.before_db:+.3f} dB\n"
            )
            sys.stdout.flush()
    if options.json:
        with atomic_path(options.json) as temporary:
            content = [dataclasses.asdict(cost) for cost in costs]
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    start(main, Options, __doc__)
