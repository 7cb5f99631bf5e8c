"""Training objects from packs of meshes, mixed with procedural ones.

Conventions
-----------
* Object ``index`` of a seed is a mesh or procedural by (seed, index) alone. Seeds from
  ``HELD_OUT_SEED_OFFSET`` on draw from the pack's validation split, all others from ``train``.
* A mesh is stretched, warped, turned about the up axis and lit anew each time; one without colours
  is painted in up to three plain ones. Few captions mention colours, so most get colour words.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscomplete.splats import Splats
from gscomplete.util.arrays import Float32Array
from recipes.train_embedded_prior.data.color_words import color_words, with_color_words
from recipes.train_embedded_prior.data.dataset import HELD_OUT_SEED_OFFSET, TrainingObject
from recipes.train_embedded_prior.data.mesh_pack import (
    PackEntry,
    PackMesh,
    read_manifest,
    read_mesh,
)
from recipes.train_embedded_prior.data.source import procedural_source
from recipes.train_embedded_prior.data.user_parts import user_part
from recipes.train_embedded_prior.procedural.materials import bake, sample_light
from recipes.train_embedded_prior.procedural.objects import into_unit_box
from recipes.train_embedded_prior.procedural.quads import turn_about
from recipes.train_embedded_prior.procedural.sampling import SurfaceSamples
from recipes.train_embedded_prior.procedural.warps import draw_warp, warped
from splatcomplete_data.mesh.discs import discs_at, sample_triangles
from splatcomplete_data.mesh.discs import triangle_areas_and_normals as areas_and_normals

_SOURCE_WEIGHTS = {
    "quaternius": 0.6,
    "quaternius-repo": 0.6,
    "kenney-repo": 0.5,
    "kaykit": 0.5,
    "m3-basemesh": 1.0,
    "pmndrs-market": 1.2,
    "osrf-gazebo": 2.0,
    "urdf-models": 4.0,
    "polyhaven": 4.0,
    "drake-models": 3.0,
}
"""How often an object of a source is drawn: stylised low-poly ones less often than scans."""
_OTHER_WEIGHT = 1.8
"""Of sources not named above: furniture and household objects."""
_SPLATS = (6000, 11000)
_WARPED_SHARE = 0.4
_STRETCHED_SHARE = 0.5
_LARGEST_LOG_STRETCH = 0.35
_OTHER_COLORS_SHARE = 0.4
"""Share whose red, green and blue change places."""
_COLORS_TOLD = 0.75
"""Share of captions that are told the object's colours."""
_TURNED_SHARE = 0.6
"""Share turned by any angle; the others by quarter turns, as models stand in files."""


@dataclass(frozen=True, slots=True)
class MixedSource:
    """Meshes of a pack and procedural objects; picklable."""

    folder: Path
    mesh_share: float = 0.7
    """Share of training sets made from meshes."""
    mesh_count: int | None = None
    """Only so many meshes of the train split, a smaller count some of a larger's; None = all."""

    def __call__(self, seed: int, index: int) -> TrainingObject:
        """Make object ``index`` of a seed."""
        rng = np.random.default_rng((seed, index, 20))
        split = "validation" if seed >= HELD_OUT_SEED_OFFSET else "train"
        count = self.mesh_count if split == "train" else None
        if rng.random() >= self.mesh_share or count == 0:
            return procedural_source(seed, index)
        entries, shares = _entries(self.folder, split, count)
        entry = entries[int(np.searchsorted(shares, rng.random(), side="right"))]
        splats, colors = mesh_splats(read_mesh(self.folder, entry), entry, rng)
        words = color_words(colors) if rng.random() < _COLORS_TOLD else ()

        def partial(*, disturb: bool, slight: bool) -> Splats:
            return user_part(splats, seed, index, disturb=disturb, slight=slight)

        return TrainingObject(splats, with_color_words(entry.caption, words), partial)

    def captions(self) -> list[str]:
        """Return the captions of the meshes to train on."""
        return [entry.caption for entry in _entries(self.folder, "train")[0]]


