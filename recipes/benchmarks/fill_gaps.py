"""Close gaps of real objects: ``python -m recipes.benchmarks.fill_gaps [--out DIR]``.

Meshes become splats, and these lose what lies in three balls about random places of the surface, in
a slit (a slab through the middle), and below (the lowest 2 % of the height that faces down).
``complete --fill`` closes them.

What is measured
----------------
* Closed: among removed splats without a remaining one within ``NEAR`` (object sizes), the share
  with a new splat within that distance.
* Elsewhere: share of the new splats with no removed one within ``2 NEAR``.
* Off: distance of new splats from the object's own, 95th percentile (lids are smooth, and flatter
  than the surface that they replace).
* IoU of silhouettes from 8 views, 256 px, against the undamaged object.
* The same for the undamaged object, where every splat that is added counts as elsewhere.
"""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from scipy.spatial import cKDTree

from gscomplete.evaluate.pictures import contact_sheet, save_image, to_image
from gscomplete.render import render
from gscomplete.shape.fill.close import close_gaps
from gscomplete.splats import Splats, concatenate, transform_splats
from gscomplete.views import Cameras, ObjectFrame, UpAxis, orbit_cameras, radius_to_fit
from recipes.entry_point import start
from splatcomplete_data.mesh.convert import convert_mesh
from splatcomplete_data.mesh.files.load import load_mesh

NEAR = 0.025
_BALLS = (0.05, 0.08, 0.11)
_SLIT = 0.012
_SPLATS = 40_000


@dataclass(frozen=True)
class Options:
    """Punch holes into real objects and close them."""

    meshes: tuple[str, ...] = ()
    """Meshes below --data; none = five of different kinds."""
    data: Path = Path("../shared/data/mesh")
    """Folder with meshes."""
    out: Path | None = None
    """Folder for table and pictures; None = print only."""
    seed: int = 0
    """Seed of the positions of holes."""


FIVE: tuple[tuple[str, UpAxis], ...] = (
    ("bullet3/pybullet_data/duck.obj", "Y"),
    ("bullet3/data/dinnerware/cup/Cup/textured-0008192.obj", "Z"),
    ("bullet3/pybullet_data/soccerball.obj", "Z"),
    ("armadillo.obj", "Y"),
    ("aws_house/Refrigerator_01/meshes/aws_Refrigerator_01_visual.DAE", "Z"),
)


def punched(whole: Splats, seed: int) -> torch.Tensor:  # [N] bool
    """Mark what is taken away: balls, a slit, the underside."""
    rng = np.random.default_rng(seed)
    points = whole.means
    gone = torch.zeros(len(whole), dtype=torch.bool)
    for radius in _BALLS:
        middle = points[int(rng.integers(len(points)))]
        gone |= (points - middle).norm(dim=1) < radius
    angle = float(rng.uniform(0, math.pi))
    side = points[:, 0] * math.cos(angle) + points[:, 1] * math.sin(angle)
    across = points[:, 1] * math.cos(angle) - points[:, 0] * math.sin(angle)
    gone |= (side.abs() < _SLIT / 2) & (across > 0)
    low, high = points[:, 2].min(), points[:, 2].max()
    return gone | (points[:, 2] < low + 0.02 * (high - low))


def main(options: Options) -> int:
    """Measure every mesh and print a table."""
    entries = [(name, up) for name, up in FIVE if not options.meshes or name in options.meshes]
    rows = []
    for name, up in entries:
        path = options.data / name
        splats = convert_mesh(load_mesh(path), _SPLATS).splats
        whole = transform_splats(splats, ObjectFrame.about(splats, up).object_from_file)
        row = measure(path, whole.with_sh_degree(0), options)
        rows.append(row)
        sys.stdout.write(json.dumps(row) + "\n")
        sys.stdout.flush()
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "fill_gaps.json").write_text(json.dumps(rows, indent=1) + "\n")
    return 0


def measure(path: Path, whole: Splats, options: Options) -> dict[str, object]:
    """Punch, close and compare one object."""
    gone = punched(whole, options.seed)
    partial, missing = whole.select(~gone), whole.select(gone)
    started = time.perf_counter()
    filled = close_gaps(partial, torch.Generator().manual_seed(0))
    seconds = time.perf_counter() - started
    new = filled.splats
    untouched = len(close_gaps(whole, torch.Generator().manual_seed(0)).splats)
    completed = concatenate([partial, new])
    row: dict[str, object] = {
        "object": path.stem,
        "removed": len(missing),
        "new": len(new),
        "closed": _share_near(_away_from(missing, partial), new, NEAR),
        "elsewhere": 1 - _share_near(new, missing, 2 * NEAR) if len(new) else 0.0,
        "off": _percentile(new, whole),
        "iou_before": _iou(partial, whole),
        "iou_after": _iou(completed, whole),
        "new_of_untouched": untouched,
        "seconds": round(seconds, 1),
        "note": filled.note,
    }
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        save_image(_sheet(whole, partial, completed), options.out / f"{path.stem}.png")
    return row


def _percentile(points: Splats, others: Splats) -> float:
    """Return the 95th percentile of the distances from the nearest of the others."""
    if not len(points):
        return 0.0
    away, _ = cKDTree(others.means.numpy()).query(points.means.numpy())
    return float(np.quantile(away, 0.95))


def _away_from(points: Splats, others: Splats) -> Splats:
    """Return the splats that no other is near."""
    away, _ = cKDTree(others.means.numpy()).query(points.means.numpy())
    return points.select(torch.from_numpy(away > NEAR))


def _share_near(points: Splats, others: Splats, distance: float) -> float:
    """Return the share of splats that have another within a distance."""
    if not len(others) or not len(points):
        return 0.0
    away, _ = cKDTree(others.means.numpy()).query(points.means.numpy())
    return float((away <= distance).mean())


def _cameras(size_px: int) -> Cameras:
    """Return eight views round the object, half of them from below."""
    return orbit_cameras(
        torch.arange(8) * 45.0,
        torch.tensor([20.0, -30.0]).repeat(4),
        radius=radius_to_fit(1.6, 40.0),
        fov_deg=40.0,
        size_px=size_px,
    )


def _iou(splats: Splats, truth: Splats) -> float:
    """Return the IoU of silhouettes from eight views."""
    with torch.no_grad():
        a, b = (render(s, _cameras(256)).alpha > 0.5 for s in (splats, truth))
    return float((a & b).sum() / (a | b).sum())


def _sheet(*versions: Splats) -> Image.Image:
    """Draw the object before, punched and closed."""
    cameras, rows = _cameras(384), []
    for splats in versions:
        with torch.no_grad():
            color = render(splats, cameras[[0, 1, 3, 5]], torch.ones(3)).color
        rows.append([to_image(picture) for picture in color])
    return contact_sheet(rows, row_labels=["object", "punched", "filled"])


if __name__ == "__main__":
    start(main, Options, __doc__)
