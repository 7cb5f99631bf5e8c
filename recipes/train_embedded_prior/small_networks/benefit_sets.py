"""What the benefit scorer learns from: complete objects and parts, and what completing them gains.

Conventions
-----------
* Of every object all of it and one part are asked about: a pure function of (seed, the object's
  id). What passes for closed or is mirrored through a square cut is left out, as a run leaves it
  out.
* The gain is in intersection over union of shadows of cells (``answer_sets``): that of the answer
  which the answer scorer puts first, less P's own.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch

from gscomplete.shape.benefit import FEATURES, features_of_answers
from gscomplete.shape.planes.answer_scorer import Answers, answer_features, packaged_answer_scorer
from gscomplete.shape.voxels import FloatArray
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
"""As often as they are drawn."""


@dataclass(frozen=True, slots=True)
class BenefitSets:
    """N parts and complete objects."""

    features: FloatArray  # [N, F]
    gains: FloatArray  # [N]
    complete: FloatArray  # [N] 1 where nothing was taken away

    def __len__(self) -> int:
        return len(self.gains)


def benefit_of(asked: AskedPart) -> tuple[FloatArray, float]:  # [F]
    """Return what the scorer reads of a part, and what completing it gains."""
    answers = asked.answers
    chosen = int(packaged_answer_scorer()(answer_features(answers)).argmax())
    assert asked.ending.features is not None
    features = np.concatenate([asked.ending.features, features_of_answers(answers, chosen)])
    nothing = dataclasses.replace(answers, filled=torch.zeros_like(answers.filled[:1]))
    return features, _score(answers, asked, chosen) - _score(nothing, asked, 0)


def _score(answers: Answers, asked: AskedPart, index: int) -> float:
    return float(shadow_ious(answers, asked.solid, LEVEL)[index])


def benefit_sets_of(task: ObjectTask) -> BenefitSets:
    """Ask about one object and a part of it."""
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
    """Return sets, one entry a file; make those not yet made."""
    contents = f"{asked_with()} {packaged_answer_scorer().digest()} {' '.join(FEATURES)}"
    make = benefit_sets_of
    return sets_of_objects(config, BenefitSets, "benefits", contents, make, FILE_OBJECTS)
