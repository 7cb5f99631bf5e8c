"""Complete the real objects and measure: ``python -m recipes.real_objects.complete --out DIR``.

Every object gets a run folder as ``gscomplete complete`` would make it, without manual input:
prompt and up axis come from the table, everything else from the heuristics. Where the complete
object is known, the completion is compared with it. Finished objects are not run again.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from PIL import Image
from rich.console import Console
from rich.progress import track

from gscomplete.completion.pipeline import Request
from gscomplete.completion.presets import PresetName, preset
from gscomplete.completion.run_folder import (
    RUN_FILE,
    RunRequest,
    execute,
    prepare,
)
from gscomplete.completion.settings import CompletionSettings
from gscomplete.errors import UserError
from gscomplete.evaluate.metrics import against_truth
from gscomplete.evaluate.pictures import contact_sheet, render_images, save_image
from gscomplete.framing.decide import FramingRequest
from gscomplete.priors import Prior, load_prior
from gscomplete.priors.base import prior_identity
from gscomplete.splats import Splats, concatenate, read_splats, write_splats
from gscomplete.splats.transform import transform_splats
from gscomplete.util import jsonio
from gscomplete.util.atomic import atomic_path
from gscomplete.views import ObjectFrame, ViewDistribution
from recipes.entry_point import start
from recipes.real_objects.load import RealObject, load_real_object, names

DATA = Path(__file__).resolve().parents[2].parent / "shared/data"


@dataclass(frozen=True)
class Options:
    """Complete real partial objects and measure the results."""

    out: Path
    """Folder: one run folder per object, ``results.json`` and ``contact_sheet.png``."""
    names: tuple[str, ...] = ()
    """Objects by name; none = all of the table."""
    data: Path = DATA
    """Folder of the real data."""
    preset: PresetName = "default"
    """Settings of the completion."""
    text_only: bool = False
    """Withhold P's renders from the prior."""
    steps: int | None = None
    """Optimiser steps; None = the preset's."""
    seed: int = 0


def settings_of(options: Options, prior: Prior) -> CompletionSettings:
    """Return the settings that the options ask for."""
    settings = preset(options.preset, prior, text_only=options.text_only)
    settings = dataclasses.replace(settings, seed=options.seed, checkpoint_every=0)
    if options.steps is not None:
        settings = dataclasses.replace(settings, steps=options.steps)
    return settings


def complete_object(
    item: RealObject, folder: Path, prior: Prior, settings: CompletionSettings
) -> None:
    """Run one completion from a splat file, as a user would."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = folder.parent / f"{item.name}.partial.ply"
    write_splats(partial, item.partial)
    resume = (folder / RUN_FILE).exists()  # of a run that was interrupted
    completion = Request(item.prompt, settings, FramingRequest(item.up))
    request = RunRequest(partial, folder, completion, resume)
    execute(prepare(request, prior), lambda report: None)


def is_finished(folder: Path, prior: Prior, settings: CompletionSettings) -> bool:
    """Tell whether a run folder holds a finished run.

    Raises:
        UserError: it does, with another prior or other settings.
    """
    path = folder / RUN_FILE
    if not path.exists():
        return False
    content = json.loads(path.read_text(encoding="utf-8"))
    if content["status"] != "finished":
        return False
    settings_wanted = jsonio.to_json(settings)
    del settings_wanted["checkpoint_every"]  # not recorded: it decides nothing about the result
    for name, wanted in (("prior", prior_identity(prior)), ("settings", settings_wanted)):
        if content["identity"][name] != wanted:
            raise UserError(f"{path}: finished with another {name}; choose another --out")
    return True


def measure(item: RealObject, folder: Path) -> dict[str, Any]:
    """Return the numbers of a finished run, with the comparison to the truth where it is known."""
    content = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))
    metrics = content["result"]["metrics"]
    row: dict[str, Any] = {
        "name": item.name,
        "prompt": item.prompt,
        "seconds": content["result"]["seconds"],
        "new_splats": content["result"]["new_splats"],
        "e_color_c": metrics["input_view"]["color"],
        "e_color_v": metrics["all_views"]["color"],
        "e_depth_c": metrics["input_view"]["depth"],
        "e_depth_v": metrics["all_views"]["depth"],
    }
    if item.complete is not None:
        partial, together, truth, views = _in_object_frame(item, folder, content)
        row["truth"] = jsonio.to_json(against_truth(together, partial, truth, views.ring(8, 256)))
    return row


def _in_object_frame(
    item: RealObject, folder: Path, content: dict[str, Any]
) -> tuple[Splats, Splats, Splats, ViewDistribution]:
    """Return P, O, the truth (P again where it is unknown) and V in the run's object frame."""
    source = str(folder / RUN_FILE)
    frame = ObjectFrame.from_json(content["identity"]["frame"], source)
    views = ViewDistribution.from_json(content["identity"]["views"], source)
    new = read_splats(folder / "completed.ply").splats.select(
        torch.arange(len(item.partial), len(item.partial) + content["result"]["new_splats"])
    )
    similarity = frame.object_from_file
    partial = transform_splats(item.partial, similarity)
    truth = partial if item.complete is None else transform_splats(item.complete, similarity)
    return partial, concatenate([partial, transform_splats(new, similarity)]), truth, views


