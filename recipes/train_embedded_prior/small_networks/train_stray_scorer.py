"""Train the stray scorer.

``python -m recipes.train_embedded_prior.small_networks.train_stray_scorer``

It reads P alone: no network is asked. Parts are made once and kept in the run's folder, so that the
same command goes on; learning takes three minutes.

Conventions
-----------
* Two parts of each object are cut as in ``real_objects.unseen`` and get strays. Of the first
  objects, a capture is trained from photos, too (``object_tasks``), which takes most of the time.
  All depend only on the object's id.
* Every sixth file of objects is held out, and every sixth of captures.
"""

from __future__ import annotations

import functools
import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from scipy.spatial import cKDTree
from torch import Tensor, nn

from gscomplete.networks.perceptron import Perceptron
from gscomplete.priors.embedded.weights import packaged_weights
from gscomplete.splats.strays import (
    FAINT,
    FEATURES,
    LARGE,
    SPARSE,
    STRAY_FROM,
    STRAY_SCORER_FILE,
    standing_out,
)
from gscomplete.util.arrays import Float32Array
from recipes.entry_point import start
from recipes.real_objects.unseen import PartKind
from recipes.train_embedded_prior.data.stray_parts import StrayPart, stray_part
from recipes.train_embedded_prior.small_networks.array_sets import joined, made_of_tasks, stem_of
from recipes.train_embedded_prior.small_networks.object_tasks import (
    CapturesConfig,
    CaptureTask,
    ObjectTask,
    sets_of_objects,
)
from recipes.train_embedded_prior.small_networks.perceptron_training import (
    fit_perceptron,
    train_on_files,
)
from splatcomplete_data.cuts.geometry import splat_points

FILE_OBJECTS, FILE_CAPTURES = 24, 4
_KINDS: tuple[PartKind, ...] = ("scan", "scan", "arc", "half", "box", "complete")
"""A kind is drawn as often as it stands here."""
_DRAWS = 91
"""Seed of turns, parts and strays, beside the object's id."""
_MOST = 800
"""Most splats of a part of either class."""
_NEAR, _OFF = 0.012, 0.02
"""Splats of a capture nearer to the object than the first are surface, those farther than the
second strays, object sizes."""
_CAPTURE_WEIGHT = 0.3
"""Total weight of the captures' splats, for 1 of the others."""
_HELD_OUT_EVERY = 6
_SURFACE_WEIGHT = 3.0
"""Taking surface for a stray is so many times as bad as the opposite."""


@dataclass(frozen=True)
class StrayScorerConfig(CapturesConfig):
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

    features: Float32Array  # [N, F]
    is_stray: Float32Array  # [N] 0 or 1
    stands_for: Float32Array  # [N] splats of its class and part that each stands for
    is_captured: Float32Array  # [N] 0 or 1

    def __len__(self) -> int:
        return len(self.is_stray)


def stray_sets_of(task: ObjectTask) -> StraySets:
    """Return the sets of two parts of one object."""
    turned = task.turned(_DRAWS)
    rng = turned.rng
    rows = [StraySets(np.empty((0, len(FEATURES)), np.float32), *np.empty((3, 0), np.float32))]
    for kind in (_KINDS[k] for k in rng.permutation(len(_KINDS))[:2]):
        part = stray_part(turned.part(kind), turned.complete, rng)
        if part is not None:
            rows.append(_labelled(part, rng, is_captured=False))
    return joined(rows)


def captured_sets_of(task: CaptureTask) -> StraySets:
    """Return the set of a capture of one object."""
    turned, part = task.captured()
    away, _ = cKDTree(splat_points(turned.complete)).query(splat_points(part))
    return _labelled(StrayPart(part, away > _OFF, away < _NEAR), turned.rng, is_captured=True)


def _labelled(part: StrayPart, rng: np.random.Generator, *, is_captured: bool) -> StraySets:
    found, rows = standing_out(part.splats), []
    for value, of_class in ((1, part.is_stray), (0, part.is_surface)):
        members = np.flatnonzero(of_class[found.rows])
        chosen = rng.permutation(members)[:_MOST]
        share = np.full(len(chosen), len(members) / max(len(chosen), 1), np.float32)
        labels = np.full(len(chosen), value, np.float32)
        source = np.full(len(chosen), is_captured, np.float32)
        rows.append(StraySets(found.features[chosen], labels, share, source))
    return joined(rows)


def fit(config: StrayScorerConfig, sets: StraySets) -> Perceptron:
    """Train the scorer."""
    labels, counts = torch.from_numpy(sets.is_stray), torch.from_numpy(sets.stands_for)
    is_captured = torch.from_numpy(sets.is_captured) > 0
    weights = counts * torch.where(labels > 0, 1.0, _SURFACE_WEIGHT)
    if bool(is_captured.any()) and not bool(is_captured.all()):
        ratio = weights[~is_captured].sum() / weights[is_captured].sum()
        weights[is_captured] *= _CAPTURE_WEIGHT * ratio
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
    lines = []
    for source, of_source in (("parts", sets.is_captured == 0), ("captures", sets.is_captured > 0)):
        if of_source.any():
            found, wrong = (
                counts[of_source & of_class & marked].sum()
                / max(counts[of_source & of_class].sum(), 1)
                for of_class in (is_stray, ~is_stray)
            )
            lines.append(
                f"{name}, {of_source.sum():,} splats of {source} that stand out: {found:.1%} of "
                f"the strays are found, {wrong:.2%} of the surface passes for strays"
            )
    return "\n".join(lines)


def main(config: StrayScorerConfig) -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    contents = " ".join(map(str, (*FEATURES, SPARSE, FAINT, LARGE)))
    parts = sets_of_objects(config, StraySets, "strays", contents, stray_sets_of, FILE_OBJECTS)
    tasks = config.capture_tasks()
    stem = stem_of(config.run, "captures", contents)
    captures = made_of_tasks(
        StraySets, stem, captured_sets_of, tasks, FILE_CAPTURES, config.workers
    )
    files = [*parts, *captures]
    train_on_files(config, files, _HELD_OUT_EVERY, functools.partial(fit, config), told)
    return 0


if __name__ == "__main__":
    start(main, StrayScorerConfig, __doc__)
