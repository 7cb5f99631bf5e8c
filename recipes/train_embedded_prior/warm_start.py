"""Start a new run from exported weights, such as the package's own.

Conventions
-----------
* Exported weights are rounded averages without an optimiser's moments: this starts a new run, with
  a warm-up of its own; it does not resume the one that made them.
* A run's vocabulary has room for more words than the weights know: theirs come first, in their
  order; rows of the embedding beyond them keep their random numbers.
* A run's network may have more blocks than the weights: a new one changes nothing at first, so the
  run starts from the weights' own answers.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from gscomplete.errors import UserError
from gscomplete.priors.embedded.weights import TrainingRecord, load_weights
from recipes.train_embedded_prior.config import RunConfig, ShapeTrainConfig


@dataclass(frozen=True, slots=True)
class StartWeights:
    """What a run starts from."""

    folder: Path
    state: dict[str, Tensor]
    words: tuple[str, ...]
    training: TrainingRecord


def start_weights(config: RunConfig) -> StartWeights | None:
    """Read the weights that a run is to start from; None where it starts from nothing.

    Raises:
        UserError: they cannot be read, or hold no shape network where one is to be trained.
    """
    folder = config.start_from
    if folder is None:
        return None
    denoiser, shape, record = load_weights(folder)
    if not isinstance(config, ShapeTrainConfig):
        return StartWeights(folder, denoiser.state_dict(), record.words, record.training)
    if shape is None or record.shape is None:
        raise UserError(f"{folder}: expected a shape network to start from, found none")
    return StartWeights(folder, shape.state_dict(), record.shape.words, record.shape.training)


def fill(model: nn.Module, start: StartWeights) -> None:
    """Give a model the weights to start from.

    Raises:
        UserError: they are of a model of other sizes.
    """
    own = model.state_dict()
    for name, value in start.state.items():
        room = own.get(name)
        if room is not None and _is_vocabulary(name) and len(room) >= len(value):
            value = torch.cat([value, room[len(value) :].cpu()])
        if room is None or room.shape != value.shape:
            found = "none" if room is None else list(room.shape)
            raise UserError(
                f"{start.folder}: {name}: expected {list(value.shape)} as in the weights, the "
                f"model to train has {found}"
            )
        own[name] = value
    model.load_state_dict(own)


def _is_vocabulary(name: str) -> bool:
    return name in ("words.weight", "text.words.weight")