def sheet_rows(item: RealObject, folder: Path) -> list[list[Image.Image]]:
    """Draw input, completion and truth from the same four views."""
    content = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))
    partial, together, truth, views = _in_object_frame(item, folder, content)
    cameras = views.preview_cameras(144)[[0, 1, 3, 5]]
    return [
        [
            *render_images(partial, cameras),
            *render_images(together, cameras),
            *render_images(truth, cameras),
        ]
    ]


def main(options: Options) -> None:
    """Complete, measure, draw."""
    prior = load_prior("embedded", torch.device("cpu"))
    chosen = options.names or tuple(names())
    rows, pictures, labels = [], [], []
    for name in track(chosen, "objects", console=Console(file=sys.stderr)):
        item = load_real_object(name, options.data)
        folder = options.out / name
        settings = settings_of(options, prior)
        if not is_finished(folder, prior, settings):
            complete_object(item, folder, prior, settings)
        rows.append(measure(item, folder))
        pictures += sheet_rows(item, folder)
        labels.append(name)
        sys.stdout.write(_line(rows[-1]) + "\n")
    with atomic_path(options.out / "results.json") as temporary:
        temporary.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    save_image(
        contact_sheet(pictures, row_labels=labels, title="input | completion | truth"),
        options.out / "contact_sheet.png",
    )
    sys.stdout.write(_mean_line(rows) + "\n")


def _line(row: dict[str, Any]) -> str:
    """Show one object's numbers."""
    text = (
        f"{row['name']:24} {row['seconds']:6.1f} s  E_color c {row['e_color_c']:.6f} "
        f"V {row['e_color_v']:.6f}  E_depth c {row['e_depth_c']:.6f} V {row['e_depth_v']:.6f}"
    )
    if "truth" in row:
        text += f"  hidden IoU {row['truth']['hidden_iou']:.3f}"
        text += f" PSNR {row['truth']['hidden_color_psnr_db'] or float('nan'):.1f}"
    return text


def _mean_line(rows: list[dict[str, Any]]) -> str:
    """Show the means over all objects."""
    known = [row["truth"] for row in rows if "truth" in row]
    parts = [
        f"{key} {sum(row[key] for row in rows) / len(rows):.6f}"
        for key in ("e_color_c", "e_color_v", "e_depth_c", "e_depth_v", "seconds")
    ]
    if known:
        iou = sum(truth["hidden_iou"] for truth in known) / len(known)
        decibels = [truth["hidden_color_psnr_db"] for truth in known]
        told = [value for value in decibels if value is not None]
        psnr = sum(told) / len(told) if told else float("nan")
        parts.append(
            f"hidden IoU {iou:.3f}, PSNR {psnr:.1f} dB over {len(known)} known complete objects"
        )
    return f"mean of {len(rows)}: " + ", ".join(parts)


if __name__ == "__main__":
    start(main, Options, __doc__)
