"""Train the benefit scorer.

``python -m recipes.train_embedded_prior.small_networks.train_benefit_scorer``

It comes after the answer scorer, whose choice it judges. Parts are made once and kept in the run's
folder, so that the same command goes on; learning takes seconds.

Conventions
-----------
* A part is left as it is with probability 1 - sigmoid(score) in training: what is gained on average
  is made as large as it can be, beside the cross entropy of the better choice.
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
from gscomplete.shape.benefit import BENEFIT_SCORER_FILE, LEFT_BELOW
from recipes.entry_point import start
from recipes.train_embedded_prior.small_networks.benefit_sets import BenefitSets, benefit_sets
from recipes.train_embedded_prior.small_networks.perceptron_training import (
    PerceptronConfig,
    fit_perceptron,
    train_on_files,
)

_HELD_OUT_EVERY = 6
_MOST_LOST, _MOST_GAINED = 0.2, 0.1
"""Larger losses and gains are clamped to these."""
_SCALE = 40.0
"""Weight of gains in the loss."""
_ENTROPY_WEIGHT = 0.3
"""Weight of the cross entropy."""
_CLEAR = 0.05
"""From this gain or loss on, the cross entropy counts in full; below, in proportion."""
_WORSE = 0.005
"""A completion counts as worse than P if it loses more."""


@dataclass(frozen=True)
class BenefitScorerConfig(PerceptronConfig):
    """Train the benefit scorer."""

    run: Path = Path("runs/benefit_scorer")
    out: Path = field(default_factory=lambda: packaged_weights() / BENEFIT_SCORER_FILE)
    objects: int = 1440
    seed: int = 36
    width: int = 24
    epochs: int = 100
    batch_rows: int = 64
    weight_decay: float = 0.1


def fit(config: BenefitScorerConfig, sets: BenefitSets) -> Perceptron:
    """Train the scorer."""
    gains = torch.from_numpy(sets.gains)

    def batch_loss(network: nn.Sequential, inputs: Tensor, generator: torch.Generator) -> Tensor:
        chosen = torch.randint(len(sets), (config.batch_rows,), generator=generator)
        return loss_of(network(inputs[chosen])[:, 0], gains[chosen])

    every = torch.ones(len(sets), dtype=torch.bool)
    return fit_perceptron(config, torch.from_numpy(sets.features), every, batch_loss)


def loss_of(scores: Tensor, gains: Tensor) -> Tensor:  # [B] both -> []
    """Return the loss: what completing parts by their scores loses, and the cross entropy."""
    gains = gains.clamp(-_MOST_LOST, _MOST_GAINED)
    entropy = F.binary_cross_entropy_with_logits(scores, (gains > 0).float(), reduction="none")
    clear = (gains.abs() / _CLEAR).clamp(max=1)
    lost = -(torch.sigmoid(scores) * gains).mean()
    return _SCALE * lost + _ENTROPY_WEIGHT * (clear * entropy).mean()


def told(name: str, scorer: Perceptron, sets: BenefitSets) -> str:
    """Describe what the scorer decides about complete objects and about parts."""
    lines = []
    for kind, of_kind in (("complete", sets.complete > 0), ("parts", sets.complete == 0)):
        gains = sets.gains[of_kind]
        left = scorer(sets.features[of_kind]) < LEFT_BELOW
        after = np.where(left, 0.0, gains)
        lines.append(
            f"{name}, {kind}, {len(gains)}: {left.mean():.1%} left as they are; gain "
            f"{gains.mean():+.4f} to {after.mean():+.4f}; worse than P "
            f"{(gains < -_WORSE).mean():.1%} to {(after < -_WORSE).mean():.1%}"
        )
    return "\n".join(lines)


def main(config: BenefitScorerConfig) -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    files = benefit_sets(config)
    train_on_files(config, files, _HELD_OUT_EVERY, functools.partial(fit, config), told)
    return 0


if __name__ == "__main__":
    start(main, BenefitScorerConfig, __doc__)
