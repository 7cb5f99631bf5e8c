"""Measure mesh conversion: splats of a mesh against ray casting of the mesh.

``python -m recipes.benchmarks.mesh_conversion --data DIR [--cache DIR] [--json OUT] [--chart PNG]``
converts every textured mesh of the data folder's manifest in every mode, renders the splats from
8 views at 512 x 512 and compares with ray casting (Open3D) of the same views; ``--curve`` adds run
time against error over the splat count.

What is measured
----------------
* The camera stands where the bounding sphere just fits the picture, at azimuths 0, 45, ... and
  elevations 10 and 40 degrees in turn.
* Silhouette IoU: pixels at least half covered, in both pictures. ``iou error`` is 1 - IoU in dB.
* Colour PSNR: over the pixels of the mesh's silhouette, both pictures over mid-grey, so that holes
  and rims count as errors.
* With ``--overhang``: the largest aspect ratio of a splat, and how far the contour of half opacity
  of any splat extends beyond the mesh, in spacings (at ``RIM_POINTS`` points round every splat;
  points inside the mesh do not count).
* IoU and PSNR come twice: with the splats' picture taken at one sample per pixel, as the renderer
  draws it with 3DGS's blur of 0.3 px^2, which widens every silhouette by about a pixel; and at
  ``render_samples``^2 samples per pixel, as the ray caster's picture is taken.
"""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import json
import math
import statistics
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.render import render
from gscomplete.splats import Splats, transform_splats
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.util.atomic import atomic_path
from gscomplete.util.optional import import_open3d
from gscomplete.views import Cameras, ObjectFrame, UpAxis, orbit_cameras
from recipes.benchmarks.mesh_truth import Truth, cast_mesh, scene_of
from recipes.entry_point import start
from splatcomplete_data.mesh.convert import OUTLINE_PX, ConvertMode, ConvertSettings, convert_mesh
from splatcomplete_data.mesh.files.load import Mesh, load_mesh
from splatcomplete_data.mesh.files.parts import MeshPart

GREY = 0.5
RIM_POINTS = 16
_BEHIND = 0.7
"""Cosine from which a way off a triangle leads straight behind it."""
FOV_DEG = 40.0


@dataclass(frozen=True)
class Options:
    """Measure mesh conversion against ray casting."""

    data: Path = Path("../shared/data")
    """Folder with MANIFEST.tsv."""
    only: tuple[str, ...] = ()
    """Meshes whose path contains one of these; none = all textured meshes."""
    modes: tuple[ConvertMode, ...] = ("cells", "random")
    """Modes compared."""
    count: int = 100_000
    """Splats per mesh."""
    curve: tuple[int, ...] = ()
    """Further counts, for the curve of run time against error."""
    size_px: int = 512
    """Width and height of the pictures."""
    ray_samples: int = 2
    """Rays per pixel along each side."""
    render_samples: int = 2
    """Samples per pixel of the splats' picture along each side."""
    overhang: bool = False
    """Measure aspect and overhang too."""
    cache: Path | None = None
    """Folder that keeps the ray casts between runs; None = cast again."""
    json: Path | None = None
    """Write the numbers to this file."""


@dataclass(frozen=True)
class Score:
    """One mesh in one mode at one count."""

    mesh: str
    mode: str
    splats: int
    triangles: int
    convert_s: float
    iou: float
    psnr_db: float
    iou_one_sample: float
    psnr_one_sample_db: float
    aspect: float | None = None
    """Longer over shorter tangent standard deviation, the largest; None = not measured."""
    overhang_spacings: float | None = None


