"""What the benefit scorer learns from: complete objects and parts, and what completing them gains.

Conventions
-----------
* Of every object of the pack's train split, turned about the up axis, all of it and one part are
  asked about: a pure function of (seed, the object's id). What passes for closed or is mirrored
  through a square cut is left out, as a run leaves it out.
* The gain is in intersection over union of shadows of cells (``answer_sets``): that of the answer
  which the answer scorer puts first, less P's own.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gscomplete.shape.benefit import FEATURES, features_of_answers
from gscomplete.shape.planes.answer_scorer import Answers, answer_features, packaged_answer_scorer
from gscomplete.shape.voxels import FloatArray
from recipes.real_objects.load import RealObject
from recipes.real_objects.unseen import PartKind, complete_object, part_of
from recipes.train_embedded_prior.data.mesh_pack import read_mesh
from recipes.train_embedded_prior.small_networks.answer_sets import (
    LEVEL,
    AnswerTask,
    AskedPart,
    answer_tasks,
    asked_part,
    asked_with,
    shadow_ious,
)
from recipes.train_embedded_prior.small_networks.array_sets import joined, made_of_tasks, stem_of

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


def benefit_sets_of(task: AnswerTask) -> BenefitSets:
    """Ask about one object and a part of it."""
    number = int.from_bytes(task.entry.id.encode()[-6:], "little")
    rng = np.random.default_rng((number, task.seed))
    turn_deg = float(rng.uniform(0, 360))
    kinds: tuple[PartKind, ...] = ("complete", _KINDS[int(rng.integers(len(_KINDS)))])
    complete = complete_object(read_mesh(task.meshes, task.entry), task.entry, turn_deg)
    rows = [BenefitSets(np.empty((0, len(FEATURES)), np.float32), *np.empty((2, 0), np.float32))]
    for kind in kinds:
        part = part_of(complete, kind, rng, turn_deg)
        item = RealObject(task.entry.id, task.entry.caption, "Z", part, complete, kind)
        asked = asked_part(item)
        if asked is not None:
            features, gain = benefit_of(asked)
            found = np.array([[gain], [kind == "complete"]], np.float32)
            rows.append(BenefitSets(features[None], *found))
    return joined(rows)


def benefit_sets(
    folder: Path, meshes: Path, seed: int, objects: int, workers: int
) -> list[BenefitSets]:
    """Return sets, one entry a file of ``FILE_OBJECTS`` objects; make those not yet made.

    Args:
        folder: for the files.
        meshes: pack of meshes.
        seed: of the list and the parts.
        objects: how many of the train split.
        workers: processes that make them.
    """
    tasks = answer_tasks(meshes, seed, objects)
    contents = f"{seed} {asked_with()} {packaged_answer_scorer().digest()} {' '.join(FEATURES)}"
    stem = stem_of(folder, "benefits", contents)
    return made_of_tasks(BenefitSets, stem, benefit_sets_of, tasks, FILE_OBJECTS, workers)
