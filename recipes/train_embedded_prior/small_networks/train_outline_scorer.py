"""Train the outline scorer, or with ``--captures 96`` that of captures.

``python -m recipes.train_embedded_prior.small_networks.train_outline_scorer``

It reads P alone: no network is asked. That of captures is trained after the stray scorer, as
captures lack the strays that this one finds. Parts are made once and kept in the run's folder, so
that the same command goes on; learning takes three minutes.

Conventions
-----------
* An outline is whole if it covers ``WHOLE`` of the complete object's.
* Every sixth file of objects and captures is held out.
"""

from __future__ import annotations

import dataclasses
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
from gscomplete.shape.outline.scorer import (
    CAPTURE_OUTLINE_SCORER_FILE,
    DOUBTED_FROM,
    OUTLINE_SCORER_FILE,
)
from recipes.entry_point import start
from recipes.train_embedded_prior.small_networks.array_sets import of_rows
from recipes.train_embedded_prior.small_networks.object_tasks import CapturesConfig
from recipes.train_embedded_prior.small_networks.outline_sets import (
    CAPTURE,
    KINDS,
    OutlineSets,
    outline_sets,
)
from recipes.train_embedded_prior.small_networks.perceptron_training import (
    fit_perceptron,
    train_on_files,
)

_HELD_OUT_EVERY = 6
WHOLE = 0.985
"""An outline is whole if it covers at least this share of the complete object's."""
_CLEAR = 0.03
"""Outlines that lack this share more than that have weight 1; ..."""
_LEAST_WEIGHT, _MOST_WEIGHT, _WHOLE_WEIGHT = 0.1, 4.0, 0.5
"""... weights are in proportion to it, between the first two. Whole outlines have the last."""
_TIMES = 20
"""Captures are among the others so many times."""
_LACKING = 0.95
"""Taking an outline with a smaller share for whole is an error that shows."""


@dataclass(frozen=True)
class OutlineScorerConfig(CapturesConfig):
    """Train the outline scorer, or that of captures."""

    run: Path = Path("runs/outline_scorer")
    out: Path = field(default_factory=lambda: packaged_weights() / OUTLINE_SCORER_FILE)
    objects: int = 960
    seed: int = 37
    width: int = 96
    epochs: int = 60
    batch_rows: int = 32
    weight_decay: float = 0.3
    captures: int = 0
    """Objects of which captures are trained; 0 for the scorer of all others."""

    @property
    def written_to(self) -> Path:
        """The file to write: by default the package's own of the scorer that is trained."""
        packaged = packaged_weights()
        if self.captures and self.out == packaged / OUTLINE_SCORER_FILE:
            return packaged / CAPTURE_OUTLINE_SCORER_FILE
        return self.out


def fit(config: OutlineScorerConfig, sets: OutlineSets) -> Perceptron:
    """Train the scorer."""
    times = np.where(sets.kinds == KINDS.index(CAPTURE), _TIMES, 1)
    sets = of_rows(sets, np.repeat(np.arange(len(sets)), times))
    shares = torch.from_numpy(sets.shares)
    weights, whole = weights_of(shares), (shares >= WHOLE).float()

    def batch_loss(network: nn.Sequential, inputs: Tensor, generator: torch.Generator) -> Tensor:
        chosen = torch.randint(len(sets), (config.batch_rows,), generator=generator)
        scores = network(inputs[chosen])[..., 0]
        entropy = F.binary_cross_entropy_with_logits(scores, whole[chosen], reduction="none")
        return (weights[chosen] * entropy).mean()

    every = torch.ones(shares.shape, dtype=torch.bool)
    return fit_perceptron(config, torch.from_numpy(sets.features), every, batch_loss)


def weights_of(shares: Tensor) -> Tensor:
    """Return the weights of outlines, which grow with the share of the object's that they lack."""
    lacking = ((WHOLE - shares) / _CLEAR).clamp(_LEAST_WEIGHT, _MOST_WEIGHT)
    return torch.where(shares >= WHOLE, _WHOLE_WEIGHT, lacking)


def told(name: str, scorer: Perceptron, sets: OutlineSets) -> str:
    """Describe what the scorer takes for whole outlines in parts of each kind."""
    lines = []
    for index, kind in enumerate(KINDS):
        chosen = sets.kinds == index
        if not chosen.any():
            continue
        shares = sets.shares[chosen]
        taken = scorer(sets.features[chosen]) > DOUBTED_FROM
        right = (shares[taken] >= WHOLE).mean() if taken.any() else np.nan
        lacking = ((shares < _LACKING) & taken).any(axis=1).mean()
        lines.append(
            f"{name}, {kind}, {len(shares)}: whole outlines of {shares.shape[1]} "
            f"{(shares >= WHOLE).sum(axis=1).mean():.1f}, taken for it "
            f"{taken.sum(axis=1).mean():.1f}, of these right {right:.1%}; parts with one that "
            f"lacks more than {1 - _LACKING:.0%} {lacking:.1%}"
        )
    return "\n".join(lines)


def main(config: OutlineScorerConfig) -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    config = dataclasses.replace(config, out=config.written_to)
    files = outline_sets(config)
    train_on_files(config, files, _HELD_OUT_EVERY, functools.partial(fit, config), told)
    return 0


if __name__ == "__main__":
    start(main, OutlineScorerConfig, __doc__)
