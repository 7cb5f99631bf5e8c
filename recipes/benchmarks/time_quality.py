"""Run time against error of settings: ``python -m recipes.benchmarks.time_quality --out DIR``.

Completes held-out procedural objects with a range of settings and writes, for each, the mean time
against the mean errors of hidden and seen regions. Settings are chosen here, never on the real
objects that completions are judged by.

Conventions
-----------
* Objects come from a seed that training never used, cut and disturbed as training's parts are;
  frame and input view are guessed from the part, as in a run.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageDraw
from rich.console import Console
from rich.progress import track

from gscomplete.api import complete
from gscomplete.completion.pipeline import framing_for
from gscomplete.completion.presets import GUESS, RECONSTRUCT, TEXT_ONLY, UNBOUNDED_GUESS
from gscomplete.completion.settings import CompletionSettings, TimestepStage
from gscomplete.evaluate.metrics import against_truth, preservation
from gscomplete.evaluate.pictures import contact_sheet, render_images, save_image
from gscomplete.framing.decide import FramingRequest
from gscomplete.priors import Prior, load_prior
from gscomplete.splats import Splats
from gscomplete.splats.transform import transform_splats
from gscomplete.splats.working_set import working_set
from gscomplete.util.atomic import atomic_path
from gscomplete.views import ViewDistribution
from gscomplete.views.frame import up_rotation
from recipes.entry_point import start
from recipes.train_embedded_prior.data.dataset import HELD_OUT_SEED_OFFSET
from recipes.train_embedded_prior.data.source import procedural_source

_SEED = HELD_OUT_SEED_OFFSET + 776


@dataclass(frozen=True, slots=True)
class HeldOutObject:
    """A held-out object in the frame guessed from its part."""

    caption: str
    part: Splats
    """P in the generator's frame, z up."""
    partial: Splats
    truth: Splats
    views: ViewDistribution


@dataclass(frozen=True)
class Options:
    """Time against quality over settings."""

    out: Path
    """Folder for ``time_quality.json``, ``time_quality.png`` and a sheet for each setting."""
    objects: int = 16
    """Held-out objects."""
    settings: tuple[str, ...] = ()
    """Settings by name; none = all."""


def variants() -> dict[str, CompletionSettings]:
    """Return the settings compared."""
    high = (TimestepStage(0.5, 450.0, 700.0), TimestepStage(1.0, 100.0, 400.0))
    change = dataclasses.replace
    return {
        "fast": UNBOUNDED_GUESS,
        "without bounds": change(GUESS, hard_preservation=None),
        "default": GUESS,
        "reconstruct": RECONSTRUCT,
        "twice as long": change(RECONSTRUCT, steps=2 * RECONSTRUCT.steps, rounds=16),
        "high noise": change(RECONSTRUCT, timesteps=high),
        "fast steps": change(
            RECONSTRUCT,
            learning_rates=change(
                RECONSTRUCT.learning_rates, means=2e-3, means_final=2e-4, log_scales=1e-2
            ),
        ),
        "from a sphere": change(TEXT_ONLY, see_input=True),
        "text only": TEXT_ONLY,
    }


def held_out(index: int, prior: Prior) -> HeldOutObject:
    """Make a held-out object."""
    item = procedural_source(_SEED, index)
    partial = item.partial(disturb=index % 2 == 0, slight=False)
    heeded = working_set(partial, None, item.caption, up_rotation("Z")).heeded
    framing = framing_for(heeded, FramingRequest(), prior)
    to_frame = framing.frame.object_from_file
    return HeldOutObject(
        item.caption,
        partial,
        transform_splats(partial, to_frame),
        transform_splats(item.splats, to_frame),
        framing.views,
    )


def measure(held: HeldOutObject, together: Splats, views: ViewDistribution) -> dict[str, float]:
    """Compare with the truth, and with P from V."""
    found = against_truth(together, held.partial, held.truth, held.views.ring(8, 128))
    cameras = views.cameras(views.measured(8), 64)
    kept = preservation(together, held.partial, cameras)
    return {
        "silhouette_iou": found.silhouette_iou,
        "hidden_iou": found.hidden_iou,
        "hidden_psnr_db": found.hidden_color_psnr_db or float("nan"),
        "e_color_v": kept.color,
        "e_depth_v": kept.depth,
    }


def means(rows: list[dict[str, float]]) -> dict[str, float]:
    """Return the mean of every number, objects without a hidden region left out of theirs."""
    return {key: float(np.nanmean([row[key] for row in rows])) for key in rows[0]}


def main(options: Options) -> None:
    """Complete, measure, draw."""
    options.out.mkdir(parents=True, exist_ok=True)
    prior = load_prior("embedded", "cpu")
    objects = [held_out(index, prior) for index in range(options.objects)]
    results: dict[str, dict[str, Any]] = {
        "input alone": means(
            [measure(held, held.partial, held.views) | {"seconds": 0.0} for held in objects]
        )
    }
    chosen = variants()
    for name in options.settings or tuple(chosen):
        rows, pictures = [], []
        for held in track(objects, name, console=Console(file=sys.stderr)):
            found = complete(held.part, held.caption, prior=prior, settings=chosen[name])
            together = found.in_object_frame
            rows.append(measure(held, together, found.views) | {"seconds": found.seconds})
            cameras = held.views.preview_cameras(96)[[0, 1, 3, 4]]
            pictures.append(
                [
                    image
                    for splats in (held.partial, together, held.truth)
                    for image in render_images(splats, cameras)
                ]
            )
        results[name] = means(rows)
        sys.stdout.write(f"{name:16}" + _line(results[name]) + "\n")
        labels = [held.caption[:24] for held in objects]
        sheet = contact_sheet(pictures, row_labels=labels, title=f"{name}: input, together, truth")
        save_image(sheet, options.out / f"{name.replace(' ', '_')}.png")
    with atomic_path(options.out / "time_quality.json") as temporary:
        temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    save_image(plot(results), options.out / "time_quality.png")


def _line(row: dict[str, float]) -> str:
    return (
        f"{row['seconds']:6.1f} s  silhouette {row['silhouette_iou']:.3f}  hidden "
        f"{row['hidden_iou']:.3f}  PSNR {row['hidden_psnr_db']:.2f} dB  E_color V "
        f"{row['e_color_v']:.6f}  E_depth V {row['e_depth_v']:.6f}"
    )


def plot(results: dict[str, dict[str, Any]]) -> Image.Image:
    """Draw seconds (across) against silhouette IoU (up)."""
    width, height, margin = 640, 400, 50
    picture = Image.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(picture)
    seconds = [row["seconds"] for row in results.values()]
    ious = [row["silhouette_iou"] for row in results.values()]
    low, high = min(ious) - 0.02, max(ious) + 0.02
    longest = max(max(seconds), 1.0) * 1.25
    draw.line([(margin, 10), (margin, height - margin), (width - 10, height - margin)], "black")
    draw.text((width // 2, height - 30), f"seconds, 0 to {longest:.0f}", "black")
    draw.text((5, 10), f"silhouette IoU, {low:.2f} to {high:.2f}", "black")
    for name, row in results.items():
        x = margin + (width - margin - 10) * row["seconds"] / longest
        y = height - margin - (height - margin - 30) * (row["silhouette_iou"] - low) / (high - low)
        draw.ellipse([x - 3, y - 3, x + 3, y + 3], fill="black")
        draw.text((x + 6, y - 6), name, "black")
    return picture


if __name__ == "__main__":
    torch.set_num_threads(2)
    start(main, Options, __doc__)
