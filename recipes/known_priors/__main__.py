"""Score distillation against priors that know the answer: ``--meshes PACK --out DIR``.

``python -m recipes.known_priors --meshes PACK --out runs/known`` completes parts of real meshes in
every named way and with every named prior, and so measures the method independently of any trained
weights. Settings for priors whose weights are not available (MVDream) are chosen here. An
interrupted study resumes where it stopped.

Conventions
-----------
* Priors: ``exact``, renders of the truth; ``blurred``, blurred and noisier as t grows;
  ``plausible``, several complete objects of the same P, weighted by how near the render is;
  ``biased``, an object that is larger and of another colour than P where V sees it;
  ``mvdream-like``, colours without alpha over black or white, 32 x 32 latents, too strong guidance;
  ``embedded``, the package's own, from words alone as MVDream is; ``embedded-shape``, from words
  and the known shape of the noun that suits P best, where there is one.
* Ways are settings by name (``known_priors.ways``); a call is one denoising of a ring of four.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from rich.console import Console
from rich.progress import track

from gscomplete.completion.pipeline import Request, finish, prepare
from gscomplete.completion.settings import CompletionSettings
from gscomplete.errors import UserError
from gscomplete.evaluate.bootstrap import bootstrap_interval
from gscomplete.framing.decide import FramingRequest
from gscomplete.priors import Prior, load_prior
from gscomplete.priors.base import prior_identity
from gscomplete.priors.mvdream.prior import MVDREAM_VIEWS
from gscomplete.splats import Splats, concatenate, write_splats
from recipes.entry_point import start
from recipes.known_priors.measure import errors_of
from recipes.known_priors.objects import KnownObject, believed, known_objects
from recipes.known_priors.priors import STRENGTHS, Kind, KnownPrior
from recipes.known_priors.ways import TABLE_2, WAYS
from recipes.results import Results

PriorName = Literal[Kind, "embedded", "embedded-shape"]


@dataclass(frozen=True)
class Options:
    """Judge score distillation apart from its prior."""

    meshes: Path
    """Folder of the pack of meshes."""
    out: Path
    """Folder for ``results.json``; an interrupted study goes on from it."""
    priors: tuple[PriorName, ...] = get_args(Kind)
    """Priors to use."""
    ways: tuple[str, ...] = ("paper", "distill")
    """Settings to use, by name."""
    steps: tuple[int, ...] = (600,)
    """Numbers of optimiser steps; each is run with all ways."""
    objects: int = 12
    """Number of parts, half of them scans, half of them halves."""
    seeds: tuple[int, ...] = (0,)
    resolution_px: int = 256
    """Side of the known priors' images."""
    keep: bool = False
    """Keep completions as splat files."""


def completed(
    item: KnownObject, prior: Prior, settings: CompletionSettings
) -> tuple[Splats, float]:
    """Complete a part in its true frame; return the new splats and the seconds of the steps."""
    angles = (item.views.azimuth_deg, item.views.elevation_deg)
    framing = FramingRequest("Z", angles, center_file=(0.0, 0.0, 0.0), size_file=1.0)
    prepared = prepare(item.partial, Request(item.prompt, settings, framing), prior)
    started = time.perf_counter()
    while not prepared.steps.finished:
        prepared.steps.step()
    return finish(prepared, item.partial).new, time.perf_counter() - started


