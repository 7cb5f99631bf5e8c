"""Train the coarse symmetry scorer.

``python -m recipes.train_embedded_prior.small_networks.train_coarse_scorer`` comes before the shape
network, whose training sets hold the copies that it chooses.

Conventions
-----------
* The score of a plane is defined in ``copies``.
* The scorer learns the softmax of the planes' true scores times ``_SHARPNESS`` by cross entropy.
* Object k is that of the shape network's sets of another seed; every fifth is held out.
"""

from __future__ import annotations

import logging
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from torch import Tensor, nn

from gscomplete.networks.perceptron import Perceptron
from gscomplete.priors.embedded.weights import packaged_weights
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.planes.coarse_scorer import COARSE_SCORER_FILE
from gscomplete.shape.planes.features import FEATURES, plane_features
from gscomplete.util.arrays import Float32Array
from recipes.entry_point import start
from recipes.train_embedded_prior.data.copies import Truth
from recipes.train_embedded_prior.small_networks.plane_sets import Task, posed_object

_LOG = logging.getLogger(__name__)
_HELD_OUT_EVERY = 5
_SHARPNESS = 16.0
"""Factor on true scores in the softmax that is the target."""


@dataclass(frozen=True)
class CoarseScorerConfig:
    """Train the coarse symmetry scorer."""

    out: Path = field(default_factory=lambda: packaged_weights() / COARSE_SCORER_FILE)
    """File to write; the default is the package's own."""
    objects: int = 2800
    """Objects to learn from, the held-out ones included."""
    seed: int = 5_000_000
    width: int = 48
    """Units of both hidden layers."""
    steps: int = 2500
    batch_objects: int = 16
    learning_rate: float = 3e-3
    weight_decay: float = 1e-2
    dropout: float = 0.1
    workers: int = 2
    """Processes that make objects."""


def _measured(task: Task) -> tuple[Float32Array, Float32Array]:
    """Return the planes' features and true scores for one object."""
    torch.set_num_threads(1)
    posed, _ = posed_object(task)
    look = voxelize_partial(posed.partial, posed.distribution)
    features = plane_features(look.samples(), look.evidence)
    return features, Truth.of(posed.partial, posed.complete).plane_scores()


def measured_planes(config: CoarseScorerConfig) -> tuple[Tensor, Tensor]:  # [N, A, O, F], [N, A, O]
    """Make the objects and measure all planes of each."""
    tasks: list[Task] = [(config.seed, index, None) for index in range(config.objects)]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(config.workers, mp_context=context) as pool:
        made = pool.map(_measured, tasks, chunksize=8)
        console = Console(file=sys.stderr)
        found = list(track(made, "objects", total=len(tasks), console=console))
    features, true_scores = zip(*found, strict=True)
    return torch.from_numpy(np.stack(features)), torch.from_numpy(np.stack(true_scores))


def fit(config: CoarseScorerConfig, features: Tensor, true_scores: Tensor) -> Perceptron:
    """Train the scorer.

    Args:
        config: knobs.
        features: [N, A, O, F].
        true_scores: [N, A, O].
    """
    torch.manual_seed(config.seed)
    center = features.mean(dim=(0, 1, 2))
    spread = features.std(dim=(0, 1, 2)).clamp_min(1e-3)
    inputs = ((features - center) / spread).flatten(1, 2)
    targets = (_SHARPNESS * true_scores.flatten(1)).softmax(dim=1)
    hidden = config.width
    network = nn.Sequential(
        nn.Linear(len(FEATURES), hidden), nn.SiLU(), nn.Dropout(config.dropout),
        nn.Linear(hidden, hidden), nn.SiLU(),
        nn.Linear(hidden, 1),
    )  # fmt: skip
    optimizer = torch.optim.AdamW(
        network.parameters(), config.learning_rate, weight_decay=config.weight_decay
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, config.learning_rate, config.steps)
    for _ in range(config.steps):
        chosen = torch.randint(len(inputs), (config.batch_objects,))
        logits = network(inputs[chosen])[..., 0]
        loss = -(logits.log_softmax(dim=1) * targets[chosen]).sum(dim=1).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return Perceptron.of(network, center, spread)


def score_of_choice(
    scorer: Perceptron, features: Tensor, true_scores: Tensor
) -> tuple[float, float]:
    """Return the mean true score of the planes that the scorer puts first, and of the best ones."""
    first = torch.from_numpy(scorer(features.numpy())).flatten(1).argmax(dim=1)
    flat = true_scores.flatten(1)
    return float(flat[torch.arange(len(flat)), first].mean()), float(flat.amax(dim=1).mean())


def main(config: CoarseScorerConfig) -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    features, true_scores = measured_planes(config)
    held_out = torch.arange(len(features)) % _HELD_OUT_EVERY == 0
    scorer = fit(config, features[~held_out], true_scores[~held_out])
    for name, rows in (("trained on", ~held_out), ("held out", held_out)):
        found, best = score_of_choice(scorer, features[rows], true_scores[rows])
        _LOG.info("%s: score of the first plane %.3f, of the best %.3f", name, found, best)
    scorer.save(config.out)
    _LOG.info("%s", config.out)
    return 0


if __name__ == "__main__":
    start(main, CoarseScorerConfig, __doc__)
