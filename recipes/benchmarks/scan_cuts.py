"""Measure scan cuts: what they keep of splats of a mesh, against ray casting of the mesh.

``python -m recipes.benchmarks.scan_cuts --data DIR``: textured meshes of the data folder's manifest
become splats, each is cut by a scan from a direction of its own, and a ray (Open3D) goes from the
scanner to every splat's centre.

* visible: the ray meets nothing more than ``_AT`` object sizes before the centre. An ideal cut
  keeps all of these splats.
* hidden: the ray meets the mesh more than ``_BEHIND`` before the centre. An ideal cut keeps none of
  these. Splats between the two limits are not counted.
"""

from __future__ import annotations

import statistics
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscomplete.splats import Splats, transform_splats
from gscomplete.util.arrays import BoolArray, Float64Array
from gscomplete.util.optional import import_open3d
from recipes.benchmarks.mesh_conversion import Options as MeshOptions
from recipes.benchmarks.mesh_conversion import mesh_paths, views_of
from recipes.benchmarks.mesh_truth import scene_of
from recipes.entry_point import start
from splatcomplete_data.cuts.named import ScanCut
from splatcomplete_data.mesh.convert import convert_mesh
from splatcomplete_data.mesh.files.load import load_mesh

_AT, _BEHIND = 0.002, 0.02
_KEPT, _HIDDEN = 0.99, 0.01
"""Shares of the visible and of the hidden splats that a good cut keeps."""
_TURN_DEG, _ELEVATIONS_DEG = 137.5, (5.0, 20.0, 35.0)
"""The scanner of the next mesh stands so much farther round it, and at the next elevation."""


@dataclass(frozen=True)
class Options:
    """Measure scan cuts against ray casting."""

    data: Path = Path("../shared/data")
    """Folder with MANIFEST.tsv."""
    meshes: int = 20
    """Number of meshes, evenly spread over the textured ones."""
    count: int = 40_000
    """Splats per mesh."""


@dataclass(frozen=True, slots=True)
class Kept:
    """What a cut keeps."""

    visible: float
    """Share of the visible splats."""
    hidden: float
    """Share of the hidden splats."""


def seen_by_rays(
    scene: object, splats: Splats, eye: Float64Array
) -> tuple[BoolArray, BoolArray]:  # [N], [N]
    """Return which splats are visible, and which are hidden.

    Args:
        scene: the mesh in its object frame.
        splats: in the same frame.
        eye: where the scanner stands.
    """
    core = import_open3d("ray casting").core
    away = splats.means.double().numpy() - eye
    distance = np.linalg.norm(away, axis=1)
    rays = np.concatenate([np.broadcast_to(eye, away.shape), away / distance[:, None]], axis=1)
    hit = scene.cast_rays(core.Tensor(rays.astype(np.float32)))["t_hit"].numpy()  # type: ignore[attr-defined]
    before = distance - hit  # negative infinity where the ray meets nothing
    return before <= _AT, before > _BEHIND


def measure(path: str, number: int, options: Options) -> Kept:
    """Convert, cut and compare one mesh."""
    mesh = load_mesh(options.data / path, allow_outside=options.data)
    frame, _ = views_of(mesh, path, 64)
    splats = transform_splats(convert_mesh(mesh, options.count).splats, frame.object_from_file)
    azimuth_deg = number * _TURN_DEG % 360.0
    elevation_deg = _ELEVATIONS_DEG[number % len(_ELEVATIONS_DEG)]
    cut = ScanCut(((azimuth_deg, elevation_deg),))
    kept = cut.apply(splats).mask.numpy()
    visible, hidden = seen_by_rays(scene_of(mesh, frame), splats, cut.eyes[0])
    return Kept(float(kept[visible].mean()), float(kept[hidden].mean()) if hidden.any() else 0.0)


def main(options: Options) -> None:
    """Measure and report."""
    paths = mesh_paths(MeshOptions(options.data))
    step = max(1.0, len(paths) / options.meshes)
    chosen = [paths[int(k * step)] for k in range(min(options.meshes, len(paths)))]
    found = []
    for number, path in enumerate(chosen):
        kept = measure(path, number, options)
        found.append(kept)
        sys.stdout.write(f"visible {kept.visible:.4f}, hidden {kept.hidden:.4f} kept: {path}\n")
        sys.stdout.flush()
    visible, hidden = ([getattr(kept, name) for kept in found] for name in ("visible", "hidden"))
    good = [sum(v >= _KEPT for v in visible), sum(h <= _HIDDEN for h in hidden)]
    sys.stdout.write(
        f"{len(found)} meshes: kept of the visible {statistics.mean(visible):.4f} (median "
        f"{statistics.median(visible):.4f}; {good[0]} at least {_KEPT}), of the hidden "
        f"{statistics.mean(hidden):.4f} (median {statistics.median(hidden):.4f}; {good[1]} at "
        f"most {_HIDDEN})\n"
    )


if __name__ == "__main__":
    start(main, Options, __doc__)
