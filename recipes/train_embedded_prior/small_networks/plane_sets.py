"""Training data of the symmetry scorers: parts, planes, and the true scores of planes.

Conventions
-----------
* Object k is object k of the shape network's sets, for another seed. It depends only on (seed, k).
* Objects are kept in files of ``FILE_OBJECTS``, which are made once, whatever is trained on them.
  The first file has objects of the held-out seed. With a pack of meshes, those from the pack are of
  its validation split.
* An object's planes are those that the coarse scorer puts first, followed by those with the highest
  true scores.
"""

from __future__ import annotations

import dataclasses
import hashlib
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.priors.embedded.text import Tokenizer
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.planes.coarse_scorer import packaged_coarse_scorer
from gscomplete.shape.planes.features import plane_features
from gscomplete.shape.planes.proposals import FINELY_SCORED, distinct_planes
from gscomplete.util.arrays import Float32Array
from recipes.train_embedded_prior.config import ShapeDataConfig
from recipes.train_embedded_prior.data.copies import Truth
from recipes.train_embedded_prior.data.dataset import HELD_OUT_SEED_OFFSET, Source
from recipes.train_embedded_prior.data.mesh_source import MixedSource
from recipes.train_embedded_prior.data.shape_dataset import PosedObject, ShapeSetMaker, pack_cells
from recipes.train_embedded_prior.data.source import procedural_source
from recipes.train_embedded_prior.small_networks.array_sets import joined, made_once

FILE_OBJECTS = 200
BEST_PLANES = 4
"""So many planes with the highest true scores are added, so that there always is one to prefer."""
_MOST_CELLS = 5000


@dataclass(frozen=True, slots=True)
class PlaneSets:
    """N objects with K planes each."""

    cells: NDArray[np.uint8]  # [N, n, 7] place, colour, occupancy; occupancy 0 = unused
    evidence: NDArray[np.uint8]  # [N, 3, C/2, C/2, C/2] shares in 255ths
    planes: NDArray[np.int16]  # [N, K, 2] angle, offset
    features: Float32Array  # [N, K, F]
    logits: Float32Array  # [N, K] of the coarse scorer
    true_scores: Float32Array  # [N, K]

    def __len__(self) -> int:
        return len(self.true_scores)

    def first(self, count: int) -> PlaneSets:
        """Return the sets of the first objects."""
        names = [field.name for field in dataclasses.fields(self)]
        return PlaneSets(*(getattr(self, name)[:count] for name in names))


def planes_of(posed: PosedObject, rng: np.random.Generator) -> PlaneSets:
    """Measure the planes of one object."""
    look = voxelize_partial(posed.partial, posed.distribution)
    features = plane_features(look.samples(), look.evidence)
    true_scores = Truth.of(posed.partial, posed.complete).plane_scores()
    logits = packaged_coarse_scorer()(features)
    likely = distinct_planes(logits, FINELY_SCORED)
    planes = np.concatenate([likely, distinct_planes(true_scores, BEST_PLANES)])
    a, o = planes.T
    return PlaneSets(
        pack_cells(look.volume, _MOST_CELLS, rng)[None],
        np.round(look.shares * 255).astype(np.uint8)[None],
        planes.astype(np.int16)[None],
        features[a, o][None],
        logits[a, o][None],
        true_scores[a, o][None],
    )


def plane_sets(
    folder: Path, seed: int, objects: int, workers: int, meshes: Path | None
) -> PlaneSets:
    """Return the first objects of a seed; make the files that are missing.

    Args:
        folder: folder of the files.
        seed: seed of the objects; below ``HELD_OUT_SEED_OFFSET``.
        objects: how many, rounded up to whole files; the held-out ones of the first file count.
        workers: processes that make them.
        meshes: pack of meshes to take objects from beside procedural ones; None = none.
    """
    folder.mkdir(parents=True, exist_ok=True)
    starts = range(0, objects, FILE_OBJECTS)
    name = f"{seed} {packaged_coarse_scorer().digest()} {meshes is not None}"
    key = hashlib.sha256(name.encode()).hexdigest()[:8]
    paths = {start: folder / f"planes-{key}-{start:06d}.npz" for start in starts}

    def make(pool: Executor, start: int) -> PlaneSets:
        of_seed = seed + HELD_OUT_SEED_OFFSET if start == 0 else seed
        tasks = [(of_seed, index, meshes) for index in range(start, start + FILE_OBJECTS)]
        return joined(list(pool.map(_made, tasks, chunksize=4)))

    description = f"objects, {FILE_OBJECTS} at a time"
    return joined(made_once(PlaneSets, paths, make, workers, description))


Task = tuple[int, int, Path | None]
"""Seed, index of the object, and pack of meshes."""


def posed_object(task: Task) -> tuple[PosedObject, np.random.Generator]:
    """Return an object with a part of it, and the generator of further random numbers."""
    seed, index, meshes = task
    rng = np.random.default_rng((seed, index, 2))
    # Where little is missing, mirror images show little; planes are learned where they matter.
    data = ShapeDataConfig(slight_share=0.0)
    source: Source = procedural_source if meshes is None else MixedSource(meshes, data.mesh_share)
    return ShapeSetMaker(source, data, Tokenizer((), 1), seed).posed(index, rng), rng


def _made(task: Task) -> PlaneSets:
    torch.set_num_threads(1)
    return planes_of(*posed_object(task))
