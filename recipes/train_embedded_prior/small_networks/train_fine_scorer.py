"""Train the fine symmetry scorer.

``python -m recipes.train_embedded_prior.small_networks.train_fine_scorer``

It comes after the coarse scorer, whose likely planes it scores, and before the shape network, whose
training sets hold the copies that it prefers. Objects are made once and kept in the run's folder;
training goes on from the last checkpoint there.

Conventions
-----------
* The score of a plane is defined in ``copies``.
* One answer learns the softmax of true scores times ``_SHARPNESS`` by cross entropy,
  the other the true scores themselves by squared error; runs use the former only.
* Random numbers are a function of (seed, step). The first file of objects is held out.
"""

from __future__ import annotations

import copy
import logging
import math
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from safetensors.torch import load_file, save_file
from torch import Tensor

from gscomplete.cli.guard import run_guarded
from gscomplete.fitting.step_loop import require_same_identity
from gscomplete.networks.precision import cpu_precision
from gscomplete.priors.embedded.weights import packaged_weights
from gscomplete.shape.planes.coarse_scorer import packaged_coarse_scorer
from gscomplete.shape.planes.features import plane_places
from gscomplete.shape.planes.fine_scorer import (
    FINE_SCORER_FILE,
    FineSymmetryScorer,
    FoldedVolumes,
    colored_cells,
    folded_volumes,
)
from gscomplete.shape.planes.proposals import FINELY_SCORED
from gscomplete.util.atomic import atomic_path
from gscomplete.util.jsonio import to_json, write_json
from recipes.train_embedded_prior.data.shape_dataset import unpack_cells
from recipes.train_embedded_prior.small_networks.plane_sets import (
    BEST_PLANES,
    FILE_OBJECTS,
    PlaneSets,
    plane_sets,
)

_LOG = logging.getLogger(__name__)
_CHECKPOINT = "fine_scorer_checkpoint.safetensors"
_RUN = "fine_scorer.json"
_DECAY_FROM = 0.4
"""Share of the steps after which the learning rate falls, as a cosine, to 0."""
_SHARPNESS = 10.0
"""Factor on true scores in the softmax that is the target."""
_SCORE_WEIGHT = 3.0
"""Weight of the squared error of true scores."""
_WITHOUT_EFFECT = {"run", "out", "checkpoint_every", "workers"}
"""Options that do not affect the weights."""


@dataclass(frozen=True)
class FineScorerConfig:
    """Train the fine symmetry scorer."""

    run: Path = Path("runs/fine_scorer")
    """Folder for the objects and the checkpoint."""
    out: Path = field(default_factory=lambda: packaged_weights() / FINE_SCORER_FILE)
    """File to write; the default is the package's own."""
    objects: int = 6000
    """Objects to learn from, the held-out ones included."""
    meshes: Path | None = None
    """Pack of meshes to take objects from beside procedural ones; None = none."""
    start_from: Path | None = None
    """Scorer to start from, such as the package's own; None = random numbers."""
    seed: int = 600_000
    steps: int = 3000
    batch_objects: int = 8
    planes: int = 12
    """Of each object in a step, one of the best by the truth among them."""
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    average: float = 0.998
    """Decay of the average of the weights that is exported."""
    checkpoint_every: int = 200
    """Steps."""
    workers: int = 2
    """Processes that make objects."""


@dataclass(frozen=True, slots=True)
class PlaneBatch:
    """A batch: the planes of its B objects, P of each, one object after the other."""

    volumes: FoldedVolumes
    features: Tensor  # [B P, F]
    ranked: Tensor  # [B P] logits of the coarse scorer
    true_scores: Tensor  # [B P]


def batch_of(sets: PlaneSets, config: FineScorerConfig, step: int) -> PlaneBatch:
    """Draw the batch of a step: objects with other colours, mirrored, and with sides swapped."""
    rng = np.random.default_rng((config.seed, step))
    drawn = []
    for index in rng.integers(FILE_OBJECTS, len(sets), config.batch_objects):
        best = FINELY_SCORED + int(rng.integers(BEST_PLANES))
        chosen = np.append(rng.permutation(FINELY_SCORED)[: config.planes - 1], best)
        drawn.append(_planes(sets, int(index), chosen, rng))
    fine = torch.cat([one.volumes.fine for one in drawn])
    coarse = torch.cat([one.volumes.coarse for one in drawn])
    features, ranked, true_scores = (
        torch.cat([getattr(one, name) for one in drawn])
        for name in ("features", "ranked", "true_scores")
    )
    return PlaneBatch(FoldedVolumes(fine, coarse), features, ranked, true_scores)


