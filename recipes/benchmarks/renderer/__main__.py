"""How fast the CPU renderer is: ``python -m recipes.benchmarks.renderer [--mesh FILE]``.

Draws the surface of a mesh (a torus knot when none is given) as oriented discs, forward and
backward through the differentiable render, over the number of splats, image size, degree of
the spherical harmonics and threads; one is varied at a time, from a middle point. Prints medians,
fits how cost grows, and compares every kernel with what the machine can do (``work``).
``--out DIR`` leaves ``renderer.json`` and ``renderer.png`` there. Errors: ``accuracy``;
other renderers: ``peers``.

Conventions
-----------
* Within every repeat all thread counts are measured in turn, so that other load affects all alike.
* The backward pass starts from a given gradient of the picture; no loss is computed.
* An exponent b means that time grows as (number)^b. It is fitted over all points, where a fixed
  cost lowers it, and between the last two points, where the growing part dominates.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numba
import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.evaluate.pictures import save_image
from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.util.atomic import atomic_path
from gscomplete.views import Cameras
from recipes.benchmarks.clocks import Clock, clock_reader
from recipes.benchmarks.curves.charts import Chart, draw_charts
from recipes.benchmarks.renderer.machine_limits import MachineLimits, measure_limits
from recipes.benchmarks.renderer.scenes import bench_camera, surface_discs, trainable_copy
from recipes.benchmarks.renderer.work import Stage, measure_stages
from recipes.entry_point import start

Sweep = Literal["splats", "size_px", "sh_degree"]


@dataclass(frozen=True, slots=True)
class Options:
    """Time the CPU renderer."""

    mesh: Path | None = None
    """Mesh whose surface is drawn, in any format trimesh reads; None = a torus knot."""
    counts: tuple[int, ...] = (1_000, 10_000, 40_000, 160_000, 640_000, 2_000_000)
    """Numbers of splats."""
    sizes: tuple[int, ...] = (64, 128, 256, 512, 1024)
    """Widths and heights of the picture, pixels."""
    degrees: tuple[int, ...] = (0, 1, 2, 3)
    """Degrees of the spherical harmonics."""
    threads: tuple[int, ...] = ()
    """Numbers of threads; none = 1 and all cores."""
    sweeps: tuple[Sweep, ...] = ("splats", "size_px", "sh_degree")
    """What is varied."""
    splats: int = 160_000
    """Splats of the middle point."""
    size_px: int = 256
    """Image size of the middle point."""
    repeats: int = 15
    """Timed repeats at most, after two untimed ones."""
    seconds: float = 20.0
    """Time after which a point takes no more repeats (three are always taken)."""
    clock: Clock = "wall"
    """wall, or cpu: processor time, for one thread on a busy machine."""
    out: Path | None = None
    """Folder for ``renderer.json`` and ``renderer.png``; None = write no files."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Times of one point; milliseconds."""

    splats: int
    size_px: int
    sh_degree: int
    threads: int
    repeats: int
    forward_ms: float
    """Median, as the two below."""
    backward_ms: float
    total_ms: float
    fastest_ms: float
    """Smallest total."""


def time_render(
    splats: Splats,
    cameras: Cameras,
    threads: Sequence[int],
    repeats: int,
    seconds: float,
    read: Callable[[], float] = time.perf_counter,
) -> list[Timing]:
    """Time forward and backward of one view with every number of threads."""
    trainable = trainable_copy(splats)
    upstream = torch.randn(1, cameras.height, cameras.width, 3)
    times: dict[int, list[tuple[float, float]]] = {count: [] for count in threads}
    started = time.perf_counter()
    for repeat in range(repeats + 2):
        if repeat >= 5 and time.perf_counter() - started > seconds:
            break
        for count in threads:
            _use_threads(count)
            for _, value in trainable.fields():
                value.grad = None
            start = read()
            color = render(trainable, cameras, backend="cpu").color
            middle = read()
            color.backward(upstream)
            times[count].append((middle - start, read() - middle))
    rows = []
    for count, pairs in times.items():
        kept = 1e3 * np.array(pairs[2:])
        total = kept.sum(axis=1)
        rows.append(
            Timing(
                len(splats),
                cameras.width,
                splats.sh_degree,
                count,
                len(kept),
                *(float(v) for v in np.median(kept, axis=0)),
                float(np.median(total)),
                float(total.min()),
            )
        )
    return rows


def same_bits(splats: Splats, cameras: Cameras, threads: Sequence[int]) -> bool:
    """Say whether pictures and all gradients are bit-identical for all numbers of threads."""
    upstream = torch.randn(1, cameras.height, cameras.width, 3)
    answers = []
    for count in threads:
        _use_threads(count)
        trainable = trainable_copy(splats)
        color = render(trainable, cameras, backend="cpu").color
        color.backward(upstream)
        answers.append([color.detach()] + [value.grad for _, value in trainable.fields()])
    return all(
        torch.equal(one, other)
        for answer in answers[1:]
        for one, other in zip(answers[0], answer, strict=True)
    )


def _use_threads(count: int) -> None:
    numba.set_num_threads(count)
    torch.set_num_threads(count)


