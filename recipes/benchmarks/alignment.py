"""How often another system's result is aligned: ``python -m recipes.benchmarks.alignment``.

Objects of a pack of meshes are moved by random similarities (any rotation, scale 0.3 to 3, shift of
twice the size, another brightness). A part of each, from which a random plane cuts off 30 to 50 %
of the surface, has to be located in the moved object. The object is sampled evenly and the part at
random, so the two share no point.

* ``found``: the pose is within 2 degrees, 1 % of scale and 1 % of the size of the true one.
* ``up to symmetry``: the same after a similarity that maps the complete textured object onto
  itself, with 95 % of its surface within 1 % of its size of the surface and with the colour of a
  place that near. It is computed from the pose found, by ICP of the complete object with itself.
* ``--distort`` makes results like those of other systems: ``stretch`` makes one axis of the box
  10 % longer (found: within 5 degrees, 10 % of scale and 5 % of the size, as no similarity is
  exact), ``visible`` keeps only the side of the result that P shows.
* ``as P allows``: neither of these, but P fits the result as well as at the true pose, colours
  included, so that only the surface that P lacks could tell the two poses apart. Counts as missed.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from gscomplete.evaluate.align import AlignmentSettings, align_points
from gscomplete.evaluate.align.refine import Candidate, Target, surface_of
from gscomplete.splats.transform import Similarity
from gscomplete.util.arrays import Float64Array
from recipes.entry_point import start
from recipes.real_objects.unseen import chosen_entries
from recipes.train_embedded_prior.data.mesh_pack import (
    PackEntry,
    PackMesh,
    read_manifest,
    read_mesh,
)
from splatcomplete_data.mesh.discs import sample_triangles, triangle_areas_and_normals
from splatcomplete_data.mesh.sampling import uniform_points

_POINTS = 30_000
"""Samples of the surface, for the result, for the object that P is cut from, and to judge with."""
_PLAIN = 0.6
"""Grey of objects whose colour is not known."""
Distortion = Literal["none", "stretch", "visible"]
_MOST = {"none": (2.0, 0.01, 0.01), "stretch": (5.0, 0.1, 0.05), "visible": (2.0, 0.01, 0.01)}
"""Degrees, share of scale and share of the size that count as found."""
_STRETCH = 1.1
_SURFACE_SHARE, _NEAR, _COLOR = 0.95, 0.01, 0.1
"""Share of the surface that a symmetry maps this near to the surface, and to such a colour."""


@dataclass(frozen=True)
class Options:
    """Measure how often results are aligned."""

    meshes: Path
    """Folder of the pack of meshes."""
    split: Literal["validation", "train"] = "validation"
    """Split of the pack; ``train`` for development."""
    objects: int = 30
    """Number of objects, evenly spread over the list."""
    offset: int = 0
    """Shift by so many objects along the list, to use others of ``train``."""
    only: tuple[str, ...] = ()
    """Only objects whose ids have these endings; none = all."""
    rotations: int = 1000
    """Number of rotations that the alignment tries."""
    distort: Distortion = "none"
    """How the result differs from the object, in addition to pose and brightness."""
    seed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A part to be found in a result."""

    points: Float64Array  # [n, 3] of the complete object, largest side 1, box centred
    colors: Float64Array  # [n, 3]
    result: Float64Array  # [k, 3] points, or what a distortion makes of them, moved by ``true``
    result_colors: Float64Array  # [k, 3]
    part: Float64Array  # [m, 3]
    part_colors: Float64Array  # [m, 3]
    true: Similarity
    """result_from_object"""


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a pose compares with the true one."""

    degrees: float
    growth: float
    shift: float
    kind: Literal["found", "up to symmetry", "as P allows", "MISSED"]


def make_case(
    mesh: PackMesh, entry: PackEntry, rng: np.random.Generator, distort: Distortion = "none"
) -> Case:
    """Sample, move and cut an object."""
    points, colors = surface_samples(mesh, entry, None)
    whole, whole_colors = surface_samples(mesh, entry, int(rng.integers(1 << 30)))
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    height = whole @ normal
    limit = np.quantile(height, rng.uniform(0.3, 0.5))
    kept = height > limit
    shift = rng.normal(size=3)
    true = Similarity(
        math.exp(rng.uniform(math.log(0.3), math.log(3.0))),
        torch.from_numpy(Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()),
        torch.from_numpy(2.0 * shift / np.linalg.norm(shift)),
    )
    gain = rng.uniform(0.6, 1.0)
    made, made_colors = points, gain * colors
    if distort == "stretch":
        made = points * np.where(np.arange(3) == rng.integers(3), _STRETCH, 1.0)
    elif distort == "visible":
        is_visible = points @ normal > limit
        made, made_colors = points[is_visible], made_colors[is_visible]
    result = true.apply(torch.from_numpy(made)).numpy()
    return Case(points, colors, result, made_colors, whole[kept], whole_colors[kept], true)


def surface_samples(
    mesh: PackMesh, entry: PackEntry, seed: int | None
) -> tuple[Float64Array, Float64Array]:
    """Return points on a mesh, evenly spread or drawn at random from a seed, and their colours."""
    triangles = mesh.vertices[mesh.faces]
    if seed is None:
        face, weights = sample_triangles(triangles, _POINTS, 0)
    else:
        areas, _ = triangle_areas_and_normals(triangles.astype(np.float64))
        face, weights = uniform_points(areas.astype(np.float64), _POINTS, seed)
    points = np.einsum("nk,nkc->nc", weights, triangles[face]).astype(np.float64)
    if entry.colour == "none":
        return points, np.full((len(points), 3), _PLAIN)
    return points, mesh.colors_at(face, weights).astype(np.float64).clip(0, 1)


def judge(case: Case, found: Similarity, distort: Distortion = "none") -> Verdict:
    """Compare a pose with the true one, up to the object's symmetry."""
    left = found.compose(case.true)
    errors = _apart(left, Similarity(1.0, torch.eye(3), torch.zeros(3)))
    if _is_within(errors, distort):
        return Verdict(*errors, "found")
    symmetry = nearest_symmetry(case, left)
    if symmetry is not None and _is_within(_apart(left, symmetry), distort):
        return Verdict(*_apart(left, symmetry), "up to symmetry")
    there, here = (_part_error(case, pose) for pose in (left, None))
    alike = there[0] <= 1.1 * here[0] and there[1] <= here[1] + 0.01
    return Verdict(*errors, "as P allows" if alike else "MISSED")


