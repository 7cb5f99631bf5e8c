"""Render single views back from their own camera: ``python -m recipes.benchmarks.single_view``.

What is measured, over the pixels that became points (valid depth, no flying pixel): PSNR of the
colours over mid-grey, so that holes count, and coverage, the share of those pixels whose alpha is
at least 1/2. Splats have the automatic size.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.views import Cameras
from recipes.entry_point import start
from splatcomplete_data.points import points_to_splats
from splatcomplete_data.singleview.load import SingleView, SingleViewSettings, load_single_view

GREY = 0.5
FOLDER = "singleview"
_CUPOCH = "cupoch/rgbd"
CASES: tuple[tuple[str, str, str, SingleViewSettings], ...] = (
    (
        "motorcycle",
        "middlebury_motorcycle/motorcycle_left.png",
        "middlebury_motorcycle/motorcycle_disp.npz",
        SingleViewSettings(
            kind="disparity", baseline=0.193001, disparity_offset=31.086, focal_px=(994.978,)
        ),
    ),
    *(
        (
            f"room {number}",
            f"{_CUPOCH}/color/0000{number}.jpg",
            f"{_CUPOCH}/depth/0000{number}.png",
            SingleViewSettings(focal_px=(525.0,), center_px=(319.5, 239.5)),
        )
        for number in (0, 2, 4)
    ),
    (
        "desk (TUM)",
        f"{_CUPOCH}/other_formats/TUM_color.png",
        f"{_CUPOCH}/other_formats/TUM_depth.png",
        SingleViewSettings(unit=0.0002, focal_px=(525.0,), center_px=(319.5, 239.5)),
    ),
    (
        "dining room (Kinect)",
        "slambook2/ch5/rgbd/color/1.png",
        "slambook2/ch5/rgbd/depth/1.pgm",
        SingleViewSettings(focal_px=(518.0, 519.0), center_px=(325.5, 253.5)),
    ),
)


@dataclass(frozen=True)
class Options:
    """Render single views back from their own camera."""

    data: Path = Path("../shared/data")
    """Folder with MANIFEST.tsv."""
    sigma_per_spacing: float = 0.5
    """Splat size over the cloud's spacing; 0.5 is what `depth` uses."""


def own_camera(view: SingleView) -> Cameras:
    """Return the photo's camera; points are in its axes."""
    lens = view.camera
    return Cameras(
        torch.eye(4)[None],
        torch.tensor([[lens.focal_x_px, lens.focal_y_px]]),
        torch.tensor([[lens.center_x_px, lens.center_y_px]]),
        lens.width,
        lens.height,
    )


def score(view: SingleView, splats: Splats) -> tuple[float, float]:
    """Return PSNR in dB over the kept pixels, and the share of them that is covered."""
    with torch.no_grad():
        drawn = render(splats, own_camera(view), torch.full((3,), GREY))
    error = np.square(drawn.color[0].numpy().clip(0, 1) - view.color)[view.kept].mean()
    covered = float((drawn.alpha[0].numpy()[view.kept] >= 0.5).mean())
    return -10 * math.log10(max(float(error), 1e-10)), covered


def main(options: Options) -> None:
    """Measure every case and report."""
    from splatcomplete_data.points import PointSplatSettings

    settings = PointSplatSettings(sigma_per_spacing=options.sigma_per_spacing)
    for name, image, depth, how in CASES:
        folder = options.data / FOLDER
        view = load_single_view(folder / image, folder / depth, how)
        splats = points_to_splats(view.cloud.points, view.cloud.colors, settings)
        psnr_db, coverage = score(view, splats)
        row = {
            "case": name,
            "points": len(splats),
            "flying": view.steps[-1].before - view.steps[-1].after,
            "splat_size": round(float(splats.scales[0, 0]), 6),
            "psnr_db": round(psnr_db, 2),
            "coverage": round(coverage, 5),
        }
        sys.stdout.write(json.dumps(row) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    start(main, Options, __doc__)