def exponents(points: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Fit b of time = a number^b: over all points, and between the last two."""
    x, y = np.log(np.array(points)).T
    return float(np.polyfit(x, y, 1)[0]), float((y[-1] - y[-2]) / (x[-1] - x[-2]))


def _points(timings: Iterable[Timing], sweep: Sweep, field: str) -> list[tuple[float, float]]:
    """Return (what was varied, milliseconds), image sizes as numbers of pixels."""
    power = 2 if sweep == "size_px" else 1
    return [(getattr(row, sweep) ** power, getattr(row, field)) for row in timings]


def _sweep(options: Options, sweep: Sweep, threads: Sequence[int]) -> dict[int, list[Timing]]:
    """Vary one number, print a line per point; return timings by number of threads."""
    values = {"splats": options.counts, "size_px": options.sizes, "sh_degree": options.degrees}
    found: dict[int, list[Timing]] = {count: [] for count in threads}
    for value in values[sweep]:
        point = {"splats": options.splats, "size_px": options.size_px, "sh_degree": 0}
        point[sweep] = value
        splats = surface_discs(options.mesh, point["splats"], point["sh_degree"])
        cameras = bench_camera(point["size_px"])
        read = clock_reader(options.clock, max(threads))
        lasting = options.repeats, options.seconds
        for row in time_render(splats, cameras, threads, *lasting, read):
            found[row.threads].append(row)
            sys.stdout.write(
                f"{row.splats:9,} {row.size_px:5} {row.sh_degree:3} {row.threads:8} "
                f"{row.forward_ms:9.2f} {row.backward_ms:9.2f} {row.total_ms:9.2f} "
                f"{row.fastest_ms:9.2f}\n"
            )
    return found


def _print_growth(sweep: Sweep, found: dict[int, list[Timing]]) -> list[dict[str, Any]]:
    """Fit and print how time grows with splats or pixels."""
    names = {"splats": "splats", "size_px": "pixels"}
    if sweep not in names or any(len(rows) < 2 for rows in found.values()):
        return []
    growth = []
    for count, rows in found.items():
        for field in ("forward_ms", "total_ms"):
            overall, last = exponents(_points(rows, sweep, field))
            line = {"over": names[sweep], "threads": count, "time": field}
            growth.append(line | {"exponent": overall, "last_exponent": last})
            sys.stdout.write(
                f"{field[:-3]} grows as {names[sweep]}^{overall:.2f} over all, "
                f"^{last:.2f} between the last two ({count} threads)\n"
            )
    return growth


def _print_stages(stages: Sequence[Stage], limits: MachineLimits) -> None:
    """Print kernels against limits."""
    out = sys.stdout
    out.write(
        f"limits with {limits.threads} threads: copy {limits.copy_gb_s:.1f} GB/s (read + written), "
        f"multiply-adds {limits.gflop_s:.0f} GFLOP/s\n"
        f"{'kernel':20} {'ms':>8} {'MB':>8} {'of copy':>8} {'GFLOP':>8} {'of peak':>8}\n"
    )
    for stage in stages:
        cells = [
            "" if value is None else style.format(value)
            for value, style in (
                (stage.megabytes, "{:.1f}"),
                (stage.memory_share, "{:.0%}"),
                (stage.gflop, "{:.2f}"),
                (stage.arithmetic_share, "{:.0%}"),
            )
        ]
        out.write(f"{stage.name:20} {stage.ms:8.2f}" + "".join(f" {c:>8}" for c in cells) + "\n")


def _charts(sweeps: dict[Sweep, dict[int, list[Timing]]]) -> list[Chart]:
    """Draw time over everything that was varied."""
    labels = {"splats": "splats", "size_px": "pixels", "sh_degree": "degree of the SH"}
    charts = []
    for sweep, found in sweeps.items():
        curves = {
            f"{word}, {count} threads": _points(rows, sweep, field)
            for count, rows in found.items()
            for word, field in (("forward", "forward_ms"), ("both ways", "total_ms"))
        }
        log = sweep != "sh_degree"
        title = f"CPU renderer over {labels[sweep]}"
        charts.append(Chart(title, labels[sweep], "ms", curves, log_x=log, log_y=log))
    return charts


def main(options: Options) -> None:
    """Run the benchmark and report."""
    cores = numba.config.NUMBA_NUM_THREADS
    threads = options.threads or tuple(sorted({1, cores}))
    if max(threads) > cores or min(threads) < 1:
        raise UserError(f"--threads: expected 1 to {cores} (NUMBA_NUM_THREADS), found {threads}")
    read = clock_reader(options.clock, max(threads))
    torch.manual_seed(0)
    sys.stdout.write(
        f"{'splats':>9} {'px':>5} {'SH':>3} {'threads':>8} {'forward':>9} {'backward':>9} "
        f"{'total':>9} {'fastest':>9}  (ms, medians)\n"
    )
    sweeps = {sweep: _sweep(options, sweep, threads) for sweep in options.sweeps}
    growth = [line for sweep, found in sweeps.items() for line in _print_growth(sweep, found)]
    splats, cameras = surface_discs(options.mesh, options.splats), bench_camera(options.size_px)
    identical = same_bits(splats, cameras, threads)
    sys.stdout.write(f"picture and gradients bit-identical for {threads} threads: {identical}\n")
    shares = []
    for count in threads:
        _use_threads(count)
        limits = measure_limits(count, read=read)
        stages = measure_stages(splats, cameras, limits, options.repeats, read)
        _print_stages(stages, limits)
        stage_rows = [dataclasses.asdict(stage) for stage in stages]
        shares.append({"limits": dataclasses.asdict(limits), "stages": stage_rows})
    if options.out is None:
        return
    content = {
        "scene": "torus knot" if options.mesh is None else options.mesh.stem,
        "sweeps": {
            sweep: [dataclasses.asdict(row) for rows in found.values() for row in rows]
            for sweep, found in sweeps.items()
        },
        "clock": options.clock,
        "growth": growth,
        "bit_identical_over_threads": identical,
        "machine": shares,
    }
    options.out.mkdir(parents=True, exist_ok=True)
    with atomic_path(options.out / "renderer.json") as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    save_image(draw_charts(_charts(sweeps), columns=3), options.out / "renderer.png")


if __name__ == "__main__":
    start(main, Options, __doc__)