def main(options: Options) -> None:
    """Complete, measure, print.

    Raises:
        UserError: a way is not known, or the rows that are there were made otherwise.
    """
    for way in options.ways:
        if way not in WAYS:
            raise UserError(f"--ways: expected some of {', '.join(WAYS)}; found {way!r}")
    made_with: dict[str, Any] = {
        "resolution_px": options.resolution_px,
        "objects": options.objects,  # how a part is cut depends on its place in the list
        "strengths": STRENGTHS,
        "ways": WAYS,
    }
    own = {"embedded", "embedded-shape"}
    embedded = load_prior("embedded") if own.intersection(options.priors) else None
    if embedded is not None:
        made_with["embedded"] = prior_identity(embedded)
    results = Results(options.out / "results.json", made_with)
    items = known_objects(options.meshes, options.objects, MVDREAM_VIEWS)
    tasks = [
        (seed, steps, kind, way, item)
        for seed in options.seeds
        for steps in options.steps
        for kind in options.priors
        for way in options.ways
        for item in items
    ]
    for seed, steps, kind, way, item in track(tasks, "runs", console=Console(file=sys.stderr)):
        key = f"{kind}/{way}/{steps}/{seed}/{item.name}"
        if key in results.rows:
            continue
        settings = dataclasses.replace(WAYS[way], steps=steps, seed=seed, see_input=False)
        if kind in own:
            assert embedded is not None
            settings = dataclasses.replace(settings, known_shapes=kind == "embedded-shape")
            objects: tuple[Splats, ...] = (item.truth,)
            new, seconds = completed(item, embedded, settings)
            calls = None
        else:
            objects = believed(item, kind)
            known = KnownPrior(kind, objects, options.resolution_px)
            new, seconds = completed(item, known, settings)
            calls = known.calls
        row = errors_of(item, new, objects)
        results.rows[key] = row | {
            "part": item.kind,
            "calls": calls,
            "new_splats": len(new),
            "seconds": seconds,
        }
        results.save()
        if options.keep:
            name = f"{kind}.{way}.{steps}.{item.name.replace('/', '_')}.ply"
            write_splats(options.out / name, concatenate([item.partial, new.with_sh_degree(0)]))
    sys.stdout.write(table(results.rows) + table_2(results.rows))


_COLUMNS = (
    ("silhouette_iou", "IoU", ".3f"),
    ("hidden_iou", "hidden", ".3f"),
    ("hidden_color_psnr_db", "PSNR", ".1f"),
    ("fog", "fog", ".4f"),
    ("e_color_v", "E_color", ".5f"),
    ("e_depth_v", "E_depth", ".5f"),
    ("calls", "calls", ".0f"),
    ("new_splats", "splats", ".0f"),
    ("seconds", "s", ".0f"),
)


def table(rows: dict[str, dict[str, Any]]) -> str:
    """Show means over objects and seeds by prior, way and steps."""
    groups: dict[tuple[str, str, int], list[dict[str, Any]]] = {}
    for key, row in rows.items():
        kind, way, steps = key.split("/")[:3]
        groups.setdefault((kind, way, int(steps)), []).append(row)
    heads = "".join(f"{label:>9}" for _, label, _ in _COLUMNS)
    lines = [f"{'prior':14}{'way':16}{'steps':>6}{'n':>4}{heads}   IoU 95 %"]
    for (kind, way, steps), found in sorted(groups.items()):
        cells = ""
        for name, _, form in _COLUMNS:
            known = [row[name] for row in found if row[name] is not None]
            cells += f"{np.mean(known):9{form}}" if known else f"{'-':>9}"
        low, high = bootstrap_interval([row["silhouette_iou"] for row in found])
        lines.append(f"{kind:14}{way:16}{steps:6}{len(found):4}{cells}   {low:.3f}-{high:.3f}")
    return "\n".join(lines) + "\n"


def table_2(rows: dict[str, dict[str, Any]]) -> str:
    """Show E_color by row of the paper's Table 2: mean and spread over seeds, and as a ratio.

    Empty where no prior has more than one of the rows.
    """
    lines = []
    priors = sorted({(key.split("/")[0], key.split("/")[2]) for key in rows})
    for kind, steps in priors:
        means = {way: _seed_means(rows, kind, way, steps) for way in TABLE_2}
        if not means["paper"] or not any(means[way] for way in TABLE_2[:-1]):
            continue
        full = float(np.mean(means["paper"]))
        for way in TABLE_2:
            if means[way]:
                mean, spread = float(np.mean(means[way])), float(np.std(means[way]))
                lines.append(
                    f"{kind}, {steps} steps, {way}: E_color {mean:.5f} +- {spread:.5f} over "
                    f"{len(means[way])} seeds, {mean / full:.1f} times paper's"
                )
    return "\n".join(lines) + "\n" if lines else ""


def _seed_means(rows: dict[str, dict[str, Any]], kind: str, way: str, steps: str) -> list[float]:
    """Return E_color averaged over objects, one number per seed."""
    by_seed: dict[str, list[float]] = {}
    for key, row in rows.items():
        found = key.split("/")
        if found[:3] == [kind, way, steps]:
            by_seed.setdefault(found[3], []).append(row["e_color_v"])
    return [float(np.mean(values)) for values in by_seed.values()]


if __name__ == "__main__":
    start(main, Options, __doc__)
