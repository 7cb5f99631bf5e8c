"""Time other renderers beside ours: ``python -m recipes.benchmarks.renderer.peers --peer FILE.py``.

A peer is a Python file outside this repository, written by whoever has that renderer installed:

* ``NAME``: what the table calls it.
* ``project(splats, cameras) -> tuple``: what its compositing takes (screen centres, conics,
  colours, ...), from a ``gscomplete.splats.Splats`` whose fields require gradients and a
  ``gscomplete.views.Cameras`` of one view (their modules state the conventions). A renderer that
  cannot be split returns the fields themselves.
* ``composite(screen, cameras) -> Tensor [H, W, 3]``: the picture over black, from that tuple.

Gradients must flow through both by autograd. Activations (sigmoid, exp, normalising) stay outside,
as they do for ours. With no ``--peer`` only ours is timed.

Conventions
-----------
* Renderers take turns within every repeat, in one process, with the same number of threads, on the
  same splats and view, with the same gradient of the picture: ratios hold beside other jobs.
* Ratios are of medians, and of the fastest repeats. The compositing ratio counts only a peer's
  compositing, forward and backward, but all of our renderer's time, as every ratio does.
* The differences of a peer's picture and gradients from ours are printed as well, because times
  compare only if both draw the same picture.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import numba
import numpy as np
import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.util.atomic import atomic_path
from gscomplete.views import Cameras
from recipes.benchmarks.clocks import Clock, clock_reader
from recipes.benchmarks.renderer.scenes import bench_camera, surface_discs, trainable_copy
from recipes.entry_point import start


@dataclass(frozen=True, slots=True)
class Options:
    """Time other renderers beside ours."""

    peer: tuple[Path, ...] = ()
    """Python files that wrap other renderers."""
    mesh: Path | None = None
    """Mesh whose surface is drawn; None = a torus knot."""
    splats: tuple[int, ...] = (10_000, 40_000, 160_000)
    """Numbers of splats."""
    sizes: tuple[int, ...] = (256,)
    """Widths and heights of the picture, pixels."""
    sh_degree: int = 0
    """Degree of the spherical harmonics."""
    threads: int | None = None
    """Threads of Numba and PyTorch; None = all cores."""
    repeats: int = 15
    """Timed repeats after one untimed."""
    clock: Clock = "wall"
    """wall, or cpu: processor time, for one thread on a busy machine."""
    json: Path | None = None
    """Write the numbers to this file."""


class Peer(Protocol):
    """What a peer's file must hold."""

    NAME: str

    def project(self, splats: Splats, cameras: Cameras) -> tuple[Tensor, ...]:
        """Return what ``composite`` takes."""

    def composite(self, screen: tuple[Tensor, ...], cameras: Cameras) -> Tensor:
        """Return the picture [H, W, 3] over black."""


@dataclass(frozen=True, slots=True)
class Parts:
    """Seconds of one forward and backward pass."""

    project: float
    composite: float
    composite_backward: float
    project_backward: float

    @property
    def total(self) -> float:
        """All of it."""
        return self.project + self.composite + self.composite_backward + self.project_backward


@dataclass(frozen=True, slots=True)
class Pass:
    """A timed pass and its results."""

    parts: Parts
    color: Tensor  # [H, W, 3]
    gradients: dict[str, Tensor]


