"""Training data of the surface depth: points of predicted surfaces and their true depths.

Conventions
-----------
* Two parts of each object are cut as in ``real_objects.unseen``. They depend only on its id. Each
  is guessed as in a run, up to the points of its new surface. Parts to which a run adds nothing are
  left out. Long parts are not shortened here, as a run does (``embedded.elongated``).
* The true depth of a point is that of the first true surface on the way in, in cells. It is NaN
  where no true surface is near.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from gscomplete.priors.embedded.ending import ending_of
from gscomplete.shape.assemble import (
    AssembleSettings,
    mirrored_copies,
    surface_settings,
    where_solid,
)
from gscomplete.shape.benefit import is_better_left
from gscomplete.shape.guess import ask_about
from gscomplete.shape.placements import placements
from gscomplete.shape.surface.cover import new_surface
from gscomplete.shape.surface.depth import FEATURES, depth_features
from gscomplete.shape.voxels import CELL_SIDE
from gscomplete.util.arrays import Float32Array, Float64Array
from recipes.real_objects.compare import FramedObject
from recipes.real_objects.unseen import PartKind
from recipes.train_embedded_prior.small_networks.answer_sets import asked_with
from recipes.train_embedded_prior.small_networks.array_sets import joined
from recipes.train_embedded_prior.small_networks.object_tasks import (
    ObjectTask,
    packaged_prior,
    sets_of_objects,
)
from recipes.train_embedded_prior.small_networks.perceptron_training import PerceptronConfig

FILE_OBJECTS = 48
_KINDS: tuple[PartKind, ...] = (
    "scan", "half", "arc", "box", "scan", "arc", "middle", "scan",
)  # fmt: skip
"""A kind is drawn as often as it stands here."""
_DRAWS = 77
"""Seed of turns and parts, beside the object's id."""
_POINTS = 1500
"""Most points per part."""
_DEPTHS = np.arange(-2.0, 4.01, 0.25)
"""Depths at which the true surface is looked for, cells."""
_NEAR, _PASSED = 0.35, 0.1
"""A true surface is found where the way in comes within the first distance of it, cells, and then
recedes from it by the second, ..."""
_NEAR_ENOUGH = 0.5
"""... or else where the whole way in comes nearest to one, within this distance, cells."""
_FARTHEST = 2.5
"""The true surface is not looked for beyond this distance from a place on the way, cells."""


@dataclass(frozen=True, slots=True)
class DepthSets:
    """N points of predicted surfaces."""

    features: Float32Array  # [N, F]
    depths: Float32Array  # [N] true ones, cells
    insets: Float32Array  # [N] depths that are taken without a network, cells

    def __len__(self) -> int:
        return len(self.depths)


def first_depths(
    distance: Callable[[Float64Array], Float64Array],
    points: Float32Array,  # [N, 3]
    normals: Float32Array,  # [N, 3] outward
) -> Float32Array:  # [N]
    """Return how deep the first surface lies inside points, cells; NaN where none is near.

    Args:
        distance: returns the distances of places [M, 3] from the true surface, cells.
        points: points from which the true surface is looked for.
        normals: their outward normals; the true surface is looked for in the opposite direction.
    """
    count = len(points)
    found, nearest = np.full(count, np.nan, np.float32), np.full(count, np.inf)
    is_past = np.zeros(count, np.bool_)
    for depth in _DEPTHS:
        away = distance(points - depth * CELL_SIDE * normals)
        nearer = ~is_past & (away < nearest)
        found[nearer], nearest[nearer] = depth, away[nearer]
        is_past |= (away > nearest + _PASSED) & (nearest < _NEAR)
    found[nearest >= _NEAR_ENOUGH] = np.nan
    return found


def depth_sets_of(task: ObjectTask) -> DepthSets:
    """Return the sets of two parts of one object."""
    turned = task.turned(_DRAWS)
    rows = [DepthSets(np.empty((0, len(FEATURES)), np.float32), *np.empty((2, 0), np.float32))]
    for kind in (_KINDS[k] for k in turned.rng.permutation(len(_KINDS))[:2]):
        framed = turned.framed(turned.part(kind), kind)
        if framed is not None:
            rows += _sets_of_part(framed, task.entry.number)
    return joined(rows)


def _sets_of_part(framed: FramedObject, seed: int) -> list[DepthSets]:  # one or none
    """Guess one part as a run does, up to its new surface; return the sets of that surface."""
    prior, partial = packaged_prior(), framed.partial
    ending = ending_of(partial, "guess")
    if ending.is_complete:
        return []
    context = prior.context(prior.condition(framed.item.prompt), ends_in_plane=ending.in_plane)
    assert context is not None
    assert framed.truth is not None
    prediction = ask_about(context, partial, framed.views, ending.mirror)
    if is_better_left(ending.features, prediction.added):
        return []
    generator = torch.Generator().manual_seed(seed)
    solid = where_solid(prediction, partial)
    copies, _ = mirrored_copies(prediction, partial, generator, solid=solid)
    if copies is not None and ending.image_is_all:
        return []
    settings = surface_settings(prediction, AssembleSettings(), copies)
    there = partial.means if copies is None else torch.cat([partial.means, copies.means])
    surface = new_surface(prediction.output, there, settings, generator, solid=solid)
    chosen = torch.randperm(len(surface.points), generator=generator)[:_POINTS]
    if not len(chosen):
        return []
    points, normals = surface.points[chosen], surface.normals[chosen]
    features = depth_features(
        prediction.output, prediction.inputs, settings.filled_logit, points, normals
    )
    truth = cKDTree(framed.truth.means.numpy())

    def distance(places: Float64Array) -> Float64Array:
        found, _ = truth.query(places, distance_upper_bound=_FARTHEST * CELL_SIDE)
        return np.asarray(found / CELL_SIDE)

    depths = first_depths(distance, points.numpy(), normals.numpy())
    insets = (surface.insets[chosen] / CELL_SIDE).numpy()
    return [DepthSets(features, depths, insets)]


def depth_sets(config: PerceptronConfig) -> list[DepthSets]:
    """Return the sets of every file; make the files that are missing."""
    return sets_of_objects(config, DepthSets, "depths", made_with(), depth_sets_of, FILE_OBJECTS)


def made_with() -> str:
    """Return what sets depend on beside their objects: kept ones of another kind are not used."""
    placed = [(frame.scale, frame.translation.tolist()) for frame in placements()]
    return f"{asked_with()} {placed} {AssembleSettings()} {' '.join(FEATURES)}"
