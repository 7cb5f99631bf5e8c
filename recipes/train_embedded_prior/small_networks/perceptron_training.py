"""Train perceptrons: those that judge P and answers, and the one that predicts surface depths."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor, nn

from gscomplete.networks.perceptron import Perceptron
from recipes.train_embedded_prior.small_networks.array_sets import joined

BatchLoss = Callable[[nn.Sequential, Tensor, torch.Generator], Tensor]
"""(network, scaled features, generator of draws) -> loss [] of one batch."""
Sets = TypeVar("Sets")
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class PerceptronConfig:
    """How a perceptron is trained, whichever it is."""

    meshes: Path
    """Pack of meshes; its train split is used."""
    run: Path
    """Folder for the parts."""
    out: Path
    """File to write; the default is the package's own."""
    objects: int
    """Objects to learn from, the held-out ones included; some parts of each."""
    seed: int
    width: int
    """Units of the first hidden layer; the second has half as many."""
    epochs: int
    batch_rows: int
    weight_decay: float
    learning_rate: float = 3e-3
    dropout: float = 0.1
    workers: int = 2
    """Processes that make parts."""


def fit_perceptron(
    config: PerceptronConfig,
    features: Tensor,  # [N, ..., F]
    asked: Tensor,  # bool [N, ...] rows from which centre and spread are computed
    batch_loss: BatchLoss,
) -> Perceptron:
    """Train a perceptron of three layers; the learning rate falls to zero along a cosine."""
    generator = torch.Generator().manual_seed(config.seed)
    torch.manual_seed(config.seed)
    center = features[asked].mean(dim=0)
    spread = features[asked].std(dim=0).clamp_min(1e-3)
    inputs, width = (features - center) / spread, config.width
    network = nn.Sequential(
        nn.Linear(features.shape[-1], width), nn.SiLU(), nn.Dropout(config.dropout),
        nn.Linear(width, width // 2), nn.SiLU(), nn.Dropout(config.dropout),
        nn.Linear(width // 2, 1),
    )  # fmt: skip
    optimizer = torch.optim.AdamW(
        network.parameters(), config.learning_rate, weight_decay=config.weight_decay
    )
    steps = max(config.epochs * len(features) // config.batch_rows, 1)
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = config.learning_rate * 0.5 * (1 + math.cos(math.pi * step / steps))
        loss = batch_loss(network, inputs, generator)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return Perceptron.of(network, center, spread)


def train_on_files(
    config: PerceptronConfig,
    files: Sequence[Sets],
    held_out_every: int,
    fit: Callable[[Sets], Perceptron],
    told: Callable[[str, Perceptron, Sets], str],
) -> None:
    """Train a scorer, log how good it is, and write it.

    It is first trained without the held-out files, to measure it on these, and then on all files.

    Args:
        config: the file to write.
        files: parts, one entry per file.
        held_out_every: the first of every so many files is held out.
        fit: trains a scorer on parts.
        told: describes how a scorer does on parts, given what these are called.
    """
    held_out = joined(files[::held_out_every])
    others = [sets for k, sets in enumerate(files) if k % held_out_every]
    if others:
        _LOG.info(told("held out", fit(joined(others)), held_out))
    every = joined(files)
    scorer = fit(every)
    _LOG.info(told("learned from", scorer, every))
    scorer.save(config.out)
    _LOG.info("%s", config.out)
