"""What the answer scorer learns from: parts, what the network answers about them, how true that is.

Conventions
-----------
* Parts are cut as in ``real_objects.unseen``, two of each object of the pack's train split, which
  is turned about the up axis: a pure function of (seed, the object's id).
* An answer's true score is the intersection over union of shadows of cells, its own and those of
  the complete object, both with P's: along the axes and two level diagonals, on average.
* Parts are kept in files of ``FILE_OBJECTS`` objects, made once.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.priors.embedded.ending import Ending, ending_of
from gscomplete.priors.embedded.prior import EmbeddedPrior
from gscomplete.priors.embedded.weights import SHAPE_FILE, packaged_weights
from gscomplete.shape.outline.one_view import ONE_VIEW_SHARE
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.planes.answer_scorer import (
    FEATURES,
    Answers,
    answer_features,
)
from gscomplete.shape.planes.coarse_scorer import COARSE_SCORER_FILE
from gscomplete.shape.planes.fine_scorer import FINE_SCORER_FILE
from gscomplete.shape.symmetry_choice import CANDIDATES, ask_about_planes
from gscomplete.shape.voxels import FloatArray, shadows, splat_arrays
from gscomplete.util.digests import sha256_of
from recipes.real_objects.compare import frame_object
from recipes.real_objects.load import RealObject
from recipes.real_objects.unseen import PartKind, complete_object, part_of
from recipes.train_embedded_prior.data.mesh_pack import PackEntry, read_manifest, read_mesh
from recipes.train_embedded_prior.data.solids import solid_cells
from recipes.train_embedded_prior.small_networks.array_sets import joined, made_of_tasks, stem_of

FILE_OBJECTS = 50
ANSWERS = CANDIDATES + 1
_KINDS: tuple[PartKind, ...] = (
    "scan", "half", "arc", "box", "scan", "half", "middle", "scan",
)  # fmt: skip
"""As often as they are drawn."""
_WEIGHTS: dict[PartKind, float] = {"arc": 2.0}
"""Of parts in training; of kinds that are not here 1. Without it arcs lose what scans gain."""
LEVEL, _LEVEL_ONE_VIEW = -0.25, -1.0
"""Logits from which on cells count as filled; the second of parts that one view shows, whose
surfaces are made from there on, too."""


@dataclass(frozen=True, slots=True)
class AnswerSets:
    """N parts with up to ``ANSWERS`` answers each."""

    features: FloatArray  # [N, ANSWERS, F] 0 where nothing was asked
    true_scores: FloatArray  # [N, ANSWERS] NaN where nothing was asked
    weights: FloatArray  # [N]

    def __len__(self) -> int:
        return len(self.true_scores)


@dataclass(frozen=True, slots=True)
class AnswerTask:
    """One object to make sets of."""

    meshes: Path
    entry: PackEntry
    seed: int


def train_entries(meshes: Path, seed: int, count: int) -> list[PackEntry]:
    """Return the first objects of the shuffled train split."""
    entries = [entry for entry in read_manifest(meshes) if entry.split == "train"]
    order = np.random.default_rng(seed).permutation(len(entries))
    return [entries[k] for k in order[:count]]


def answer_tasks(meshes: Path, seed: int, count: int) -> list[AnswerTask]:
    """Return the tasks of the first objects of the shuffled train split."""
    return [AnswerTask(meshes, entry, seed) for entry in train_entries(meshes, seed, count)]


def shadow_ious(
    answers: Answers,
    complete: Tensor,  # bool [C, C, C]
    level: float,  # logit
) -> Tensor:  # [K] or [K + 1]
    """Return the true scores of answers."""
    own = answers.partial > 0
    filled = (answers.filled > 1 / (1 + np.exp(-level))) | own
    scores = []
    for found, true in zip(shadows(filled), shadows((complete | own)[None]), strict=True):
        both = (found & true).flatten(1).sum(dim=1)
        scores.append(both / (found | true).flatten(1).sum(dim=1).clamp_min(1))
    return torch.stack(scores).mean(dim=0)


@dataclass(frozen=True, slots=True)
class AskedPart:
    """A part that the network was asked about."""

    ending: Ending
    answers: Answers
    solid: Tensor  # bool [C, C, C] the complete object's cells


def asked_part(item: RealObject) -> AskedPart | None:
    """Ask the network about a part as a run does; None = a run asks nothing."""
    prior = packaged_prior()
    try:
        framed = frame_object(item, prior)
    except UserError:  # a part of next to nothing
        return None
    assert framed.truth is not None
    ending = ending_of(framed.partial, "guess")
    if ending.is_complete or ending.mirror != "guess":
        return None
    asked = prior.asked(prior.condition(item.prompt), ends_in_plane=ending.in_plane)
    assert asked is not None
    answers = ask_about_planes(
        asked.model,
        voxelize_partial(framed.partial, framed.views),
        asked.tokens,
        ends_in_plane=ending.in_plane,
        bfloat16=asked.bfloat16,
    ).answers
    positions, tangents, *_ = splat_arrays(framed.truth)
    return AskedPart(ending, answers, torch.from_numpy(solid_cells(positions, tangents) > 0))


def answer_sets_of(task: AnswerTask) -> AnswerSets:
    """Ask about two parts of one object."""
    number = int.from_bytes(task.entry.id.encode()[-6:], "little")
    rng = np.random.default_rng((number, task.seed))
    turn_deg = float(rng.uniform(0, 360))
    first, second = (_KINDS[k] for k in rng.permutation(len(_KINDS))[:2])
    if first == second:
        second = "arc" if first == "half" else "half"
    complete = complete_object(read_mesh(task.meshes, task.entry), task.entry, turn_deg)
    rows = [_no_sets()]
    for kind in (first, second):
        part = part_of(complete, kind, rng, turn_deg)
        item = RealObject(task.entry.id, task.entry.caption, "Z", part, complete, kind)
        asked = asked_part(item)
        if asked is None:
            continue
        answers = asked.answers
        one_view = not asked.ending.in_plane and answers.shown_at_once >= ONE_VIEW_SHARE
        true = shadow_ious(answers, asked.solid, _LEVEL_ONE_VIEW if one_view else LEVEL)
        weight = _WEIGHTS.get(kind, 1.0)
        rows.append(_padded(answer_features(answers), true.numpy(), weight))
    return joined(rows)


def _no_sets() -> AnswerSets:
    """Return sets of no part: of some objects a run asks nothing."""
    shapes = ((0, ANSWERS, len(FEATURES)), (0, ANSWERS), (0,))
    return AnswerSets(*(np.empty(shape, np.float32) for shape in shapes))


def _padded(features: FloatArray, true_scores: FloatArray, weight: float) -> AnswerSets:
    """Fill up to ``ANSWERS``."""
    missing = ANSWERS - len(true_scores)
    return AnswerSets(
        np.pad(features, ((0, missing), (0, 0)))[None],
        np.pad(true_scores, (0, missing), constant_values=np.nan)[None],
        np.array([weight], np.float32),
    )


@functools.cache
def packaged_prior() -> EmbeddedPrior:
    """Return the prior that ships, on one thread of this process."""
    torch.set_num_threads(1)
    return EmbeddedPrior.from_folder(packaged_weights())


def asked_with() -> str:
    """Name the weights that answers depend on."""
    files = (SHAPE_FILE, COARSE_SCORER_FILE, FINE_SCORER_FILE)
    return " ".join(sha256_of(packaged_weights() / file) for file in files)


def answer_sets(
    folder: Path, meshes: Path, seed: int, objects: int, workers: int
) -> list[AnswerSets]:
    """Return sets, one entry a file of ``FILE_OBJECTS`` objects; make those not yet made.

    Args:
        folder: for the files.
        meshes: pack of meshes.
        seed: of the list and the parts.
        objects: how many of the train split.
        workers: processes that make them.
    """
    tasks = answer_tasks(meshes, seed, objects)
    contents = f"{seed} {asked_with()} {' '.join(FEATURES)}"
    stem = stem_of(folder, "answers", contents)
    return made_of_tasks(AnswerSets, stem, answer_sets_of, tasks, FILE_OBJECTS, workers)
