"""Train a network of the embedded prior.

``python -m recipes.train_embedded_prior.train views --out DIR`` trains the four-view denoiser,
``... shape --out DIR`` the shape network. The scorers of planes of symmetry are trained before the
latter, by ``train_coarse_scorer`` and then ``train_fine_scorer``; ``export`` turns both runs into
the package's weights.

Conventions
-----------
* Step s is a function of the weights before it and of (seed, s): its sets, noise, timesteps and
  dropped conditions. With ``--steps`` a resumed run ends with the same bits as one that was not
  interrupted; with ``--minutes`` the learning rate follows running time, which no run repeats.
* SIGTERM and SIGINT end the run at the next step with a checkpoint.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Protocol

import numpy as np
import torch
import tyro
from torch import Tensor, nn

from gscomplete.errors import UserError
from recipes.train_embedded_prior.config import RunConfig, ShapeTrainConfig, TrainConfig
from recipes.train_embedded_prior.data.dataset import Source
from recipes.train_embedded_prior.data.replicas import GradientExchange, Signals
from recipes.train_embedded_prior.data.shards import SetSpec, ShardReader
from recipes.train_embedded_prior.evaluate import autocast
from recipes.train_embedded_prior.shape_task import ShapeTask
from recipes.train_embedded_prior.state import TrainState, open_run
from recipes.train_embedded_prior.views_task import ViewsTask

_LOG = logging.getLogger(__name__)
_LOG_EVERY = 20


class Task(Protocol):
    """What is trained; picklable to replicas."""

    @property
    def config(self) -> TrainConfig | ShapeTrainConfig:
        """The run."""
        ...

    @property
    def words(self) -> tuple[str, ...]:
        """The vocabulary, in the order the embeddings are trained in."""
        ...

    @property
    def spec(self) -> SetSpec:
        """What training sets are."""
        ...

    @property
    def behind(self) -> int:
        """How many shards behind the newest a step may read."""
        ...

    def make_model(self) -> nn.Module:
        """Build the network."""
        ...

    def set_indices(self, step: int) -> Sequence[int]:
        """Return the sets of a step, the newest last."""
        ...

    def loss(self, model: nn.Module, stored: np.ndarray, step: int, own: slice) -> Tensor:
        """Return the loss of a replica's share of a step's sets."""
        ...

    def evaluate(self, model: nn.Module, sheet: Path) -> dict[str, float]:
        """Measure on held-out sets and draw a sheet."""
        ...


def learning_rate(config: RunConfig, step: int, progress: float) -> float:
    """Return the rate at a step: linear warm-up, constant, linear to zero at progress 1."""
    warm = min(1.0, (step + 1) / max(config.warmup_steps, 1))
    fall = min(1.0, max(0.0, (1 - progress) / max(config.decay_share, 1e-9)))
    return config.learning_rate * warm * fall


def progress(config: RunConfig, step: int, elapsed_s: float) -> float:
    """Return the share of the run that is done, by steps or by running time."""
    if config.steps is not None:
        return step / config.steps
    assert config.minutes is not None
    return elapsed_s / (60 * config.minutes)


class Trainer:
    """The loop of one replica: data, steps; in the first replica also log and checkpoints."""

    def __init__(
        self, task: Task, *, rank: int = 0, exchange: GradientExchange | None = None
    ) -> None:
        """Build the state, or take it from the checkpoint.

        Args:
            task: what to train.
            rank: number of this replica.
            exchange: how replicas meet; None = this is the only one.

        Raises:
            UserError: there is no checkpoint to resume from.
        """
        self.task, self.config = task, task.config
        self.state = TrainState.start(self.config, task.make_model)
        if self.config.resume:
            self.state.load(self.config.out)
        self._rank = rank
        self._exchange = exchange
        self._stop = False
        self._smoothed: float | None = None

    def run(self) -> TrainState:
        """Train to the end of the run, or to a signal, and write the last checkpoint."""
        config, state = self.config, self.state
        started = time.monotonic() - state.elapsed_s
        last_saved = last_sampled = state.elapsed_s
        workers = config.workers if self._rank == 0 else None
        first = self.task.set_indices(state.step)[-1]
        reader = ShardReader(
            self.task.spec,
            config.out / "sets",
            workers=workers,
            first=first,
            behind=self.task.behind,
        )
        with _signals(self._on_signal), reader:
            done = progress(config, state.step, state.elapsed_s) >= 1
            while not done:
                done = self._one_step(reader)
                state.elapsed_s = time.monotonic() - started
                if self._rank != 0:
                    continue
                if state.elapsed_s - last_saved > 60 * config.checkpoint_minutes:
                    state.save(config.out)
                    last_saved = state.elapsed_s
                if state.elapsed_s - last_sampled > 60 * config.sample_minutes:
                    self._evaluate()
                    last_sampled = state.elapsed_s
        if self._rank == 0:
            state.save(config.out)
            if not self._stop and config.evaluation_sets:
                self._evaluate()
        return state

    def _one_step(self, reader: ShardReader) -> bool:
        """Take one step; return whether it was the last."""
        config, state = self.config, self.state
        began, waited = time.monotonic(), reader.waited_s
        own = slice(self._rank, None, config.replicas)
        stored = reader.read(self.task.set_indices(state.step)[own])
        with autocast(config.device, config.precision):
            loss = self.task.loss(state.model, stored, state.step, own)
        state.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        mean_loss = float(loss.detach())
        told = Signals(progress(config, state.step, state.elapsed_s), self._stop)
        if self._exchange is not None:
            parameters = list(state.model.parameters())
            mean_loss, told = self._exchange.average(
                state.step, self._rank, parameters, mean_loss, told
            )
        state.update(config, learning_rate(config, state.step, told.progress))
        if self._rank == 0:
            self._log_step(mean_loss, began, reader.waited_s - waited)
        if config.steps is not None:
            return told.stop or state.step >= config.steps
        return told.stop or told.progress >= 1

    def _log_step(self, loss: float, began: float, waited_s: float) -> None:
        past = loss if self._smoothed is None else self._smoothed
        self._smoothed = past + (loss - past) * 0.01
        step = self.state.step
        if step % _LOG_EVERY == 0 or step == 1:
            self._log(
                "step",
                loss=loss,
                smoothed=self._smoothed,
                ms=1000 * (time.monotonic() - began),
                data_ms=1000 * waited_s,
                sets=step * self.config.batch_sets,
            )

    def _evaluate(self) -> None:
        began = time.monotonic()
        path = self.config.out / f"samples-{self.state.step:06d}.png"
        losses = self.task.evaluate(self.state.ema, path)
        self._log("held_out", ms=1000 * (time.monotonic() - began), **losses)

    def _log(self, kind: str, **values: Any) -> None:
        entry = {"kind": kind, "step": self.state.step, "elapsed_s": self.state.elapsed_s}
        text = json.dumps({k: _rounded(v) for k, v in (entry | values).items()})
        with (self.config.out / "log.jsonl").open("a", encoding="utf-8") as file:
            file.write(text + "\n")
        _LOG.info(text)

    def _on_signal(self) -> None:
        self._stop = True


def train(task: Task) -> TrainState:
    """Train with as many replicas as configured; this process is the first of them.

    Args:
        task: what to train; its run folder has been opened (``open_run``).

    Raises:
        UserError: a replica died, or there is no checkpoint to resume from.
    """
    config = task.config
    if config.replicas == 1:
        return Trainer(task).run()
    context = torch.multiprocessing.get_context("spawn")
    exchange = GradientExchange.create(context, config.replicas, task.make_model().parameters())
    others = [
        context.Process(target=_run_replica, args=(task, rank, exchange))
        for rank in range(1, config.replicas)
    ]
    for process in others:
        process.start()
    try:
        return Trainer(task, exchange=exchange).run()
    finally:
        for process in others:
            process.join(timeout=30)
            process.terminate()


def _run_replica(task: Task, rank: int, exchange: GradientExchange) -> None:
    torch.set_num_threads(task.config.threads)
    Trainer(task, rank=rank, exchange=exchange).run()


@contextmanager
def _signals(stop: Any) -> Iterator[None]:
    """Call ``stop`` on SIGTERM and SIGINT while the block runs."""
    kinds = (signal.SIGTERM, signal.SIGINT)
    before = [signal.signal(kind, lambda *_: stop()) for kind in kinds]
    try:
        yield
    finally:
        for kind, handler in zip(kinds, before, strict=True):
            signal.signal(kind, handler)


def _rounded(value: Any) -> Any:
    return float(f"{value:.5g}") if isinstance(value, float) else value


def training_source(config: TrainConfig | ShapeTrainConfig) -> tuple[Source, tuple[str, ...]]:
    """Return where a run's objects come from, and the words to train on.

    Raises:
        UserError: the pack of meshes has no manifest.
    """
    from recipes.train_embedded_prior.data.mesh_source import MixedSource
    from recipes.train_embedded_prior.data.source import (
        frequent_words,
        procedural_source,
        procedural_words,
    )

    words = procedural_words()
    if config.meshes is None:
        return procedural_source, words
    mixed = MixedSource(config.meshes, config.data.mesh_share, config.mesh_count)
    return mixed, (*words, *(w for w in frequent_words(mixed.captions()) if w not in words))


def main() -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    config = tyro.cli(
        Annotated[TrainConfig, tyro.conf.subcommand("views")]
        | Annotated[ShapeTrainConfig, tyro.conf.subcommand("shape")],  # type: ignore[arg-type]
        description=__doc__,
    )
    os.nice(config.nice)
    torch.set_num_threads(config.threads)
    try:
        source, words = training_source(config)
        words = open_run(config, words)
        if isinstance(config, ShapeTrainConfig):
            train(ShapeTask(config, source, words))
        else:
            train(ViewsTask(config, source, words))
    except UserError as error:
        _LOG.error("%s", error)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