def _planes(
    sets: PlaneSets,
    index: int,
    chosen: NDArray[np.intp],  # [P]
    rng: np.random.Generator | None,
) -> PlaneBatch:
    """Return some planes of an object.

    Args:
        sets: objects.
        index: number of the object.
        chosen: numbers of its planes.
        rng: for random changes that keep true scores; None = nothing is changed.
    """
    cells = colored_cells(unpack_cells(sets.cells[index][None])[0])
    if rng is not None:
        cells[:, 3:6] = cells[:, 3:6][:, rng.permutation(3)] * rng.uniform(0.6, 1.0, 3)
    evidence = sets.evidence[index].astype(np.float32) / 255
    folded = folded_volumes(cells, evidence, *plane_places(sets.planes[index, chosen]))
    fine, coarse = folded.fine, folded.coarse
    if rng is not None:
        if rng.random() < 0.5:
            fine, coarse = fine.flip(3), coarse.flip(3)
        other_side = torch.from_numpy(rng.random(len(chosen)) < 0.5)
        fine, coarse = _swapped(fine, other_side), _swapped(coarse, other_side)
    return PlaneBatch(
        FoldedVolumes(fine, coarse),
        torch.from_numpy(sets.features[index, chosen]),
        torch.from_numpy(sets.logits[index, chosen]),
        torch.from_numpy(sets.true_scores[index, chosen]),
    )


def _swapped(sides: Tensor, which: Tensor) -> Tensor:  # [K, 2 C, u, v, z], [K]
    """Swap the sides of some planes."""
    one, other = sides.chunk(2, dim=1)
    swapped = torch.cat([other, one], dim=1)
    return torch.where(which[:, None, None, None, None], swapped, sides)


def learning_rate(config: FineScorerConfig, step: int) -> float:
    """Return the learning rate of a step."""
    done = max(step / config.steps - _DECAY_FROM, 0.0) / (1 - _DECAY_FROM)
    warm = min(1.0, (step + 1) / 100)
    return config.learning_rate * warm * (0.5 + 0.5 * math.cos(math.pi * done))


class FineScorerTraining:
    """The networks and the optimiser, kept in a file."""

    def __init__(self, config: FineScorerConfig, features: Tensor) -> None:
        """Start from the first step; the scaling of features is that of ``features`` [N, K, F]."""
        torch.manual_seed(config.seed)
        self.config = config
        self.scorer = FineSymmetryScorer()
        self.scorer.center.copy_(features.mean(dim=(0, 1)))
        self.scorer.spread.copy_(features.std(dim=(0, 1)).clamp_min(1e-3))
        if config.start_from is not None:
            self.scorer.load_state_dict(FineSymmetryScorer.load(config.start_from).state_dict())
        self.average = copy.deepcopy(self.scorer)
        self.optimizer = torch.optim.AdamW(
            self.scorer.parameters(),
            config.learning_rate,
            betas=(0.9, 0.98),
            weight_decay=config.weight_decay,
        )
        self.step = 0

    def advance(self, batch: PlaneBatch) -> float:
        """Take a step and return its loss."""
        config = self.config
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(config, self.step)
        with cpu_precision(bfloat16=True):
            logits, predicted = self.scorer(batch.volumes, batch.features, batch.ranked)
        by_object = (config.batch_objects, config.planes)
        target = (_SHARPNESS * batch.true_scores).view(by_object).softmax(dim=1)
        guess = logits.float().view(by_object).log_softmax(dim=1)
        loss = -(guess * target).sum(dim=1).mean()
        loss = loss + _SCORE_WEIGHT * (predicted.float() - batch.true_scores).square().mean()
        self.optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.scorer.parameters(), 1.0)
        self.optimizer.step()
        self.step += 1
        keep = min(config.average, self.step / (self.step + 10))
        with torch.no_grad():
            for mean, value in zip(
                self.average.parameters(), self.scorer.parameters(), strict=True
            ):
                mean.lerp_(value, 1 - keep)
        return float(loss.detach())

    def save(self) -> None:
        """Write the checkpoint."""
        tensors = {f"scorer.{k}": v for k, v in self.scorer.state_dict().items()}
        tensors |= {f"average.{k}": v for k, v in self.average.state_dict().items()}
        for index, moments in self.optimizer.state_dict()["state"].items():
            tensors |= {f"moments.{index}.{k}": torch.as_tensor(v) for k, v in moments.items()}
        tensors["step"] = torch.tensor(self.step)
        with atomic_path(self.config.run / _CHECKPOINT) as temporary:
            save_file({k: v.contiguous() for k, v in tensors.items()}, temporary)

    def resume(self) -> None:
        """Continue from the checkpoint, if there is one."""
        path = self.config.run / _CHECKPOINT
        if not path.is_file():
            return
        tensors = load_file(path)
        for name, network in (("scorer", self.scorer), ("average", self.average)):
            start = name + "."
            network.load_state_dict(
                {k.removeprefix(start): v for k, v in tensors.items() if k.startswith(start)}
            )
        state = self.optimizer.state_dict()
        for key, value in tensors.items():
            if key.startswith("moments."):
                _, index, moment = key.split(".")
                state["state"].setdefault(int(index), {})[moment] = value
        self.optimizer.load_state_dict(state)
        self.step = int(tensors["step"])


