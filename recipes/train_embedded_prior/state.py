"""All that a training run carries from step to step, and its checkpoint.

Conventions
-----------
* A checkpoint is two files: ``checkpoint.safetensors`` (float32: ``model.*``, ``ema.*``,
  ``first.*`` and ``second.*`` moments) with the step and the running time in its metadata, and
  ``run.json`` (configuration and words), written at every start.
* Noise and data are functions of (seed, step), so no generator state is kept.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor, nn

from gscomplete.errors import UserError
from gscomplete.priors.embedded.text import FIRST_WORD_TOKEN
from gscomplete.priors.embedded.weights import TrainingRecord
from gscomplete.util.atomic import atomic_path
from gscomplete.util.jsonio import from_json, read_json, write_json
from recipes.train_embedded_prior.config import RunConfig, ShapeTrainConfig, TrainConfig
from recipes.train_embedded_prior.warm_start import fill, start_weights

CHECKPOINT = "checkpoint.safetensors"
RUN = "run.json"
_TEXT_RATE_FACTOR = 4.0
"""Learning rate of what reads the prompt, relative to the rest: each word is seen rarely."""
_CLIP_NORM = 1.0


@dataclass(frozen=True, slots=True)
class RunRecord:
    """What a run was started with."""

    config: TrainConfig | ShapeTrainConfig
    words: tuple[str, ...]
    before: TrainingRecord | None = None
    """How the weights came to be that the run started from; None = it started from nothing."""


@dataclass(slots=True)
class TrainState:
    """Weights, their average, the optimiser, and how far the run is."""

    model: nn.Module
    ema: nn.Module
    optimizer: torch.optim.Optimizer
    step: int = 0
    elapsed_s: float = 0.0

    @classmethod
    def start(cls, config: RunConfig, make_model: Callable[[], nn.Module]) -> TrainState:
        """Initialise a run: the weights are a function of the seed, or those to start from.

        Raises:
            UserError: the weights to start from cannot be read or do not fit.
        """
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            model = make_model().to(config.device)
            ema = make_model().to(config.device).requires_grad_(False)
        start = None if config.resume else start_weights(config)
        if start is not None:
            fill(model, start)
        ema.load_state_dict(model.state_dict())
        return cls(model, ema, make_optimizer(model, config))

    def update(self, config: RunConfig, learning_rate: float) -> None:
        """Take one optimiser step with the gradients at hand and move the average along."""
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate * group["factor"]
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), _CLIP_NORM)
        self.optimizer.step()
        self.step += 1
        decay = min(config.ema_decay, (1 + self.step) / (10 + self.step))  # young: over less
        with torch.no_grad():
            torch._foreach_lerp_(
                list(self.ema.parameters()), list(self.model.parameters()), 1 - decay
            )

    def save(self, folder: Path) -> None:
        """Write the checkpoint, replacing the last one in one step."""
        tensors = {f"model.{k}": v for k, v in self.model.state_dict().items()}
        tensors |= {f"ema.{k}": v for k, v in self.ema.state_dict().items()}
        for name, parameter in self.model.named_parameters():
            moments = self.optimizer.state.get(parameter)
            if moments:
                tensors[f"first.{name}"] = moments["exp_avg"]
                tensors[f"second.{name}"] = moments["exp_avg_sq"]
        metadata = {"step": str(self.step), "elapsed_s": repr(self.elapsed_s)}
        plain = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
        with atomic_path(folder / CHECKPOINT) as temporary:
            temporary.write_bytes(save(plain, metadata=metadata))

    def load(self, folder: Path) -> None:
        """Take over a checkpoint exactly.

        Raises:
            UserError: there is none.
        """
        path = folder / CHECKPOINT
        if not path.exists():
            raise UserError(f"{path}: no checkpoint to resume from")
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata()
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        self.model.load_state_dict(_part(tensors, "model."))
        self.ema.load_state_dict(_part(tensors, "ema."))
        self.step = int(metadata["step"])
        self.elapsed_s = float(metadata["elapsed_s"])
        first, second = _part(tensors, "first."), _part(tensors, "second.")
        for name, parameter in self.model.named_parameters():
            if name in first:
                self.optimizer.state[parameter] = {
                    "step": torch.tensor(float(self.step), dtype=torch.float32),
                    "exp_avg": torch.empty_like(parameter).copy_(first[name]),
                    "exp_avg_sq": torch.empty_like(parameter).copy_(second[name]),
                }


def make_optimizer(model: nn.Module, config: RunConfig) -> torch.optim.Optimizer:
    """Return AdamW; only matrices and kernels decay, and the text's part learns faster."""
    groups = []
    for reads_text, factor in ((False, 1.0), (True, _TEXT_RATE_FACTOR)):
        for is_matrix, decay in ((True, config.weight_decay), (False, 0.0)):
            parameters = [
                parameter
                for name, parameter in model.named_parameters()
                if (parameter.ndim >= 2) == is_matrix and _reads_text(name) == reads_text
            ]
            groups.append({"params": parameters, "weight_decay": decay, "factor": factor})
    return torch.optim.AdamW(groups, lr=config.learning_rate, betas=config.betas, fused=True)


def _reads_text(name: str) -> bool:
    return "text" in name or name.startswith(("pooled.", "words."))


def open_run(config: TrainConfig | ShapeTrainConfig, words: tuple[str, ...]) -> tuple[str, ...]:
    """Create the run folder, or check that a resumed one is the same run.

    A resumed run keeps its words in their order; words that the generator has learned since then
    are appended.

    Returns:
        The words of the run.

    Raises:
        UserError: the folder holds a run already, or another one than is to be resumed, or there
            are more words than the model has room for.
    """
    path = config.out / RUN
    before = None
    if config.resume:
        record = from_json(RunRecord, read_json(path), str(path))
        for name in ("seed", "batch_sets", "data", "mesh_count", "model", "shard_sets"):
            if getattr(record.config, name) != getattr(config, name):
                raise UserError(
                    f"{path}: {name}: expected {getattr(record.config, name)} as the run was "
                    f"started, found {getattr(config, name)}"
                )
        words = (*record.words, *(word for word in words if word not in record.words))
        before = record.before
    elif (config.out / CHECKPOINT).exists():
        raise UserError(f"{config.out}: holds a checkpoint; resume it or choose another --out")
    else:
        start = start_weights(config)
        if start is not None:
            words = (*start.words, *(word for word in words if word not in start.words))
            before = start.training
    room = config.model.vocabulary_size - FIRST_WORD_TOKEN
    if len(words) > room:
        raise UserError(f"model.vocabulary_size: room for {room} words, found {len(words)}")
    config.out.mkdir(parents=True, exist_ok=True)
    write_json(path, RunRecord(config, words, before))
    return words


def write_record(config: TrainConfig | ShapeTrainConfig) -> None:
    """Write another configuration into a run's record: what is known at its end alone."""
    path = config.out / RUN
    record = from_json(RunRecord, read_json(path), str(path))
    write_json(path, dataclasses.replace(record, config=config))


def _part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
