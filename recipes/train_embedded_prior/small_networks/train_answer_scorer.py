"""Train the answer scorer.

``python -m recipes.train_embedded_prior.small_networks.train_answer_scorer``

It comes after the shape network, whose answers it scores. Parts are made once and kept in the run's
folder, so that the same command goes on; learning takes seconds.

Conventions
-----------
* True scores are defined in ``answer_sets``. Answers of one part are compared with each other only:
  the scorer learns how much better each is than their mean, and that the best is put first.
* Every eighth file of objects is held out.
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

from gscomplete.evaluate.bootstrap import bootstrap_interval
from gscomplete.networks.perceptron import Perceptron
from gscomplete.priors.embedded.weights import packaged_weights
from gscomplete.shape.planes.answer_scorer import ANSWER_SCORER_FILE, OF_ANSWER
from gscomplete.util.arrays import Float32Array
from recipes.entry_point import start
from recipes.train_embedded_prior.small_networks.answer_sets import AnswerSets, answer_sets
from recipes.train_embedded_prior.small_networks.perceptron_training import (
    PerceptronConfig,
    fit_perceptron,
    train_on_files,
)

_HELD_OUT_EVERY = 8
_SCALE = 20.0
"""Factor on differences between true scores."""
_MOST_ABOVE, _MOST_LOST = 0.15, 0.25
"""Larger differences of a true score from the mean and from the best are clamped to these."""
_SHARPNESS = 1.5
"""Factor on scores in the softmax that an answer is drawn by."""
_ABOVE_WEIGHT = 0.5
"""Weight of the error of differences from the mean."""
_NEVER = -99.0
"""Score in place of an answer that does not exist, which is never drawn."""


@dataclass(frozen=True)
class AnswerScorerConfig(PerceptronConfig):
    """Train the answer scorer."""

    run: Path = Path("runs/answer_scorer")
    out: Path = field(default_factory=lambda: packaged_weights() / ANSWER_SCORER_FILE)
    objects: int = 2784
    seed: int = 34
    width: int = 96
    epochs: int = 60
    batch_rows: int = 128
    weight_decay: float = 0.05


def fit(config: AnswerScorerConfig, sets: AnswerSets) -> Perceptron:
    """Train the scorer."""
    asked = torch.from_numpy(~np.isnan(sets.true_scores))
    true_scores = torch.from_numpy(np.nan_to_num(sets.true_scores))
    weights = torch.from_numpy(sets.weights)

    def batch_loss(network: nn.Sequential, inputs: Tensor, generator: torch.Generator) -> Tensor:
        chosen = torch.multinomial(weights, config.batch_rows, True, generator=generator)
        return loss_of(network(inputs[chosen])[..., 0], true_scores[chosen], asked[chosen])

    return fit_perceptron(config, torch.from_numpy(sets.features), asked, batch_loss)


def loss_of(
    scores: Tensor,  # [B, K]
    true_scores: Tensor,  # [B, K]
    asked: Tensor,  # bool [B, K]
) -> Tensor:  # []
    """Return the loss: what drawing answers by their scores loses, and the error of scores.

    Args:
        scores: scores of answers.
        true_scores: their true scores.
        asked: whether an answer exists.
    """
    count = asked.sum(dim=1, keepdim=True)
    above = scores - (scores * asked).sum(dim=1, keepdim=True) / count
    mean = (true_scores * asked).sum(dim=1, keepdim=True) / count
    truly_above = _SCALE * (true_scores - mean).clamp(-_MOST_ABOVE, _MOST_ABOVE)
    error = F.smooth_l1_loss(above, truly_above, reduction="none")
    best = true_scores.masked_fill(~asked, -1.0).amax(dim=1, keepdim=True)
    lost = _SCALE * (best - true_scores).clamp(0, _MOST_LOST)
    drawn = (_SHARPNESS * scores.masked_fill(~asked, _NEVER)).softmax(dim=1)
    return (drawn * lost).sum(dim=1).mean() + _ABOVE_WEIGHT * error[asked].mean()


def true_scores_of_choice(
    scorer: Perceptron, sets: AnswerSets
) -> tuple[Float32Array, Float32Array, Float32Array]:  # [N] each
    """Return true scores of the first answers, of those to the likeliest planes, of the best."""
    rows = np.arange(len(sets))
    asked = ~np.isnan(sets.true_scores)
    chosen = np.where(asked, scorer(sets.features), -np.inf).argmax(axis=1)
    belief = sets.features[..., OF_ANSWER.index("log_belief")]
    likeliest = np.where(asked, belief, -np.inf).argmax(axis=1)
    best = np.nanmax(sets.true_scores, axis=1)
    return sets.true_scores[rows, chosen], sets.true_scores[rows, likeliest], best


def told(name: str, scorer: Perceptron, sets: AnswerSets) -> str:
    """Describe how well the scorer chooses for parts."""
    first, likeliest, best = true_scores_of_choice(scorer, sets)
    low, high = bootstrap_interval((first - likeliest).tolist())
    return (
        f"{name}, {len(first)} parts: score of the answer {first.mean():.4f}, of that to the "
        f"likeliest plane {likeliest.mean():.4f} ({(first - likeliest).mean():+.4f}, {low:+.4f} to "
        f"{high:+.4f}), of the best {best.mean():.4f}"
    )


def main(config: AnswerScorerConfig) -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    files = answer_sets(config)
    train_on_files(config, files, _HELD_OUT_EVERY, functools.partial(fit, config), told)
    return 0


if __name__ == "__main__":
    start(main, AnswerScorerConfig, __doc__)