def nearest_symmetry(case: Case, near: Similarity) -> Similarity | None:
    """Return the similarity near a given one that maps the object onto itself; None = none does."""
    surface = surface_of(case.points, case.colors)
    begin = Candidate(near.scale, near.rotation.numpy(), near.translation.numpy())
    settled = Target.of(surface).refine(begin, surface, 20)
    placed = settled.apply(case.points)
    tree, moved = cKDTree(case.points), cKDTree(placed)
    for a, b, mine, theirs in (
        (tree, placed, case.colors, case.colors),
        (moved, case.points, case.colors, case.colors),
    ):
        distance, row = a.query(b, k=8)
        apart = np.abs(theirs[row] - mine[:, None]).max(axis=2)
        near_enough = (distance < _NEAR) & (apart < _COLOR)
        near_enough[:, 0] &= distance[:, 0] < _NEAR
        if near_enough.any(axis=1).mean() < _SURFACE_SHARE:
            return None
    rotation, shift = torch.from_numpy(settled.rotation), torch.from_numpy(settled.translation)
    return Similarity(settled.scale, rotation, shift)


def _part_error(case: Case, pose: Similarity | None) -> tuple[float, float]:
    """Return how far P lies from the object moved by ``pose``, and how far colours differ."""
    points = case.points
    if pose is not None:
        points = pose.apply(torch.from_numpy(points)).numpy()
    distance, row = cKDTree(points).query(case.part)
    color = np.abs(case.colors[row] - case.part_colors).mean()
    return float(np.sqrt((distance**2).mean())), float(color)


def _apart(one: Similarity, other: Similarity) -> tuple[float, float, float]:
    """Return degrees, relative scale, and how far apart the object's middle lies."""
    cosine = (float(torch.trace(one.rotation @ other.rotation.T)) - 1) / 2
    degrees = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
    shift = float((one.translation - other.translation).norm())
    return degrees, abs(one.scale / other.scale - 1), shift


def _is_within(errors: tuple[float, float, float], distort: Distortion) -> bool:
    return all(error < most for error, most in zip(errors, _MOST[distort], strict=True))


def entries_of(options: Options) -> list[PackEntry]:
    """Return the objects to align."""
    if options.split == "validation":
        chosen = chosen_entries(options.meshes, options.objects)
    else:
        rows = [entry for entry in read_manifest(options.meshes) if entry.split == "train"]
        step = len(rows) / options.objects
        places = (int(k * step) + options.offset for k in range(options.objects))
        chosen = [rows[place % len(rows)] for place in places]
    return [entry for entry in chosen if not options.only or entry.id.endswith(options.only)]


def main(options: Options) -> None:
    """Align every object once and count."""
    kinds: list[str] = []
    seconds: list[float] = []
    for entry in entries_of(options):
        number = entry.number
        rng = np.random.default_rng([options.seed, number])
        case = make_case(read_mesh(options.meshes, entry), entry, rng, options.distort)
        began = time.process_time()
        found = align_points(
            case.result,
            case.part,
            AlignmentSettings(options.rotations),
            colors=case.result_colors,
            target_colors=case.part_colors,
        )
        seconds.append(time.process_time() - began)
        verdict = judge(case, found.target_from_result, options.distort)
        kinds.append(verdict.kind)
        sys.stdout.write(
            f"{entry.id[-40:]:40} {entry.colour:8} {verdict.degrees:6.2f} deg"
            f"  scale {100 * verdict.growth:5.2f} %  shift {100 * verdict.shift:5.2f} %"
            f"  residual {100 * found.residual:.2f} %  {seconds[-1]:5.1f} s  {verdict.kind}\n"
        )
        sys.stdout.flush()
    counts = ", ".join(
        f"{kinds.count(kind)} {kind}"
        for kind in ("found", "up to symmetry", "as P allows", "MISSED")
    )
    sys.stdout.write(
        f"{len(kinds)} objects: {counts}; processor time {np.median(seconds):.1f} s (median), "
        f"{max(seconds):.1f} s (most)\n"
    )


if __name__ == "__main__":
    start(main, Options, __doc__)
