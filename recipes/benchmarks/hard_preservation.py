"""Cost of bounds on P's appearance: ``python -m recipes.benchmarks.hard_preservation --out DIR``.

Real objects with a known truth are completed (with P shown to the prior, and from text only), and
bounds on E_color and E_depth are then enforced. Measured before and after: the errors from views
that were not used for it, the hidden region against the truth, seconds, and the changes to the new
splats.

Even the true object does not always preserve P's appearance: where P is cut so that V looks into
it, the missing part occludes P. The table gives the true object's own errors, since a bound below
them can be kept only by leaving out a part that really exists.
"""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from PIL import Image
from rich.console import Console
from rich.progress import track

from gscomplete.completion.preserve.bounds import preserve_hard
from gscomplete.completion.settings import HardPreservationSettings
from gscomplete.evaluate.metrics import against_truth, preservation
from gscomplete.evaluate.pictures import contact_sheet, render_images, save_image
from gscomplete.priors import Prior, load_prior
from gscomplete.priors.base import prior_identity
from gscomplete.splats import Splats, concatenate, read_splats, write_splats
from gscomplete.util import jsonio
from gscomplete.views import Cameras
from recipes.entry_point import start
from recipes.real_objects.compare import FramedObject, completed_as_run, frame_object, settings_of
from recipes.real_objects.complete import DATA
from recipes.real_objects.load import load_real_object
from recipes.results import Results

Way = Literal["default", "text"]
OBJECTS = (
    "blue_mug", "apple", "duck", "cow", "bottle", "speaker", "statue", "soccer_ball",
    "knight", "lantern", "armchair", "armadillo",
)  # fmt: skip
UNSEEN_VIEWS = 64
"""Views of V that errors are measured over, drawn at random."""
UNSEEN_SEED = 20_000


@dataclass(frozen=True)
class Options:
    """Hold completions of real objects to bounds on P's appearance."""

    out: Path
    """Folder for ``hard_preservation.json``, ``.png``, and the completions as splat files."""
    names: tuple[str, ...] = OBJECTS
    """Objects by name; their truth must be known."""
    ways: tuple[Way, ...] = ("default", "text")
    """The default preset, and the same with P withheld from the prior."""
    completions: tuple[Path, ...] = ()
    """Folders with NAME.WAY.ply of ``recipes.real_objects.compare``, to be taken as they are."""
    data: Path = DATA
    """Folder of the real data."""
    size_px: int = 256
    """Side of the views that are measured."""
    seed: int = 0
    bounds: HardPreservationSettings = field(default_factory=HardPreservationSettings)


def completion(framed: FramedObject, way: Way, options: Options, prior: Prior) -> Splats:
    """Read the new splats from a folder that has them, or make them and keep them."""
    name = f"{framed.item.name}.{way}.ply"
    for folder in (*options.completions, options.out):
        if (folder / name).exists():
            return read_splats(folder / name).splats
    settings = dataclasses.replace(settings_of(way, prior, options.seed), hard_preservation=None)
    made = completed_as_run(framed, prior, settings).splats
    write_splats(options.out / name, made)
    return made


def remainder(partial: Splats, truth: Splats) -> Splats:
    """Return the splats of the true object that P lacks."""
    known = {row.tobytes() for row in partial.means.numpy()}
    lacking = [row.tobytes() not in known for row in truth.means.numpy()]
    return truth.select(torch.tensor(lacking))


def measure(framed: FramedObject, partial: Splats, new: Splats, cameras: Cameras) -> dict[str, Any]:
    """Return errors over unseen views of V, and the hidden region's against the truth."""
    together = concatenate([partial, new])
    kept = preservation(together, partial, cameras)
    row: dict[str, Any] = {"e_color": kept.color, "e_depth": kept.depth, "new_splats": len(new)}
    if framed.truth is not None:
        truth = framed.truth.with_sh_degree(0)
        found = against_truth(together, partial, truth, framed.views.ring(8, 256))
        row |= {
            "hidden_iou": found.hidden_iou,
            "hidden_psnr_db": found.hidden_color_psnr_db,
            "hidden_precision": found.hidden_precision,
            "hidden_recall": found.hidden_recall,
        }
    return row


