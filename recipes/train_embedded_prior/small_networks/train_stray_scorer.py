"""Train the stray scorer.

``python -m recipes.train_embedded_prior.small_networks.train_stray_scorer``

It reads P alone: no network is asked. Parts are made once and kept in the run's folder, so that the
same command goes on; learning takes a minute.

Conventions
-----------
* Two parts of each object are cut as in ``real_objects.unseen`` and get strays. They depend only on
  the object's id.
* Every sixth file of objects is held out.
"""

from __future__ import annotations

import functools
import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gscomplete.networks.perceptron import Perceptron
from gscomplete.priors.embedded.weights import packaged_weights
from gscomplete.shape.voxels import FloatArray
from gscomplete.splats.strays import FEATURES, STRAY_FROM, STRAY_SCORER_FILE, standing_out
from recipes.entry_point import start
from recipes.real_objects.unseen import PartKind
from recipes.train_embedded_prior.data.stray_parts import stray_part
from recipes.train_embedded_prior.small_networks.array_sets import joined
from recipes.train_embedded_prior.small_networks.object_tasks import ObjectTask, sets_of_objects
from recipes.train_embedded_prior.small_networks.perceptron_training import (
    PerceptronConfig,
    fit_perceptron,
    train_on_files,
)

FILE_OBJECTS = 24
_KINDS: tuple[PartKind, ...] = ("scan", "scan", "arc", "half", "box", "complete")
"""A kind is drawn as often as it stands here."""
_DRAWS = 91
"""Seed of turns, parts and strays, beside the object's id."""
_MOST = 800
"""Most splats of a part of either class."""
_HELD_OUT_EVERY = 6
_SURFACE_WEIGHT = 3.0
"""Taking surface for a stray is so many times as bad as the opposite."""


@dataclass(frozen=True)
class StrayScorerConfig(PerceptronConfig):
    """Train the stray scorer."""

    run: Path = Path("runs/stray_scorer")
    out: Path = field(default_factory=lambda: packaged_weights() / STRAY_SCORER_FILE)
    objects: int = 2880
    seed: int = 38
    width: int = 64
    epochs: int = 20
    batch_rows: int = 2048
    weight_decay: float = 0.01
    dropout: float = 0.0


@dataclass(frozen=True, slots=True)
class StraySets:
    """N splats that stand out."""

    features: FloatArray  # [N, F]
    is_stray: FloatArray  # [N] 0 or 1
    stands_for: FloatArray  # [N] splats of its class and part that each stands for

    def __len__(self) -> int:
        return len(self.is_stray)


def stray_sets_of(task: ObjectTask) -> StraySets:
    """Return the sets of two parts of one object."""
    turned = task.turned(_DRAWS)
    rng = turned.rng
    rows = [StraySets(np.empty((0, len(FEATURES)), np.float32), *np.empty((2, 0), np.float32))]
    for kind in (_KINDS[k] for k in rng.permutation(len(_KINDS))[:2]):
        part = stray_part(turned.part(kind), turned.complete, rng)
        if part is None:
            continue
        found = standing_out(part.splats)
        for value, of_class in ((1, part.is_stray), (0, part.is_surface)):
            members = np.flatnonzero(of_class[found.rows])
            chosen = rng.permutation(members)[:_MOST]
            share = np.full(len(chosen), len(members) / max(len(chosen), 1), np.float32)
            labels = np.full(len(chosen), value, np.float32)
            rows.append(StraySets(found.features[chosen], labels, share))
    return joined(rows)


def fit(config: StrayScorerConfig, sets: StraySets) -> Perceptron:
    """Train the scorer."""
    labels, counts = torch.from_numpy(sets.is_stray), torch.from_numpy(sets.stands_for)
    weights = counts * torch.where(labels > 0, 1.0, _SURFACE_WEIGHT)
    weights /= weights.mean()

    def batch_loss(network: nn.Sequential, inputs: Tensor, generator: torch.Generator) -> Tensor:
        chosen = torch.randint(len(sets), (config.batch_rows,), generator=generator)
        scores = network(inputs[chosen])[:, 0]
        entropy = F.binary_cross_entropy_with_logits(scores, labels[chosen], reduction="none")
        return (weights[chosen] * entropy).mean()

    every = torch.ones(len(sets), dtype=torch.bool)
    return fit_perceptron(config, torch.from_numpy(sets.features), every, batch_loss)


def told(name: str, scorer: Perceptron, sets: StraySets) -> str:
    """Describe how many strays the scorer finds, and how much surface it takes for strays."""
    is_stray, counts = sets.is_stray > 0, sets.stands_for
    marked = scorer(sets.features) > STRAY_FROM
    found = counts[marked & is_stray].sum() / max(counts[is_stray].sum(), 1)
    wrong = counts[marked & ~is_stray].sum() / max(counts[~is_stray].sum(), 1)
    return (
        f"{name}, {len(sets):,} splats that stand out: {found:.1%} of the strays are found, "
        f"{wrong:.2%} of the surface passes for strays"
    )


def main(config: StrayScorerConfig) -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    contents = " ".join(FEATURES)
    files = sets_of_objects(config, StraySets, "strays", contents, stray_sets_of, FILE_OBJECTS)
    train_on_files(config, files, _HELD_OUT_EVERY, functools.partial(fit, config), told)
    return 0


if __name__ == "__main__":
    start(main, StrayScorerConfig, __doc__)