def main(options: Options) -> None:
    """Run the benchmark and report."""
    scores: list[Score] = []
    paths = mesh_paths(options)
    _warm_up()
    for number, path in enumerate(paths):
        mesh = load_mesh(options.data / path, allow_outside=options.data)
        frame, cameras = views_of(mesh, path, options.size_px)
        truth = _truth(options, path, frame, cameras)
        for mode in options.modes:
            for count in (options.count, *options.curve):
                score = measure(mesh, path, frame, cameras, truth, mode, count, options)
                scores.append(score)
                sys.stdout.write(
                    f"{number + 1:3}/{len(paths)} {mode:6} {score.splats:8,} "
                    f"IoU {score.iou:.4f} ({score.iou_one_sample:.4f}) PSNR {score.psnr_db:5.2f} "
                    f"({score.psnr_one_sample_db:5.2f}) dB {score.convert_s:6.3f} s "
                    f"{_shape_note(score)}{path}\n"
                )
                sys.stdout.flush()
    summary = summarise(scores)
    for line in summary:
        sys.stdout.write(json.dumps(line) + "\n")
    if options.json:
        content = {"scores": [dataclasses.asdict(score) for score in scores], "summary": summary}
        with atomic_path(options.json) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def mesh_paths(options: Options) -> list[str]:
    """Return the textured meshes of the manifest.

    Raises:
        UserError: there is no manifest, or no mesh fits.
    """
    manifest = options.data / "MANIFEST.tsv"
    if not manifest.is_file():
        raise UserError(f"{manifest}: expected the data folder's manifest, found no file")
    with manifest.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))
    paths = [row["path"] for row in rows if row["kind"] == "mesh"]
    if options.only:
        paths = [path for path in paths if any(part in path for part in options.only)]
    textured = [
        path
        for path in paths
        if any(
            part.texture is not None
            for part in load_mesh(options.data / path, allow_outside=options.data).parts
        )
    ]
    if not textured:
        raise UserError(f"{manifest}: no textured mesh fits {options.only}")
    return textured


def views_of(mesh: Mesh, path: str, size_px: int) -> tuple[ObjectFrame, Cameras]:
    """Return the object frame of a mesh and the eight cameras that just contain it."""
    up: UpAxis = "Y" if path.endswith((".glb", ".gltf")) else "Z"
    low, high = mesh.bounds()
    x, y, z = ((low + high) / 2).tolist()
    frame = ObjectFrame(up, (x, y, z), float((high - low).max()))
    corners = np.concatenate([part.vertices.reshape(-1, 3) for part in mesh.parts])
    reach = float(np.linalg.norm(corners - (low + high) / 2, axis=1).max()) / frame.size_file
    cameras = orbit_cameras(
        torch.arange(8) * 45.0,
        torch.tensor([10.0, 40.0] * 4),
        radius=1.02 * reach / math.sin(math.radians(FOV_DEG / 2)),
        fov_deg=FOV_DEG,
        size_px=size_px,
    )
    return frame, cameras


def measure(
    mesh: Mesh,
    path: str,
    frame: ObjectFrame,
    cameras: Cameras,
    truth: Truth,
    mode: ConvertMode,
    count: int,
    options: Options,
) -> Score:
    """Convert in one mode and compare."""
    started = time.perf_counter()
    settings = ConvertSettings(mode=mode, outline_px=OUTLINE_PX)
    conversion = convert_mesh(mesh, count, settings=settings)
    seconds = time.perf_counter() - started
    splats = conversion.splats
    moved = transform_splats(splats, frame.object_from_file)
    many = compare(moved, cameras, truth, options.render_samples)
    one = compare(moved, cameras, truth, 1)
    score = Score(path, mode, len(splats), mesh.triangles, seconds, *many, *one)
    if not options.overhang:
        return score
    tangent = splats.scales[:, :2]
    aspect = float((tangent.amax(dim=1) / tangent.amin(dim=1)).max())
    beyond = overhang(moved, mesh, frame) * frame.size_file / conversion.spacing
    return dataclasses.replace(score, aspect=aspect, overhang_spacings=beyond)


def overhang(splats: Splats, mesh: Mesh, frame: ObjectFrame) -> float:
    """Return how far the farthest splat reaches beyond a mesh at half its opacity, object sizes.

    What lies straight behind its nearest triangle is inside, not beyond.

    Args:
        splats: in the object frame, x and y of each in its tangent plane.
        mesh: in its file's frame.
        frame: the object frame.

    Raises:
        UserError: Open3D is not installed.
    """
    core = import_open3d("distances").core
    scene = scene_of(mesh, frame)
    axes = rotation_matrices(splats.quaternions)[:, :, :2] * splats.scales[:, None, :2]
    half = math.sqrt(2 * math.log(2))
    farthest = 0.0
    for step in range(RIM_POINTS):
        angle = 2 * math.pi * step / RIM_POINTS
        rim = splats.means + half * (
            math.cos(angle) * axes[..., 0] + math.sin(angle) * axes[..., 1]
        )
        nearest = scene.compute_closest_points(core.Tensor(rim.numpy().astype(np.float32)))
        away = rim.numpy() - nearest["points"].numpy()
        distance = np.linalg.norm(away, axis=1)
        along = np.einsum("nc,nc->n", away, nearest["primitive_normals"].numpy())
        farthest = max(farthest, float(distance[along > -_BEHIND * distance].max(initial=0.0)))
    return farthest