def bounded(
    framed: FramedObject, way: Way, options: Options, prior: Prior
) -> tuple[dict[str, Any], list[Image.Image]]:
    """Return the numbers and pictures of one object completed one way."""
    partial = framed.partial.with_sh_degree(0)
    new = completion(framed, way, options, prior)
    angles = framed.views.sample(UNSEEN_SEED + options.seed, 0, UNSEEN_VIEWS)
    cameras = framed.views.cameras(angles, options.size_px)
    done = preserve_hard(new, partial, framed.views, options.bounds, options.seed)
    row = {
        "before": measure(framed, partial, new, cameras),
        "after": measure(framed, partial, done.splats, cameras),
        "report": jsonio.to_json(done.report),
    }
    if framed.truth is not None:
        rest = remainder(partial, framed.truth.with_sh_degree(0))
        row["truth"] = measure(framed, partial, rest, cameras)
    shown = framed.views.preview_cameras(144)[[0, 1, 3, 5]]
    pictures = [
        *render_images(partial, framed.views.input_camera(144)),
        *render_images(concatenate([partial, new]), shown),
        *render_images(concatenate([partial, done.splats]), shown),
    ]
    return row, pictures


def main(options: Options) -> None:
    """Complete, hold to the bounds, measure, draw."""
    prior = load_prior("embedded", "cpu")
    made_with = {"seed": options.seed, "prior": prior_identity(prior)}
    results = Results(options.out / "hard_preservation.json", made_with)
    results.rows.clear()  # bounds are cheap to try again; what is kept are the completions
    pictures: list[list[Image.Image]] = []
    for name in track(options.names, "objects", console=Console(file=sys.stderr)):
        framed = frame_object(load_real_object(name, options.data), prior)
        for way in options.ways:
            key = f"{name}.{way}"
            results.rows[key], row = bounded(framed, way, options, prior)
            pictures.append(row)
            results.save()
    title = "P from c | before: c, c + 60, c + 180, c + 300 | after"
    sheet = contact_sheet(pictures, row_labels=list(results.rows), title=title)
    save_image(sheet, options.out / "hard_preservation.png")
    sys.stdout.write(table(results.rows, options.bounds))


def table(results: dict[str, dict[str, Any]], bounds: HardPreservationSettings) -> str:
    """Show one line for each completion, and what the means and the worst are."""
    head = f"{'':22}{'E_color':>18}{'E_depth':>18}{'truth c / d':>18}{'hidden IoU':>14}"
    lines = [head + f"{'PSNR dB':>14}{'s':>6}  untouched faded moved removed"]
    kept, ratios = 0, []
    for key, row in results.items():
        before, after, report = row["before"], row["after"], row["report"]
        truth = row.get("truth", {"e_color": float("nan"), "e_depth": float("nan")})
        holds = after["e_color"] <= bounds.color_bound and after["e_depth"] <= bounds.depth_bound
        kept += holds
        lines.append(
            f"{key:20}{' ' if holds else '!'} "
            + _pair(before, after, "e_color", "9.5f")
            + _pair(before, after, "e_depth", "9.5f")
            + f"{truth['e_color']:9.5f}{truth['e_depth']:9.5f}"
            + _pair(before, after, "hidden_iou", "7.3f")
            + _pair(before, after, "hidden_psnr_db", "7.2f")
            + f"{report['seconds']:6.1f}  {report['untouched']:9,} {report['faded']:5,} "
            + f"{report['moved']:5,} {sum(report['dropped'].values()):6,}"
        )
        within = truth["e_color"] <= bounds.color_bound and truth["e_depth"] <= bounds.depth_bound
        if within and before.get("hidden_iou"):
            ratios.append(after["hidden_iou"] / before["hidden_iou"])
    lines.append(f"within the bounds from unseen views: {kept} of {len(results)}")
    if ratios:
        lines.append(
            f"hidden IoU after / before where the truth is within the bounds too ({len(ratios)}): "
            f"mean {np.mean(ratios):.4f}, least {min(ratios):.4f}"
        )
    return "\n".join(lines) + "\n"


def _pair(before: dict[str, Any], after: dict[str, Any], key: str, form: str) -> str:
    """Show a number before and after; nothing where it is unknown."""
    values = (row.get(key) for row in (before, after))
    return "".join(format(float("nan") if v is None else v, form) for v in values)


if __name__ == "__main__":
    start(main, Options, __doc__)
