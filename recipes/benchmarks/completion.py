"""Run time against error of ways to complete an object.

``python -m recipes.benchmarks.completion --out DIR`` completes real objects with known truth in
every way below. Preservation errors are measured over views of V that no way was fitted to, errors
of the hidden region against the truth from eight views. Writes ``completion.json``, a plot, and a
table with each way's share of the paper preset's time; an interrupted benchmark goes on where it
stopped.

* ``fast``, ``default``, ``reconstruct``, ``distill``, ``paper``: the presets, ``paper`` with all of
  its 6,000 steps.
* ``soft``, ``strict``: the default without its hard preservation, and with stricter one.
* ``random views``: ``reconstruct`` with a new view of V at every step, as the paper draws them.
* ``every 4th``: ``reconstruct`` with the preservation loss at every fourth step, four times as
  heavy.
* ``coarse first``: ``reconstruct`` with half the steps at half the resolution.
* ``from sphere``: score distillation that starts in a sphere.
* ``fewer steps``: the same with a quarter of its steps, four times as large.
"""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.progress import track

from gscomplete.completion.presets import (
    DISTILL,
    GUESS,
    PAPER,
    RECONSTRUCT,
    REFINE,
    UNBOUNDED_GUESS,
)
from gscomplete.completion.settings import CompletionSettings, HardPreservationSettings
from gscomplete.evaluate.pictures import save_image
from gscomplete.fitting.settings import LearningRates
from gscomplete.priors import load_prior
from gscomplete.priors.base import prior_identity
from recipes.benchmarks.curves.charts import Chart, draw_charts
from recipes.entry_point import start
from recipes.real_objects.compare import completed_as_run, frame_object, measure
from recipes.real_objects.complete import DATA
from recipes.real_objects.load import load_real_object
from recipes.results import Results

_ERRORS = ("e_color_v", "e_depth_v")


@dataclass(frozen=True)
class Options:
    """Run time against error of ways to complete."""

    out: Path
    """Folder for results."""
    names: tuple[str, ...] = ("apple", "cow", "bottle", "bowl", "statue", "lantern")
    """Real objects with known truth."""
    ways: tuple[str, ...] = ()
    """Ways by name; none = all."""
    data: Path = DATA
    """Folder of the real data."""
    seed: int = 0


def ways() -> dict[str, CompletionSettings]:
    """Return the settings compared, by name."""
    change = dataclasses.replace
    rates = DISTILL.learning_rates
    faster = LearningRates(**{name: 4 * value for name, value in dataclasses.asdict(rates).items()})
    return {
        "fast": UNBOUNDED_GUESS,
        "soft": change(GUESS, hard_preservation=None),
        "default": GUESS,
        "strict": change(GUESS, hard_preservation=HardPreservationSettings()),
        "reconstruct": RECONSTRUCT,
        "random views": change(RECONSTRUCT, preservation_views=None),
        "every 4th": change(RECONSTRUCT, preservation_every=4, preservation_weight=8.0),
        "coarse first": change(RECONSTRUCT, coarse_until=0.5),
        "distill": REFINE,
        "from sphere": DISTILL,
        "fewer steps": change(DISTILL, steps=DISTILL.steps // 4, learning_rates=faster),
        "paper": PAPER,
    }


def means(results: dict[str, dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Return every way's means over the objects that have it."""
    keys = ("seconds", *_ERRORS, "silhouette_iou", "hidden_iou", "hidden_color_psnr_db")
    table: dict[str, dict[str, float]] = {}
    for name in ways():
        rows = [row[name] for row in results.values() if name in row]
        if rows:
            table[name] = {key: float(np.mean([row[key] for row in rows])) for key in keys}
            table[name]["objects"] = len(rows)
    return table


def report(table: dict[str, dict[str, float]]) -> str:
    """Show the means, and each way's time as a share of the paper preset's."""
    lines = [
        f"{'way':14}{'seconds':>9}{'E_color V':>11}{'E_depth V':>11}{'silhouette':>11}"
        f"{'hidden':>8}{'PSNR dB':>9}{'of paper':>10}"
    ]
    paper = table.get("paper")
    for name, row in table.items():
        share = ""
        if paper is not None:
            no_worse = all(row[key] <= paper[key] for key in _ERRORS)
            no_worse = no_worse and row["silhouette_iou"] >= paper["silhouette_iou"]
            share = f"{row['seconds'] / paper['seconds']:.3f}" + ("" if no_worse else " (worse)")
        lines.append(
            f"{name:14}{row['seconds']:9.1f}{row['e_color_v']:11.6f}{row['e_depth_v']:11.6f}"
            f"{row['silhouette_iou']:11.3f}{row['hidden_iou']:8.3f}"
            f"{row['hidden_color_psnr_db']:9.2f}{share:>10}"
        )
    return "\n".join(lines) + "\n"


def main(options: Options) -> None:
    """Complete, measure, report."""
    prior = load_prior("embedded", "cpu")
    made_with = {"seed": options.seed, "prior": prior_identity(prior), "ways": ways()}
    results = Results(options.out / "completion.json", made_with)
    chosen = {name: way for name, way in ways().items() if name in (options.ways or ways())}
    for object_name in track(options.names, "objects", console=Console(file=sys.stderr)):
        framed = frame_object(load_real_object(object_name, options.data), prior)
        rows = results.rows.setdefault(object_name, {})
        for name, settings in chosen.items():
            if name in rows:
                continue
            seeded = dataclasses.replace(settings, seed=options.seed)
            rows[name] = measure(framed, completed_as_run(framed, prior, seeded))
            results.save()
    table = means(results.rows)
    sys.stdout.write(report(table))
    panels = [
        Chart(
            f"{label} against time, mean of objects",
            "seconds",
            label,
            {name: [(row["seconds"], row[key])] for name, row in table.items()},
            note_points={name: [name] for name in table},
            log_y=key in _ERRORS,
        )
        for key, label in (("e_color_v", "E_color over V"), ("silhouette_iou", "silhouette IoU"))
    ]
    save_image(draw_charts(panels, 2), options.out / "completion.png")


if __name__ == "__main__":
    torch.set_num_threads(2)
    start(main, Options, __doc__)