def compare(splats: Splats, cameras: Cameras, truth: Truth, samples: int) -> tuple[float, float]:
    """Return mean silhouette IoU, and colour PSNR in dB over all views' silhouettes."""
    size = cameras.height
    fine = cameras.resized(size * samples, size * samples)
    shape = (size, samples, size, samples)
    overlaps, squared, pixels = [], 0.0, 0
    for view in range(len(cameras)):
        with torch.no_grad():
            drawn = render(splats, fine[view], torch.full((3,), GREY))
        alpha = drawn.alpha[0].numpy().reshape(shape).mean(axis=(1, 3))
        color = drawn.color[0].numpy().clip(0, 1).reshape(*shape, 3).mean(axis=(1, 3))
        real = truth.coverage[view] >= 0.5
        ours = alpha >= 0.5
        overlaps.append(float((real & ours).sum() / max((real | ours).sum(), 1)))
        wanted = truth.color[view] + GREY * (1 - truth.coverage[view])[..., None]
        error = np.square(color - wanted).mean(axis=-1)
        squared, pixels = squared + float(error[real].sum()), pixels + int(real.sum())
    return statistics.mean(overlaps), -10 * math.log10(max(squared / max(pixels, 1), 1e-10))


def summarise(scores: list[Score]) -> list[dict[str, float | int | str]]:
    """Average over the meshes, by mode and count."""
    groups: dict[tuple[str, int], list[Score]] = {}
    for score in scores:
        nominal = min({s.splats for s in scores}, key=lambda n: abs(math.log(n / score.splats)))
        groups.setdefault((score.mode, round(nominal, 1 - len(str(nominal)))), []).append(score)
    return [
        {
            "mode": mode,
            "count": count,
            "meshes": len(group),
            "iou": round(statistics.mean(s.iou for s in group), 4),
            "iou_error_db": round(10 * math.log10(1 - statistics.mean(s.iou for s in group)), 2),
            "psnr_db": round(statistics.mean(s.psnr_db for s in group), 2),
            "iou_one_sample": round(statistics.mean(s.iou_one_sample for s in group), 4),
            "psnr_one_sample_db": round(statistics.mean(s.psnr_one_sample_db for s in group), 2),
            "convert_s": round(statistics.median(s.convert_s for s in group), 4),
            "splats_per_s": round(sum(s.splats for s in group) / sum(s.convert_s for s in group)),
        }
        for (mode, count), group in groups.items()
    ]


def _shape_note(score: Score) -> str:
    """Write aspect and overhang, where they were measured."""
    if score.aspect is None or score.overhang_spacings is None:
        return ""
    return f"aspect {score.aspect:.1f}, overhang {score.overhang_spacings:.2f} "


def _truth(options: Options, path: str, frame: ObjectFrame, cameras: Cameras) -> Truth:
    """Cast the mesh with its textures at full size, or read what an earlier run cast."""
    key = f"{path}|{options.size_px}|{options.ray_samples}|sphere"
    name = hashlib.sha256(key.encode()).hexdigest()[:16] + ".npz"
    cached = None if options.cache is None else options.cache / name
    if cached is not None and cached.is_file():
        with np.load(cached) as stored:
            color = stored["color"].astype(np.float32) / 65535
            return Truth(color, stored["coverage"].astype(np.float32) / 255)
    mesh_as_given = load_mesh(
        options.data / path, max_texture_px=16_384, allow_outside=options.data
    )
    truth = cast_mesh(mesh_as_given, frame, cameras, options.ray_samples)
    if cached is not None:
        cached.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(cached) as temporary:
            np.savez(
                temporary,
                color=np.rint(truth.color * 65535).astype(np.uint16),
                coverage=np.rint(truth.coverage * 255).astype(np.uint8),
            )
    return truth


def _warm_up() -> None:
    """Compile everything that is timed."""
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32)
    texture = np.ones((2, 2, 4), np.float32)
    part = MeshPart(corners, np.ones_like(corners), corners[:, :, :2].copy(), texture)
    modes: tuple[ConvertMode, ...] = ("cells", "grid", "random")
    for mode in modes:
        settings = ConvertSettings(mode=mode, outline_px=OUTLINE_PX)
        convert_mesh(Mesh((part,)), 100, settings=settings)


if __name__ == "__main__":
    start(main, Options, __doc__)
