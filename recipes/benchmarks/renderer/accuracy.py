"""Error of the CPU renderer against time: ``python -m recipes.benchmarks.renderer.accuracy``.

For every cut-off (``alpha_min``, which also sets how far a splat reaches; ``transmittance_min``;
tile lists by pixel boxes instead of ellipses), errors of the picture and of the gradients of every
parameter group against two float64 twins: the one *with the same image definition* (same
``alpha_min``; the twin never stops early), which gives the error of float32, polynomials and early
stop, and the one *without cut-offs*, which adds the error of the definition itself. Times are
measured on a larger scene, where they matter. ``--out DIR`` leaves ``renderer_accuracy.json`` and
``renderer_accuracy.png`` there.

Conventions
-----------
* Gradients are those of the picture dotted with fixed random numbers; the error of a group is the
  norm of the difference over the norm of the twin's gradient; "worst" is the worst group's.
* Without cut-offs means alphas down to 1e-12; the clamp of alphas at ``alpha_max`` stays, as it is
  part of the picture's definition in every renderer of this family.
* A setting is on the Pareto front when no other is both faster and nearer to the twin without
  cut-offs in every measure. Settings take turns within every timed repeat.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numba
import numpy as np
import torch
from torch import Tensor

from gscomplete.evaluate.pictures import save_image
from gscomplete.render import Backend, RenderSettings, render
from gscomplete.splats import Splats
from gscomplete.util.atomic import atomic_path
from gscomplete.views import Cameras
from recipes.benchmarks.clocks import Clock, clock_reader
from recipes.benchmarks.curves.charts import Chart, draw_charts
from recipes.benchmarks.renderer.scenes import bench_camera, cloud, surface_discs, trainable_copy
from recipes.entry_point import start

COLOR_MAX, COLOR_MEAN, GRADIENT = 1 / 255, 1e-4, 1e-3
"""What the default settings must keep to, against the twin of the same image definition."""
_NO_CUT = 1e-12

Scene = Literal["surface", "cloud"]


@dataclass(frozen=True, slots=True)
class Options:
    """Error of the CPU renderer against time."""

    mesh: Path | None = None
    """Mesh of the surface scene; None = a torus knot."""
    scenes: tuple[Scene, ...] = ("surface", "cloud")
    """What is drawn: opaque discs on a surface, half-transparent ellipsoids in a ball."""
    splats: int = 3_000
    """Splats of the scenes that are compared with float64."""
    size_px: int = 128
    """Their image size."""
    sh_degree: int = 3
    """Their degree of the spherical harmonics."""
    time_splats: int = 160_000
    """Splats of the surface that is timed."""
    time_size_px: int = 256
    """Its image size."""
    alpha_min: tuple[float, ...] = (1 / 255, 1e-3, 1e-4, 1e-5)
    """Smallest alphas that are drawn."""
    transmittance_min: tuple[float, ...] = (0.0, 1e-5, 1e-4, 1e-3)
    """Transmittances at which a tile stops; 0 = never."""
    repeats: int = 9
    """Timed repeats after one untimed."""
    threads: int | None = None
    """Threads of Numba and PyTorch; None = all cores."""
    clock: Clock = "wall"
    """wall, or cpu: processor time, for one thread on a busy machine."""
    out: Path | None = None
    """Folder for the JSON file and the plot; None = write no files."""


@dataclass(frozen=True, slots=True)
class Picture:
    """Colours and gradients of one drawing, in float64."""

    color: Tensor  # [H, W, 3]
    gradients: dict[str, Tensor]


@dataclass(frozen=True, slots=True)
class Errors:
    """Distance from a twin."""

    color_mean: float
    color_max: float
    gradients: dict[str, float]

    @property
    def worst_gradient(self) -> float:
        """The largest relative error of a parameter group."""
        return max(self.gradients.values())


@dataclass(frozen=True, slots=True)
class Row:
    """One setting in one scene."""

    scene: str
    alpha_min: float
    transmittance_min: float
    exact_tile_lists: bool
    ms: float
    """Forward and backward of the timed surface, median."""
    fastest_ms: float
    same: Errors
    """Against the twin of the same image definition."""
    uncut: Errors
    """Against the twin without cut-offs."""


def draw(
    splats: Splats, cameras: Cameras, upstream: Tensor, settings: RenderSettings, backend: Backend
) -> Picture:
    """Draw and differentiate."""
    trainable = trainable_copy(splats)
    color = render(trainable, cameras, settings=settings, backend=backend).color
    color.backward(upstream.to(color)[None])
    gradients = {name: value.grad.double() for name, value in trainable.fields()}
    return Picture(color.detach().double()[0], gradients)


def difference(found: Picture, twin: Picture) -> Errors:
    """Compare two drawings."""
    error = (found.color - twin.color).abs()
    gradients = {
        name: float((found.gradients[name] - value).norm() / value.norm().clamp_min(1e-300))
        for name, value in twin.gradients.items()
    }
    return Errors(float(error.mean()), float(error.max()), gradients)


def without_cut_offs() -> RenderSettings:
    """Return settings that only the float64 twin can draw.

    ``RenderSettings`` refuses so small an alpha for the sake of tile lists, which the twin lacks.
    """
    settings = copy.copy(RenderSettings(transmittance_min=0.0))
    object.__setattr__(settings, "alpha_min", _NO_CUT)
    return settings


def measure_times(
    splats: Splats,
    cameras: Cameras,
    settings: Sequence[RenderSettings],
    repeats: int,
    read: Callable[[], float] = time.perf_counter,
) -> list[tuple[float, float]]:
    """Return (median, fastest) milliseconds of forward and backward for every setting."""
    trainable = trainable_copy(splats)
    upstream = torch.randn(1, cameras.height, cameras.width, 3)
    times = np.zeros((repeats + 1, len(settings)))
    for repeat in range(repeats + 1):
        for k, one in enumerate(settings):
            for _, value in trainable.fields():
                value.grad = None
            start = read()
            render(trainable, cameras, settings=one, backend="cpu").color.backward(upstream)
            times[repeat, k] = 1e3 * (read() - start)
    kept = times[1:]
    return list(zip(np.median(kept, axis=0).tolist(), kept.min(axis=0).tolist(), strict=True))


def measure_errors(
    splats: Splats, cameras: Cameras, settings: Sequence[RenderSettings]
) -> list[tuple[Errors, Errors]]:
    """Return, for every setting, errors against the same definition and against no cut-offs."""
    upstream = torch.randn(cameras.height, cameras.width, 3, dtype=torch.float64)
    uncut = draw(splats, cameras, upstream, without_cut_offs(), "reference")
    twins: dict[float, Picture] = {}
    errors = []
    for one in settings:
        if one.alpha_min not in twins:
            twins[one.alpha_min] = draw(splats, cameras, upstream, one, "reference")
        found = draw(splats, cameras, upstream, one, "cpu")
        errors.append((difference(found, twins[one.alpha_min]), difference(found, uncut)))
    return errors


def measure(options: Options, read: Callable[[], float] = time.perf_counter) -> list[Row]:
    """Measure every setting in every scene."""
    settings = [
        RenderSettings(alpha_min=alpha, transmittance_min=through)
        for alpha in options.alpha_min
        for through in options.transmittance_min
    ]
    settings.append(RenderSettings(exact_tile_lists=False))
    surface = surface_discs(options.mesh, options.time_splats)
    camera = bench_camera(options.time_size_px)
    times = measure_times(surface, camera, settings, options.repeats, read)
    rows = []
    for scene in options.scenes:
        if scene == "surface":
            splats = surface_discs(options.mesh, options.splats, options.sh_degree)
        else:
            splats = cloud(options.splats, options.sh_degree)
        errors = measure_errors(splats, bench_camera(options.size_px), settings)
        for one, (median, fastest), (same, uncut) in zip(settings, times, errors, strict=True):
            cut = one.alpha_min, one.transmittance_min, one.exact_tile_lists
            rows.append(Row(scene, *cut, median, fastest, same, uncut))
    return rows


def on_front(row: Row, rows: Sequence[Row]) -> bool:
    """Say whether no other setting of the scene is faster and nearer in every measure."""

    def measures(one: Row) -> tuple[float, ...]:
        return one.ms, one.uncut.color_mean, one.uncut.color_max, one.uncut.worst_gradient

    mine = measures(row)
    return not any(
        all(a < b for a, b in zip(measures(other), mine, strict=True))
        for other in rows
        if other.scene == row.scene
    )


def failures(rows: Sequence[Row]) -> list[str]:
    """Return messages about the bounds that the default settings do not meet."""
    default = RenderSettings()
    missed = []
    for row in rows:
        cut = row.alpha_min, row.transmittance_min, row.exact_tile_lists
        if cut != (default.alpha_min, default.transmittance_min, default.exact_tile_lists):
            continue
        bounds = {
            "largest colour error": (row.same.color_max, COLOR_MAX),
            "mean colour error": (row.same.color_mean, COLOR_MEAN),
        }
        bounds |= {f"gradient of {n}": (v, GRADIENT) for n, v in row.same.gradients.items()}
        missed += [
            f"{row.scene}: {name} {value:.1e} > {bound:.1e}"
            for name, (value, bound) in bounds.items()
            if not value <= bound
        ]
    return missed


def _print(rows: Sequence[Row]) -> None:
    out = sys.stdout
    out.write(
        f"{'':40}{'against the same definition':^31}{'against no cut-offs':^31}\n"
        f"{'scene':8} {'alpha':>7} {'through':>7} {'lists':>7} {'ms':>7}"
        + f" {'col.mean':>10} {'col.max':>9} {'gradient':>9}" * 2
        + "\n"
    )
    for row in rows:
        cells = "".join(
            f" {e.color_mean:10.1e} {e.color_max:9.1e} {e.worst_gradient:9.1e}"
            for e in (row.same, row.uncut)
        )
        out.write(
            f"{row.scene:8} {row.alpha_min:7.1g} {row.transmittance_min:7.0e} "
            f"{'ellipse' if row.exact_tile_lists else 'box':>7} {row.ms:7.1f}"
            f"{cells}{'  Pareto' if on_front(row, rows) else ''}\n"
        )


def _charts(rows: Sequence[Row]) -> list[Chart]:
    """Draw error over time: a curve for every alpha_min, a point for every transmittance_min."""
    names = {
        "worst gradient error, no cut-offs": lambda row: row.uncut.worst_gradient,
        "mean colour error, no cut-offs": lambda row: row.uncut.color_mean,
        "worst gradient error, same definition": lambda row: row.same.worst_gradient,
    }
    charts = []
    for scene in dict.fromkeys(row.scene for row in rows):
        for name, read in names.items():
            curves: dict[str, list[tuple[float, float]]] = {}
            words: dict[str, list[str]] = {}
            for row in rows:
                if row.scene == scene:
                    lists = "" if row.exact_tile_lists else ", boxes"
                    curve = f"alpha_min {row.alpha_min:.1g}{lists}"
                    curves.setdefault(curve, []).append((row.ms, read(row)))
                    through = row.transmittance_min
                    words.setdefault(curve, []).append(f"{through:.0e}" if through else "0")
            limits = {"target": GRADIENT} if "same" in name else {}
            charts.append(
                Chart(
                    f"{scene}: {name}",
                    "ms; points: transmittance_min",
                    "",
                    curves,
                    log_x=False,
                    limits=limits,
                    note_points=words,
                )
            )
    return charts


def main(options: Options) -> None:
    """Measure, print, draw."""
    threads = options.threads or numba.config.NUMBA_NUM_THREADS
    numba.set_num_threads(threads)
    torch.set_num_threads(threads)
    torch.manual_seed(0)
    rows = measure(options, clock_reader(options.clock, threads))
    _print(rows)
    missed = failures(rows)
    sys.stdout.write("default settings: " + ("; ".join(missed) or "all bounds kept") + "\n")
    if options.out is None:
        return
    content: dict[str, Any] = {
        "options": dataclasses.asdict(options) | {"mesh": str(options.mesh), "out": None},
        "threads": threads,
        "rows": [dataclasses.asdict(row) | {"pareto": on_front(row, rows)} for row in rows],
        "default_misses": missed,
    }
    options.out.mkdir(parents=True, exist_ok=True)
    with atomic_path(options.out / "renderer_accuracy.json") as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    save_image(draw_charts(_charts(rows), columns=3), options.out / "renderer_accuracy.png")


if __name__ == "__main__":
    start(main, Options, __doc__)
