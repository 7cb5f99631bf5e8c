"""Training data of the benefit scorer: complete objects, parts, and what completing each gains.

Conventions
-----------
* The network is asked about every object as a whole and about one part of it. The part depends only
  on the seed and the object's id. Left out is what a run does not ask about: what appears to be
  complete, and what is mirrored in the plane of its cut.
* The gain is a difference of true scores (``answer_sets``): the score of the answer that the answer
  scorer puts first, minus the score of P alone.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch

from gscomplete.shape.benefit import FEATURES, features_of_answers
from gscomplete.shape.planes.answer_scorer import Answers, answer_features, packaged_answer_scorer
from gscomplete.util.arrays import Float32Array
from recipes.real_objects.unseen import PartKind
from recipes.train_embedded_prior.small_networks.answer_sets import (
    LEVEL,
    AskedPart,
    asked_part,
    asked_with,
    shadow_ious,
)
from recipes.train_embedded_prior.small_networks.array_sets import joined
from recipes.train_embedded_prior.small_networks.object_tasks import ObjectTask, sets_of_objects
from recipes.train_embedded_prior.small_networks.perceptron_training import PerceptronConfig

FILE_OBJECTS = 48
_KINDS: tuple[PartKind, ...] = (
    "scan", "half", "arc", "box", "box", "half", "middle", "arc",
)  # fmt: skip
"""A kind is drawn as often as it stands here."""


@dataclass(frozen=True, slots=True)
class BenefitSets:
    """N parts and complete objects."""

    features: Float32Array  # [N, F]
    gains: Float32Array  # [N]
    complete: Float32Array  # [N] 1 for complete objects, 0 for parts

    def __len__(self) -> int:
        return len(self.gains)


def benefit_of(asked: AskedPart) -> tuple[Float32Array, float]:  # [F]
    """Return the scorer's input for a part, and what completing the part gains."""
    answers = asked.answers
    chosen = int(packaged_answer_scorer()(answer_features(answers)).argmax())
    assert asked.ending.features is not None
    features = np.concatenate([asked.ending.features, features_of_answers(answers, chosen)])
    nothing = dataclasses.replace(answers, filled=torch.zeros_like(answers.filled[:1]))
    return features, _score(answers, asked, chosen) - _score(nothing, asked, 0)


def _score(answers: Answers, asked: AskedPart, index: int) -> float:
    return float(shadow_ious(answers, asked.solid, LEVEL)[index])


def benefit_sets_of(task: ObjectTask) -> BenefitSets:
    """Return the sets of one object as a whole and of a part of it."""
    turned = task.turned(task.seed)
    kinds: tuple[PartKind, ...] = ("complete", _KINDS[int(turned.rng.integers(len(_KINDS)))])
    rows = [BenefitSets(np.empty((0, len(FEATURES)), np.float32), *np.empty((2, 0), np.float32))]
    for kind in kinds:
        asked = asked_part(turned.framed(turned.part(kind), kind))
        if asked is not None:
            features, gain = benefit_of(asked)
            found = np.array([[gain], [kind == "complete"]], np.float32)
            rows.append(BenefitSets(features[None], *found))
    return joined(rows)


def benefit_sets(config: PerceptronConfig) -> list[BenefitSets]:
    """Return the sets of every file; make the files that are missing."""
    contents = f"{asked_with()} {packaged_answer_scorer().digest()} {' '.join(FEATURES)}"
    make = benefit_sets_of
    return sets_of_objects(config, BenefitSets, "benefits", contents, make, FILE_OBJECTS)
