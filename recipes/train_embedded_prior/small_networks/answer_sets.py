"""Training data of the answer scorer: parts, the network's answers about them, their true scores.

Conventions
-----------
* Two parts of each object are cut as in ``real_objects.unseen``. They depend only on the seed and
  the object's id.
* An answer's true score compares the shadows of its cells and of the complete object's, P's cells
  added to both: it is the mean of their intersections over unions along the axes and along two
  level diagonals.
* Parts are kept in files of ``FILE_OBJECTS`` objects, which are made once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gscomplete.priors.embedded.ending import Ending, ending_of
from gscomplete.priors.embedded.weights import SHAPE_FILE, packaged_weights
from gscomplete.shape.outline.one_view import is_scan
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.planes.answer_scorer import (
    FEATURES,
    Answers,
    answer_features,
)
from gscomplete.shape.planes.coarse_scorer import COARSE_SCORER_FILE
from gscomplete.shape.planes.fine_scorer import FINE_SCORER_FILE
from gscomplete.shape.symmetry_choice import CANDIDATES, ask_about_planes
from gscomplete.shape.voxels import shadows, splat_arrays
from gscomplete.util.arrays import Float32Array
from gscomplete.util.digests import sha256_of
from recipes.real_objects.compare import FramedObject
from recipes.real_objects.unseen import PartKind
from recipes.train_embedded_prior.data.solids import solid_cells
from recipes.train_embedded_prior.small_networks.array_sets import joined
from recipes.train_embedded_prior.small_networks.object_tasks import (
    ObjectTask,
    packaged_prior,
    sets_of_objects,
)
from recipes.train_embedded_prior.small_networks.perceptron_training import PerceptronConfig

FILE_OBJECTS = 50
ANSWERS = CANDIDATES + 1
_KINDS: tuple[PartKind, ...] = (
    "scan", "half", "arc", "box", "scan", "half", "middle", "scan",
)  # fmt: skip
"""A kind is drawn as often as it stands here."""
_WEIGHTS: dict[PartKind, float] = {"arc": 2.0}
"""Weights of parts in training; other kinds have weight 1. With equal weights, answers to arcs get
worse by as much as those to scans get better."""
LEVEL, _LEVEL_ONE_VIEW = -0.25, -1.0
"""Cells with at least this logit count as filled. The second is for parts that one view shows,
whose surfaces lie at that level, too."""


@dataclass(frozen=True, slots=True)
class AnswerSets:
    """N parts with up to ``ANSWERS`` answers each."""

    features: Float32Array  # [N, ANSWERS, F] 0 where there is no answer
    true_scores: Float32Array  # [N, ANSWERS] NaN where there is no answer
    weights: Float32Array  # [N]

    def __len__(self) -> int:
        return len(self.true_scores)


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
    """A part and the network's answers about it."""

    ending: Ending
    answers: Answers
    solid: Tensor  # bool [C, C, C] the complete object's cells


def asked_part(framed: FramedObject | None) -> AskedPart | None:
    """Ask the network about a part as a run does; None = a run would not ask it.

    Long parts are not shortened, unlike in a run (``embedded.elongated``).
    """
    if framed is None:
        return None
    assert framed.truth is not None
    prior = packaged_prior()
    ending = ending_of(framed.partial, "guess")
    if ending.is_complete or ending.mirror != "guess":
        return None
    context = prior.context(prior.condition(framed.item.prompt), ends_in_plane=ending.in_plane)
    assert context is not None
    answers = ask_about_planes(
        context.model,
        voxelize_partial(framed.partial, framed.views),
        context.tokens,
        ends_in_plane=ending.in_plane,
        bfloat16=context.bfloat16,
    ).answers
    positions, tangents, *_ = splat_arrays(framed.truth)
    return AskedPart(ending, answers, torch.from_numpy(solid_cells(positions, tangents) > 0))


def answer_sets_of(task: ObjectTask) -> AnswerSets:
    """Return the sets of two parts of one object."""
    turned = task.turned(task.seed)
    first, second = (_KINDS[k] for k in turned.rng.permutation(len(_KINDS))[:2])
    if first == second:
        second = "arc" if first == "half" else "half"
    rows = [_no_sets()]
    for kind in (first, second):
        asked = asked_part(turned.framed(turned.part(kind), kind))
        if asked is None:
            continue
        answers = asked.answers
        one_view = is_scan(answers.shown_at_once, asked.ending.in_plane)
        true = shadow_ious(answers, asked.solid, _LEVEL_ONE_VIEW if one_view else LEVEL)
        weight = _WEIGHTS.get(kind, 1.0)
        rows.append(_padded(answer_features(answers), true.numpy(), weight))
    return joined(rows)


def _no_sets() -> AnswerSets:
    """Return empty sets, for objects about which a run would not ask the network."""
    shapes = ((0, ANSWERS, len(FEATURES)), (0, ANSWERS), (0,))
    return AnswerSets(*(np.empty(shape, np.float32) for shape in shapes))


def _padded(features: Float32Array, true_scores: Float32Array, weight: float) -> AnswerSets:
    """Return the sets of one part, filled up to ``ANSWERS`` answers."""
    missing = ANSWERS - len(true_scores)
    return AnswerSets(
        np.pad(features, ((0, missing), (0, 0)))[None],
        np.pad(true_scores, (0, missing), constant_values=np.nan)[None],
        np.array([weight], np.float32),
    )


def asked_with() -> str:
    """Return the digests of the weights that answers depend on."""
    files = (SHAPE_FILE, COARSE_SCORER_FILE, FINE_SCORER_FILE)
    return " ".join(sha256_of(packaged_weights() / file) for file in files)


def answer_sets(config: PerceptronConfig) -> list[AnswerSets]:
    """Return the sets of every file; make the files that are missing."""
    contents = f"{asked_with()} {' '.join(FEATURES)}"
    make = answer_sets_of
    return sets_of_objects(config, AnswerSets, "answers", contents, make, FILE_OBJECTS)
