"""Train the embedded prior: ``python -m recipes.train_embedded_prior.train --out DIR``.

Conventions
-----------
* Step s is a function of the weights before it and of (seed, s): its sets, noise, timesteps and
  dropped conditions. With ``--steps`` a resumed run ends with the same bits as one that was not
  interrupted; with ``--minutes`` the learning rate follows running time, which no run repeats.
* The loss is the mean over sets of ``loss_weight(t) * mean((v - v_hat)^2)`` (``diffusion``).
* SIGTERM and SIGINT end the run at the next step with a checkpoint.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import tyro
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.priors.embedded.diffusion import NUM_TIMESTEPS, add_noise, loss_weight, velocity
from gscomplete.priors.embedded.model import (
    IMAGE_CHANNELS,
    VIEWS,
    FourViewDenoiser,
)
from gscomplete.priors.embedded.text import NO_TEXT_TOKEN
from recipes.train_embedded_prior.config import TrainConfig
from recipes.train_embedded_prior.dataset import Batch, Source, decode_sets
from recipes.train_embedded_prior.evaluate import (
    autocast,
    held_out_sets,
    measure_losses,
    save_sample_sheet,
)
from recipes.train_embedded_prior.replicas import GradientExchange, Signals
from recipes.train_embedded_prior.shards import ShardReader, ShardSpec
from recipes.train_embedded_prior.state import TrainState, open_run

_LOG = logging.getLogger(__name__)
_LOG_EVERY = 20


@dataclass(frozen=True, slots=True)
class StepNoise:
    """The random part of one step."""

    timestep: Tensor  # [B]
    noise: Tensor  # [B, 4, 4, S, S]
    keep_input: Tensor  # [B] bool
    keep_text: Tensor  # [B] bool

    def select(self, index: slice, device: str) -> StepNoise:
        """Return the part for some of the sets, on a device."""
        fields = dataclasses.fields(self)
        return StepNoise(**{f.name: getattr(self, f.name)[index].to(device) for f in fields})


def draw_step_noise(config: TrainConfig, step: int) -> StepNoise:
    """Draw a step's random numbers from (seed, step).

    Timesteps are stratified over the batch and lean towards the noisy end (half of them above
    750): there shape and colour of what is missing are decided, and runs hardly go below 300.
    """
    count, size = config.batch_sets, config.model.resolution_px
    entropy = np.random.SeedSequence((config.seed, step, 3)).generate_state(1, np.uint64)[0]
    generator = torch.Generator().manual_seed(int(entropy >> np.uint64(1)))
    strata = torch.randperm(count, generator=generator) + torch.rand(count, generator=generator)
    noise = torch.randn(count, VIEWS, IMAGE_CHANNELS, size, size, generator=generator)
    keep_input = torch.rand(count, generator=generator) >= config.drop_input
    keep_text = torch.rand(count, generator=generator) >= config.drop_text
    share = 1 - (1 - strata / count) ** 2
    return StepNoise(share * (NUM_TIMESTEPS - 1), noise, keep_input, keep_text)


def training_loss(model: FourViewDenoiser, batch: Batch, drawn: StepNoise) -> Tensor:  # []
    """Return the weighted squared error of v with conditions dropped as drawn."""
    noisy = add_noise(batch.images, drawn.noise, drawn.timestep)
    target = velocity(batch.images, drawn.noise, drawn.timestep)
    mapped = batch.input_map * drawn.keep_input[:, None, None, None, None]
    no_text = torch.zeros_like(batch.tokens)
    no_text[:, 0] = NO_TEXT_TOKEN
    tokens = torch.where(drawn.keep_text[:, None], batch.tokens, no_text)
    predicted = model(noisy, mapped, drawn.timestep, batch.ring, tokens)
    error = (predicted - target).square().mean(dim=(1, 2, 3, 4))
    return (loss_weight(drawn.timestep) * error).mean()


def learning_rate(config: TrainConfig, step: int, progress: float) -> float:
    """Return the rate at a step: linear warm-up, constant, linear to zero at progress 1."""
    warm = min(1.0, (step + 1) / max(config.warmup_steps, 1))
    fall = min(1.0, max(0.0, (1 - progress) / max(config.decay_share, 1e-9)))
    return config.learning_rate * warm * fall


def progress(config: TrainConfig, step: int, elapsed_s: float) -> float:
    """Return the share of the run that is done, by steps or by running time."""
    if config.steps is not None:
        return step / config.steps
    assert config.minutes is not None
    return elapsed_s / (60 * config.minutes)


class Trainer:
    """The loop of one replica: data, steps; in the first replica also log and checkpoints."""

    def __init__(
        self,
        config: TrainConfig,
        source: Source,
        words: tuple[str, ...],
        *,
        rank: int = 0,
        exchange: GradientExchange | None = None,
    ) -> None:
        """Build the state, or take it from the checkpoint.

        Args:
            config: the run.
            source: where objects come from.
            words: the vocabulary.
            rank: number of this replica.
            exchange: how replicas meet; None = this is the only one.

        Raises:
            UserError: there is no checkpoint to resume from.
        """
        self.config = config
        self.state = TrainState.start(config)
        if config.resume:
            self.state.load(config.out)
        size = self.state.model.config
        self._spec = ShardSpec(
            source, config.data, words, size.text_length, size.resolution_px,
            config.seed, config.shard_sets,
        )  # fmt: skip
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
        first = state.step * config.batch_sets
        reader = ShardReader(self._spec, config.out / "sets", workers=workers, first=first)
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
        first = state.step * config.batch_sets
        indices = range(first, first + config.batch_sets)[own]
        batch = decode_sets(reader.read(indices)).to(config.device)
        drawn = draw_step_noise(config, state.step).select(own, config.device)
        with autocast(config.device, config.precision):
            loss = training_loss(state.model, batch, drawn)
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
        config, state = self.config, self.state
        began = time.monotonic()
        batch = held_out_sets(self._spec, config.evaluation_sets).to(config.device)
        losses = measure_losses(state.ema, batch, config.precision)
        path = config.out / f"samples-{state.step:06d}.png"
        save_sample_sheet(state.ema, batch, config.precision, path)
        self._log("held_out", ms=1000 * (time.monotonic() - began), **losses)

    def _log(self, kind: str, **values: Any) -> None:
        entry = {"kind": kind, "step": self.state.step, "elapsed_s": self.state.elapsed_s}
        text = json.dumps({k: _rounded(v) for k, v in (entry | values).items()})
        with (self.config.out / "log.jsonl").open("a", encoding="utf-8") as file:
            file.write(text + "\n")
        _LOG.info(text)

    def _on_signal(self) -> None:
        self._stop = True


def train(config: TrainConfig, source: Source, words: tuple[str, ...]) -> TrainState:
    """Train with as many replicas as configured; this process is the first of them.

    Args:
        config: the run.
        source: where objects come from; a module-level function.
        words: the vocabulary, in the order the embeddings are trained in.

    Raises:
        UserError: the folder and the options do not fit together, or a replica died.
    """
    words = open_run(config, words)
    if config.replicas == 1:
        return Trainer(config, source, words).run()
    context = torch.multiprocessing.get_context("spawn")
    parameters = FourViewDenoiser(config.model).parameters()
    exchange = GradientExchange.create(context, config.replicas, parameters)
    others = [
        context.Process(target=_run_replica, args=(config, source, words, rank, exchange))
        for rank in range(1, config.replicas)
    ]
    for process in others:
        process.start()
    try:
        return Trainer(config, source, words, exchange=exchange).run()
    finally:
        for process in others:
            process.join(timeout=30)
            process.terminate()


def _run_replica(
    config: TrainConfig,
    source: Source,
    words: tuple[str, ...],
    rank: int,
    exchange: GradientExchange,
) -> None:
    torch.set_num_threads(config.threads)
    Trainer(config, source, words, rank=rank, exchange=exchange).run()


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


def main() -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    config = tyro.cli(TrainConfig, description=__doc__)
    os.nice(config.nice)
    torch.set_num_threads(config.threads)
    from recipes.train_embedded_prior.source import procedural_source, procedural_words

    try:
        train(config, procedural_source, procedural_words())
    except UserError as error:
        _LOG.error("%s", error)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