@functools.lru_cache(maxsize=4)
def _entries(
    folder: Path, split: str, count: int | None = None
) -> tuple[list[PackEntry], Float32Array]:  # entries, cumulative shares [N]
    """Return entries of a split and the ends of their shares of a draw from [0, 1)."""
    entries = [entry for entry in read_manifest(folder) if entry.split == split]
    if count is not None:
        order = np.random.default_rng(0).permutation(len(entries))
        entries = [entries[k] for k in sorted(order[:count])]
    weights = [_SOURCE_WEIGHTS.get(entry.source, _OTHER_WEIGHT) for entry in entries]
    ends = np.cumsum(weights) / np.sum(weights)
    ends[-1] = 1.0
    return entries, ends


def mesh_splats(
    mesh: PackMesh, entry: PackEntry, rng: np.random.Generator
) -> tuple[Splats, Float32Array]:  # [N, 3]
    """Cover a mesh with discs, augmented; object frame. Returns their colours unlit, too."""
    count = int(rng.integers(_SPLATS[0], _SPLATS[1] + 1))
    triangles = mesh.vertices[mesh.faces]
    face, weights = sample_triangles(triangles, count, int(rng.integers(1 << 31)))
    areas, normals = areas_and_normals(triangles)
    spacing = float(np.sqrt(areas.sum(dtype=np.float64) / count))
    samples = SurfaceSamples(
        np.einsum("nk,nkc->nc", weights, triangles[face]).astype(np.float32),
        normals[face],
        np.zeros((count, 2), np.float32),
        np.full(count, spacing, np.float32),
        np.zeros(count, np.int64),
    )
    colors = mesh.colors_at(face, weights)
    if entry.colour == "none":
        colors = _painted(samples, rng)
    if rng.random() < _OTHER_COLORS_SHARE:
        colors = colors[:, rng.permutation(3)]
    unlit = colors
    colors = bake(sample_light(rng), samples, colors)
    samples = _reshaped(samples, rng)
    turn = _turn(rng)
    points, scale = into_unit_box(samples.points @ turn.T)
    opacity = float(rng.uniform(0.95, 0.99))
    discs = discs_at(
        points, samples.normals @ turn.T, colors.clip(0, 1), samples.spacing * scale, opacity
    )
    return discs, unlit


def _painted(samples: SurfaceSamples, rng: np.random.Generator) -> Float32Array:  # [N, 3]
    """Paint level bands of up to three plain colours."""
    palette = rng.random((3, 3)).astype(np.float32)
    height = samples.points[:, 2]
    low, high = float(height.min()), float(height.max())
    edges = np.sort(rng.uniform(low, high, int(rng.integers(0, 3))))
    return palette[np.searchsorted(edges, height)]


def _reshaped(samples: SurfaceSamples, rng: np.random.Generator) -> SurfaceSamples:
    """Warp or stretch the samples, or leave them."""
    kind = rng.random()
    if kind < _WARPED_SHARE:
        return warped(samples, draw_warp(rng))
    if kind < _WARPED_SHARE + (1 - _WARPED_SHARE) * _STRETCHED_SHARE:
        stretch = np.exp(rng.uniform(-1, 1, 3) * _LARGEST_LOG_STRETCH).astype(np.float32)
        normals = samples.normals / stretch
        length = np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-6)
        growth = np.sqrt(length[:, 0] * stretch.prod())
        return SurfaceSamples(
            samples.points * stretch,
            (normals / length).astype(np.float32),
            samples.uv,
            (samples.spacing * growth).astype(np.float32),
            samples.part,
        )
    return samples


def _turn(rng: np.random.Generator) -> Float32Array:  # [3, 3]
    """Draw a turn about the up axis, rarely with a lean of a few degrees."""
    turned = rng.random() < _TURNED_SHARE
    yaw_deg = float(rng.uniform(0, 360)) if turned else 90.0 * float(rng.integers(4))
    turn = turn_about("z", yaw_deg)
    if rng.random() < 0.1:
        lean = turn_about("z", float(rng.uniform(0, 360))) @ turn_about("x", rng.uniform(0, 12))
        return (lean @ turn).astype(np.float32)
    return turn.astype(np.float32)
