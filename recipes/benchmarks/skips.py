"""What a completion step gains by leaving out what the result does not need.

``python -m recipes.benchmarks.skips [--json OUT]`` takes the same steps of iterative reconstruction
(fitting to rings of targets with the preservation loss) on real partial objects, from the same
state, with all skips, with all but one, and with none; ways take turns within one process. The
time is the median over steps, the difference the largest change of any new splat's position after
the first step.

Conventions
-----------
* Rings of targets are made beforehand (``reconstruct`` denoises them once a round): a step here is
  a step of the fit, of which a run takes hundreds.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from gscomplete.atomic import atomic_path
from gscomplete.completion.optimise import Completion
from gscomplete.completion.settings import RECONSTRUCT, CompletionSettings, SkipSettings
from gscomplete.priors import Prior, load_prior
from recipes.real_objects.compare import Posed, pose
from recipes.real_objects.complete import DATA
from recipes.real_objects.load import load_real_object

NO_SKIPS = SkipSettings(
    prepared_partial=False, idle_tiles=False, exact_tile_lists=False, early_stop=False
)


@dataclass(frozen=True)
class Options:
    """Time completion steps with skips on and off."""

    names: tuple[str, ...] = ("apple", "cow", "bottle", "statue", "lantern", "biker")
    """Real objects."""
    resolutions_px: tuple[int, ...] = (64, 256)
    """Sides of the renders: the embedded prior's and MVDream's."""
    steps: int = 30
    """Timed steps of each way."""
    data: Path = DATA
    """Folder of the real data."""
    json: Path | None = None
    """Write the numbers to this file."""


def ways() -> dict[str, SkipSettings]:
    """Return the ways compared by name: every skip off alone, and all of them."""
    names = [field.name for field in dataclasses.fields(SkipSettings)]
    alone = {f"without {name}": SkipSettings(**{name: False}) for name in names}
    return {"all skips": SkipSettings(), **alone, "no skips": NO_SKIPS}


def settings_for(skip: SkipSettings, resolution_px: int) -> CompletionSettings:
    """Return iterative reconstruction whose rings are all made in the first steps."""
    return dataclasses.replace(
        RECONSTRUCT,
        steps=4000,
        rounds=4000,
        guess_frames=1,
        resolution_px=resolution_px,
        skip=skip,
        # One round a step until the memory of rings is full; then rounds stop (see ``warmed``).
        ring_memory=3,
    )


def warmed(posed: Posed, prior: Prior, settings: CompletionSettings) -> Completion:
    """Return a completion with its rings made, about to take fitting steps only."""
    job = Completion(
        posed.partial, prior, prior.condition(posed.item.prompt), posed.views, settings
    )
    for _ in range(settings.ring_memory):
        job.step()
    job.settings = dataclasses.replace(settings, rounds=1)
    return job


def measure(posed: Posed, prior: Prior, resolution_px: int, steps: int) -> dict[str, Any]:
    """Time all ways on one object, taking turns step by step."""
    jobs = {}
    first = warmed(posed, prior, settings_for(SkipSettings(), resolution_px))
    state = {name: value.clone() for name, value in first.state().items()}
    for name, skip in ways().items():
        jobs[name] = Completion(
            posed.partial,
            prior,
            prior.condition(posed.item.prompt),
            posed.views,
            settings_for(skip, resolution_px),
        )
        jobs[name].settings = dataclasses.replace(jobs[name].settings, rounds=1)
        jobs[name].restore({key: value.clone() for key, value in state.items()})
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    moved: dict[str, float] = {}
    for step in range(steps):
        for name, job in jobs.items():
            started = time.perf_counter()
            job.step()
            seconds[name].append(time.perf_counter() - started)
        if step == 0:
            usual = jobs["all skips"].new_splats().means
            moved = {
                name: float((job.new_splats().means - usual).abs().max())
                for name, job in jobs.items()
            }
    return {
        name: {"ms": 1e3 * float(np.median(values)), "moved": moved[name]}
        for name, values in seconds.items()
    }


def main(options: Options) -> None:
    """Measure and report."""
    prior = load_prior("embedded", "cpu")
    results: dict[str, Any] = {}
    out = sys.stdout
    for resolution_px in options.resolutions_px:
        for object_name in options.names:
            posed = pose(load_real_object(object_name, options.data))
            found = measure(posed, prior, resolution_px, options.steps)
            results[f"{object_name} {resolution_px} px"] = found
            usual = found["all skips"]["ms"]
            out.write(f"{object_name}, {resolution_px} px, P {len(posed.partial):,} splats\n")
            for name, row in found.items():
                out.write(
                    f"  {name:26} {row['ms']:8.1f} ms  {row['ms'] / usual:5.2f} x  moved "
                    f"{row['moved']:.1e}\n"
                )
    for resolution_px in options.resolutions_px:
        rows = [row for key, row in results.items() if key.endswith(f" {resolution_px} px")]
        gains = [row["no skips"]["ms"] / row["all skips"]["ms"] for row in rows]
        out.write(
            f"{resolution_px} px: no skips / all skips: median {np.median(gains):.2f}, "
            f"{min(gains):.2f} to {max(gains):.2f}\n"
        )
    if options.json:
        with atomic_path(options.json) as temporary:
            temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    torch.set_num_threads(2)
    main(tyro.cli(Options))