def load_peer(path: Path) -> Peer:
    """Load a peer's file.

    Raises:
        UserError: there is no such file, or it lacks a name or a function.
    """
    if not path.is_file():
        raise UserError(f"{path}: expected a Python file that wraps a renderer, found none")
    spec = importlib.util.spec_from_file_location(f"peer_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise UserError(f"{path}: expected a Python file (.py)")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    missing = [name for name in ("NAME", "project", "composite") if not hasattr(module, name)]
    if missing:
        raise UserError(f"{path}: expected NAME, project and composite, missing {missing}")
    return cast(Peer, module)


def run_ours(
    splats: Splats,
    cameras: Cameras,
    upstream: Tensor,
    read: Callable[[], float] = time.perf_counter,
) -> Pass:
    """Time our renderer; its kernels are not split here, so all time counts as compositing."""
    trainable = trainable_copy(splats)
    start = read()
    color = render(trainable, cameras, backend="cpu").color
    middle = read()
    color.backward(upstream[None])
    stop = read()
    parts = Parts(0.0, middle - start, stop - middle, 0.0)
    return Pass(parts, color.detach()[0], _gradients(trainable))


def run_peer(
    peer: Peer,
    splats: Splats,
    cameras: Cameras,
    upstream: Tensor,
    read: Callable[[], float] = time.perf_counter,
) -> Pass:
    """Time another renderer, stage by stage."""
    trainable = trainable_copy(splats)
    times = [read()]
    screen = peer.project(trainable, cameras)
    times.append(read())
    # Cut here, so that each half of the backward pass runs, and is timed, by itself.
    cut = tuple(value.detach().requires_grad_(value.requires_grad) for value in screen)
    color = peer.composite(cut, cameras)
    times.append(read())
    color.backward(upstream)
    times.append(read())
    used = [(value, leaf.grad) for value, leaf in zip(screen, cut, strict=True)]
    used = [(value, grad) for value, grad in used if grad is not None]
    torch.autograd.backward([value for value, _ in used], [grad for _, grad in used])
    times.append(read())
    parts = Parts(*(float(d) for d in np.diff(times)))
    return Pass(parts, color.detach(), _gradients(trainable))


def _gradients(splats: Splats) -> dict[str, Tensor]:
    return {
        name: torch.zeros_like(value) if value.grad is None else value.grad
        for name, value in splats.fields()
    }


def distance(found: Pass, ours: Pass) -> dict[str, Any]:
    """Say how far another renderer's picture and gradients are from ours."""
    error = (found.color - ours.color).abs()
    relative = {
        name: float((found.gradients[name] - value).norm() / value.norm().clamp_min(1e-30))
        for name, value in ours.gradients.items()
    }
    return {
        "color_mean": float(error.mean()),
        "color_max": float(error.max()),
        "gradient_relative": relative,
    }


def compare(
    peers: list[Peer],
    splats: Splats,
    cameras: Cameras,
    repeats: int,
    read: Callable[[], float] = time.perf_counter,
) -> dict[str, dict[str, Any]]:
    """Time ours and the peers in turns.

    Returns:
        By name, ours first: medians of every part and the fastest total in milliseconds, ratios to
        our total, and the distance from our picture and gradients.
    """
    upstream = torch.randn(cameras.height, cameras.width, 3)
    runs: dict[str, Callable[[], Pass]] = {
        "ours": lambda: run_ours(splats, cameras, upstream, read)
    }
    for peer in peers:
        runs[peer.NAME] = lambda peer=peer: run_peer(peer, splats, cameras, upstream, read)
    first = {name: run() for name, run in runs.items()}
    parts: dict[str, list[Parts]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            parts[name].append(run().parts)
    rows: dict[str, dict[str, Any]] = {}
    names = [f"{field.name}_ms" for field in dataclasses.fields(Parts)]
    for name, found in parts.items():
        middle = 1e3 * np.median([dataclasses.astuple(one) for one in found], axis=0)
        totals = 1e3 * np.array([one.total for one in found])
        row: dict[str, Any] = dict(zip(names, middle.tolist(), strict=True))
        row |= {"total_ms": float(np.median(totals)), "fastest_ms": float(totals.min())}
        ours = rows.get("ours", row)
        row["ratio"] = row["total_ms"] / ours["total_ms"]
        row["fastest_ratio"] = row["fastest_ms"] / ours["fastest_ms"]
        compositing = row["composite_ms"] + row["composite_backward_ms"]
        row["compositing_ratio"] = compositing / ours["total_ms"]
        if name != "ours":
            row["distance"] = distance(first[name], first["ours"])
        rows[name] = row
    return rows


_COLUMNS = {
    "project": "project_ms",
    "composite": "composite_ms",
    "c. back": "composite_backward_ms",
    "p. back": "project_backward_ms",
    "total": "total_ms",
    "fastest": "fastest_ms",
    "ratio": "ratio",
    "fastest r.": "fastest_ratio",
    "compos. r.": "compositing_ratio",
}


def _print(rows: dict[str, dict[str, Any]]) -> None:
    out = sys.stdout
    out.write(f"{'ms, medians':32}" + "".join(f" {name:>10}" for name in _COLUMNS) + "\n")
    for name, row in rows.items():
        out.write(f"{name:32}" + "".join(f" {row[k]:10.1f}" for k in _COLUMNS.values()) + "\n")
    for name, row in rows.items():
        if "distance" in row:
            far = row["distance"]
            relative = ", ".join(f"{n} {v:.1e}" for n, v in far["gradient_relative"].items())
            out.write(
                f"{name} against ours: colour {far['color_mean']:.1e} mean, "
                f"{far['color_max']:.1e} max; gradients: {relative}\n"
            )


def main(options: Options) -> None:
    """Time and report."""
    threads = options.threads or numba.config.NUMBA_NUM_THREADS
    if not 1 <= threads <= numba.config.NUMBA_NUM_THREADS:
        limit = numba.config.NUMBA_NUM_THREADS
        raise UserError(f"--threads: expected 1 to {limit} (NUMBA_NUM_THREADS), found {threads}")
    read = clock_reader(options.clock, threads)
    numba.set_num_threads(threads)
    torch.set_num_threads(threads)
    torch.manual_seed(0)
    peers = [load_peer(path) for path in options.peer]
    points = []
    for count in options.splats:
        splats = surface_discs(options.mesh, count, options.sh_degree)
        for size in options.sizes:
            sys.stdout.write(f"{count:,} splats, {size} x {size}, {threads} threads\n")
            rows = compare(peers, splats, bench_camera(size), options.repeats, read)
            _print(rows)
            points.append({"splats": count, "size_px": size, "renderers": rows})
    if options.json:
        content = {
            "threads": threads,
            "clock": options.clock,
            "sh_degree": options.sh_degree,
            "points": points,
        }
        with atomic_path(options.json) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    start(main, Options, __doc__)