def open_run(config: FineScorerConfig) -> None:
    """Create the run folder, or check that a checkpoint there is of the same run.

    Raises:
        UserError: it is of another run.
    """
    options = {k: v for k, v in to_json(config).items() if k not in _WITHOUT_EFFECT}
    identity = {"options": options, "coarse_scorer": packaged_coarse_scorer().digest()}
    if (config.run / _CHECKPOINT).is_file():
        require_same_identity(config.run / _RUN, identity)
    config.run.mkdir(parents=True, exist_ok=True)
    write_json(config.run / _RUN, {"identity": identity, "config": config})


@torch.no_grad()
def score_of_choice(scorer: FineSymmetryScorer, sets: PlaneSets) -> tuple[float, float, float]:
    """Return mean true scores: of the fine scorer's planes, the coarse scorer's, and the best."""
    found = []
    for index in range(len(sets)):
        one = _planes(sets, index, np.arange(FINELY_SCORED), None)
        with cpu_precision(bfloat16=True):
            logits, _ = scorer(one.volumes, one.features, one.ranked)
        found.append((one.true_scores[logits.argmax()], one.true_scores[0], one.true_scores.max()))
    first, ranked, best = np.array(found).mean(axis=0).tolist()
    return first, ranked, best


def train(config: FineScorerConfig) -> int:
    """Train, from the last checkpoint on if there is one, and write the scorer."""
    open_run(config)
    folder = config.run / "objects"
    sets = plane_sets(folder, config.seed, config.objects, config.workers, config.meshes)
    training = FineScorerTraining(config, torch.from_numpy(sets.features))
    training.resume()
    started, smoothed = time.monotonic(), math.nan
    steps = range(training.step, config.steps)
    for _ in track(steps, "steps", console=Console(file=sys.stderr)):
        loss = training.advance(batch_of(sets, config, training.step))
        smoothed = loss if math.isnan(smoothed) else 0.98 * smoothed + 0.02 * loss
        if training.step % config.checkpoint_every == 0:
            training.save()
            minutes = (time.monotonic() - started) / 60
            _LOG.info("step %d, %.1f min: loss %.3f", training.step, minutes, smoothed)
    scorer = training.average.eval()
    held_out = sets.first(FILE_OBJECTS)
    found = score_of_choice(scorer, held_out)
    _LOG.info("held out: score of the plane %.3f, of the coarse scorer's %.3f, best %.3f", *found)
    scorer.save(config.out)
    _LOG.info("%s", config.out)
    return 0


def main() -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    config = tyro.cli(FineScorerConfig, description=__doc__)
    return run_guarded("train_fine_scorer", lambda: train(config), "the same command goes on")


if __name__ == "__main__":
    sys.exit(main())
