"""Reconstruct a real capture and measure it: ``python -m recipes.benchmarks.multiview``.

By default: the fox photos at quarter resolution (270 x 480) with their given poses, every eighth
photo held out. ``--poses sfm`` finds the poses from the photos alone and reports how many register;
``--sfm-only`` stops there.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import torch

from gscomplete.util import jsonio
from gscomplete.util.atomic import atomic_path
from recipes.entry_point import start
from splatcomplete_data.multiview.photos.capture import photo_folder
from splatcomplete_data.multiview.photos.images import list_photos
from splatcomplete_data.multiview.reconstruct import execute, prepare
from splatcomplete_data.multiview.request import Request
from splatcomplete_data.multiview.sfm.structure_from_motion import find_poses
from splatcomplete_data.multiview.training.settings import GrowthSettings, TrainingSettings
from splatcomplete_data.multiview.training.train import StepReport


@dataclass(frozen=True)
class Options:
    """Reconstruct a capture and print what it took and gave."""

    images: Path = Path("../shared/data/multiview/fox")
    """Folder of the capture."""
    out: Path = Path("runs/benchmark_multiview")
    """Capture folder to write; an older capture in it is replaced."""
    poses: str = "auto"
    """auto = the given ones, if there are any; sfm = from the photos alone."""
    sfm_only: bool = False
    """Only find the poses from the photos."""
    max_side: int = 480
    """Longest side of the photos in pixels."""
    steps: int = 3000
    """Optimiser steps."""
    max_splats: int = 80_000
    """Cap on the number of splats."""
    start: str = "auto"
    """Initial splats: auto, points or random."""
    hold_out: int = 8
    """N = hold out every Nth photo."""
    json: Path | None = None
    """Add the numbers to the list in this file, for ``recipes.benchmarks.curves``."""


def main(options: Options) -> int:
    """Run and print one JSON object."""
    started = time.perf_counter()
    if options.sfm_only:
        images = photo_folder(options.images)
        capture = find_poses(images, options.out)
        report: dict[str, object] = {
            "photos": len(list_photos(images)),
            "registered": len(capture.photos),
            "points": 0 if capture.points is None else len(capture.points),
        }
    else:
        growth = GrowthSettings(max_splats=options.max_splats)
        request = Request(
            images=options.images,
            out=options.out,
            poses=options.poses,
            max_side_px=options.max_side,
            hold_out=options.hold_out,
            start=options.start,  # type: ignore[arg-type]
            overwrite=True,
            training=TrainingSettings(steps=options.steps, growth=growth),
        )
        run = prepare(request, torch.device("cpu"))

        def show(step: StepReport) -> None:
            if step.step % 250 == 0:
                sys.stderr.write(f"step {step.step}: loss {step.loss:.4f}, {step.splats} splats\n")

        content = execute(run, show)
        report = {"notes": content["notes"], "timings": content["timings"], **content["result"]}
    report["seconds"] = round(time.perf_counter() - started, 1)
    sys.stdout.write(json.dumps(report, indent=2) + "\n")
    if options.json is not None:
        rows = jsonio.read_json(options.json) if options.json.exists() else []
        rows.append({"capture": options.images.name, "steps": options.steps, **report})
        with atomic_path(options.json) as temporary:
            temporary.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    start(main, Options, __doc__)
