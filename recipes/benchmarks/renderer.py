"""Time the CPU renderer, and its error against the float64 twin.

``python -m recipes.benchmarks.renderer [--mesh FILE] [--json OUT]`` draws the surface of a mesh (a
torus knot when none is given) as oriented discs: forward and backward of the whole differentiable
render, medians over repeats, by splat count; with ``--check`` against float64 too.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
import torch
import tyro

from gscomplete.atomic import atomic_path
from gscomplete.render import render
from gscomplete.splats import Splats, colors_to_sh
from gscomplete.views import Cameras, four_view_orbit


@dataclass(frozen=True)
class Options:
    """Time the CPU renderer."""

    mesh: Path | None = None
    """Mesh whose surface is drawn, in any format trimesh reads; None = a torus knot."""
    counts: tuple[int, ...] = (10_000, 40_000, 160_000)
    """Numbers of splats."""
    size_px: int = 256
    """Width and height of the picture."""
    repeats: int = 15
    """Timed repeats after two untimed ones."""
    threads: int | None = None
    """Numba threads; None = all cores."""
    check: bool = False
    """Compare the largest count with the float64 twin (minutes)."""
    json: Path | None = None
    """Write the numbers to this file."""


@dataclass(frozen=True)
class Timing:
    """Medians of one splat count."""

    splats: int
    forward_ms: float
    backward_ms: float
    total_ms: float


@dataclass(frozen=True)
class Errors:
    """Differences from the float64 twin."""

    color_mean: float
    color_max: float
    gradient_relative: dict[str, float]


def surface_discs(mesh_path: Path | None, count: int) -> Splats:
    """Cover a surface of largest side 1 with ``count`` oriented discs coloured by normal."""
    if mesh_path is None:
        points, normals, area = _torus_knot(count)
    else:
        import trimesh

        mesh = trimesh.load(mesh_path, force="mesh", process=False)
        side = float(np.max(mesh.extents))
        points, faces = trimesh.sample.sample_surface(mesh, count, seed=0)
        points = (points - mesh.bounds.mean(axis=0)) / side
        normals, area = mesh.face_normals[faces], mesh.area / side**2
    axis = np.cross([0.0, 0.0, 1.0], normals)
    quaternions = np.concatenate([1.0 + normals[:, 2:], axis], axis=1)
    quaternions[np.linalg.norm(quaternions, axis=1) < 1e-6] = (0.0, 1.0, 0.0, 0.0)
    width = 0.72 * np.sqrt(area / count)
    return Splats(
        torch.from_numpy(points).float(),
        torch.nn.functional.normalize(torch.from_numpy(quaternions).float(), dim=1),
        torch.tensor([[width, width, 0.05 * width]], dtype=torch.float32).repeat(count, 1),
        torch.full((count,), 0.95),
        colors_to_sh(torch.from_numpy(normals * 0.5 + 0.5).float()),
    )


def _torus_knot(count: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Points and normals on a (2, 3) torus knot tube, and its area."""
    rng = np.random.default_rng(0)
    t, phi = 2 * np.pi * rng.random(count), 2 * np.pi * rng.random(count)
    radius = 0.28 + 0.12 * np.cos(3 * t)
    center = np.stack([radius * np.cos(2 * t), radius * np.sin(2 * t), 0.12 * np.sin(3 * t)], 1)
    ahead = t + 1e-4
    radius2 = 0.28 + 0.12 * np.cos(3 * ahead)
    tangent = (
        np.stack(
            [radius2 * np.cos(2 * ahead), radius2 * np.sin(2 * ahead), 0.12 * np.sin(3 * ahead)], 1
        )
        - center
    )
    length = float(np.linalg.norm(tangent, axis=1).mean() / 1e-4 * 2 * np.pi)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)
    normals = np.cos(phi)[:, None] * side + np.sin(phi)[:, None] * up
    return center + 0.06 * normals, normals, length * 2 * np.pi * 0.06


def _leaves(splats: Splats) -> Splats:
    """Copy splats into tensors that take gradients."""
    return Splats(**{name: value.clone().requires_grad_() for name, value in splats.fields()})


def time_render(splats: Splats, cameras: Cameras, repeats: int) -> Timing:
    """Time forward and backward of one view; medians in milliseconds."""
    trainable = _leaves(splats)
    weights = torch.randn(1, cameras.height, cameras.width, 3)
    forward, backward = [], []
    for _ in range(repeats + 2):
        for _, value in trainable.fields():
            value.grad = None
        start = time.perf_counter()
        color = render(trainable, cameras, backend="cpu").color
        middle = time.perf_counter()
        loss = (color * weights).sum()
        before = time.perf_counter()
        loss.backward()
        backward.append(time.perf_counter() - before)
        forward.append(middle - start)
    ahead, back = np.array(forward[2:]) * 1e3, np.array(backward[2:]) * 1e3
    return Timing(
        len(splats), float(np.median(ahead)), float(np.median(back)), float(np.median(ahead + back))
    )


def compare_with_float64(splats: Splats, cameras: Cameras) -> Errors:
    """Compare colours and gradients with the float64 twin."""
    weights = torch.randn(1, cameras.height, cameras.width, 3, dtype=torch.float64)
    colors, gradients = [], []
    for backend in ("cpu", "reference"):
        trainable = _leaves(splats)
        color = render(trainable, cameras, backend=backend).color.double()
        (color * weights).sum().backward()
        colors.append(color.detach())
        gradients.append({name: value.grad.double() for name, value in trainable.fields()})
    error = (colors[0] - colors[1]).abs()
    relative = {
        name: float((gradients[0][name] - value).norm() / value.norm().clamp_min(1e-300))
        for name, value in gradients[1].items()
    }
    return Errors(float(error.mean()), float(error.max()), relative)


def main(options: Options) -> None:
    """Run the benchmark and report."""
    if options.threads:
        numba.set_num_threads(options.threads)
    torch.manual_seed(0)
    cameras = four_view_orbit(30, 15, radius=2.0, fov_deg=40, size_px=options.size_px)[0]
    out = sys.stdout
    out.write(f"{numba.get_num_threads()} threads, {options.size_px} x {options.size_px}\n")
    out.write(f"{'splats':>9} {'forward':>9} {'backward':>9} {'total':>9}  (ms, median)\n")
    timings = []
    for count in options.counts:
        timing = time_render(surface_discs(options.mesh, count), cameras, options.repeats)
        timings.append(timing)
        out.write(
            f"{timing.splats:9,} {timing.forward_ms:9.1f} {timing.backward_ms:9.1f} "
            f"{timing.total_ms:9.1f}\n"
        )
    errors = None
    if options.check:
        errors = compare_with_float64(surface_discs(options.mesh, options.counts[-1]), cameras)
        out.write(f"against float64: {json.dumps(dataclasses.asdict(errors), indent=1)}\n")
    if options.json:
        content = {
            "threads": numba.get_num_threads(),
            "size_px": options.size_px,
            "timings": [dataclasses.asdict(timing) for timing in timings],
            "errors": None if errors is None else dataclasses.asdict(errors),
        }
        with atomic_path(options.json) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(tyro.cli(Options))
