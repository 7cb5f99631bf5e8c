"""What a completion step gains by leaving out what the result does not need.

``python -m recipes.benchmarks.skips [--json OUT]`` takes the same steps on real partial objects,
from the same state, with all skips, with all but one, and with none; ways take turns within one
process, times are medians over steps. Two kinds of steps:

* ``fit``: splats are fitted to rings of targets with the preservation loss (the hundreds of steps
  of iterative reconstruction between its rounds of denoising).
* ``distill``: score distillation. Guidance scales of 1 leave one pass of the network; with
  ``network passes`` not skipped, scales of 1.000001 make it run all three, to the same result.

Differences are those of one render from five views and of its gradients, against all skips off:
largest difference of a pixel, and of gradients the relative norm.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from gscomplete.completion.optimise import Completion
from gscomplete.completion.presets import RECONSTRUCT, SMALL_PRIOR
from gscomplete.completion.settings import CompletionSettings, SkipSettings
from gscomplete.priors import Prior, load_prior
from gscomplete.render.partial_views import PartialViews
from gscomplete.splats import Splats
from gscomplete.util.atomic import atomic_path
from recipes.entry_point import start
from recipes.real_objects.compare import Posed, pose
from recipes.real_objects.complete import DATA
from recipes.real_objects.load import load_real_object

Kind = Literal["fit", "distill"]
Case = Literal["fit 64 px", "fit 256 px", "distill 64 px"]
KINDS: dict[Case, tuple[Kind, int]] = {
    "fit 64 px": ("fit", 64),
    "fit 256 px": ("fit", 256),
    "distill 64 px": ("distill", 64),
}
NO_SKIPS = SkipSettings(**{field.name: False for field in dataclasses.fields(SkipSettings)})
FIT = dataclasses.replace(RECONSTRUCT, steps=4000, rounds=1, ring_memory=3)
DISTILL = dataclasses.replace(SMALL_PRIOR, steps=4000, preservation_every=1)


@dataclass(frozen=True)
class Options:
    """Time completion steps with skips on and off."""

    names: tuple[str, ...] = ("cow", "statue", "scan_cake_tin", "armadillo", "biker")
    """Real objects."""
    cases: tuple[Case, ...] = tuple(KINDS)
    """Kinds of steps and sides of the renders: the embedded prior's and MVDream's."""
    steps: int = 30
    """Timed steps of each way."""
    data: Path = DATA
    """Folder of the real data."""
    json: Path | None = None
    """Write the numbers to this file."""


def ways(kind: Kind) -> dict[str, CompletionSettings]:
    """Return the ways compared, by name: all skips, each one off alone, and all off."""
    base = FIT if kind == "fit" else DISTILL
    scales = {"text_scale": 1.000001, "input_scale": 1.000001} if kind == "distill" else {}
    found = {"all skips": base}
    for field in dataclasses.fields(SkipSettings):
        skip = SkipSettings(**{field.name: False})
        found[f"without {field.name}"] = dataclasses.replace(base, skip=skip)
    if kind == "distill":
        found["all network passes"] = dataclasses.replace(base, **scales)
    return found | {"no skips": dataclasses.replace(base, skip=NO_SKIPS, **scales)}


def warmed(posed: Posed, prior: Prior, settings: CompletionSettings) -> Completion:
    """Return a completion whose memory of rings is full, about to take more steps."""
    job = new_job(posed, prior, dataclasses.replace(settings, rounds=settings.steps))
    for _ in range(settings.ring_memory):
        job.step()
    return job


def new_job(posed: Posed, prior: Prior, settings: CompletionSettings) -> Completion:
    """Return a completion at its start."""
    conditioning = prior.condition(posed.item.prompt)
    return Completion(posed.partial, prior, conditioning, posed.views, settings)


def measure(posed: Posed, prior: Prior, kind: Kind, size_px: int, steps: int) -> dict[str, Any]:
    """Time all ways on one object, taking turns step by step."""
    chosen = {
        name: dataclasses.replace(settings, resolution_px=size_px)
        for name, settings in ways(kind).items()
    }
    first = warmed(posed, prior, chosen["all skips"])
    state = {name: value.clone() for name, value in first.state().items()}
    jobs = {name: new_job(posed, prior, settings) for name, settings in chosen.items()}
    for job in jobs.values():
        job.restore({key: value.clone() for key, value in state.items()})
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(steps):
        for name, job in jobs.items():
            started = time.perf_counter()
            job.step()
            seconds[name].append(time.perf_counter() - started)
    splats = first.new_splats()
    truth = picture_and_gradients(posed, splats, NO_SKIPS, size_px)
    return {
        name: {
            "ms": 1e3 * float(np.median(seconds[name])),
            **differences(picture_and_gradients(posed, splats, settings.skip, size_px), truth),
        }
        for name, settings in chosen.items()
    }


def picture_and_gradients(
    posed: Posed, splats: Splats, skip: SkipSettings, resolution_px: int
) -> tuple[Tensor, dict[str, Tensor]]:
    """Render a ring and the input view, and pull a fixed random gradient back."""
    leaves = Splats(**{name: value.clone().requires_grad_() for name, value in splats.fields()})
    batches = [posed.views.ring(4, resolution_px), posed.views.input_camera(resolution_px)]
    drawn = PartialViews(posed.partial, skip).together(leaves, batches)
    weights = torch.rand(drawn.color.shape, generator=torch.Generator().manual_seed(0)) - 0.5
    (weights * drawn.color).sum().backward()
    return drawn.color.detach(), {name: value.grad for name, value in leaves.fields()}


def differences(
    found: tuple[Tensor, dict[str, Tensor]], truth: tuple[Tensor, dict[str, Tensor]]
) -> dict[str, float]:
    """Compare pictures and gradients."""
    gradients = [(found[1][name] - true).norm() / true.norm() for name, true in truth[1].items()]
    return {
        "picture": float((found[0] - truth[0]).abs().max()),
        "gradient": float(torch.stack(gradients).nan_to_num().max()),
    }


def main(options: Options) -> None:
    """Measure and report."""
    prior = load_prior("embedded", "cpu")
    results: dict[str, dict[str, Any]] = {}
    out = sys.stdout
    for case in options.cases:
        kind, size_px = KINDS[case]
        for object_name in options.names:
            posed = pose(load_real_object(object_name, options.data))
            found = measure(posed, prior, kind, size_px, options.steps)
            results.setdefault(case, {})[object_name] = found
            out.write(f"{case}: {object_name}, P {len(posed.partial):,} splats\n")
            for name, row in found.items():
                out.write(
                    f"  {name:26} {row['ms']:8.1f} ms "
                    f"{row['ms'] / found['all skips']['ms']:6.2f} x   picture "
                    f"{row['picture']:.1e}  gradient {row['gradient']:.1e}\n"
                )
    for case, rows in results.items():
        gains = [row["no skips"]["ms"] / row["all skips"]["ms"] for row in rows.values()]
        out.write(
            f"{case}: no skips / all skips: median {np.median(gains):.2f}, "
            f"{min(gains):.2f} to {max(gains):.2f}\n"
        )
    if options.json:
        with atomic_path(options.json) as temporary:
            temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    torch.set_num_threads(2)
    start(main, Options, __doc__)
