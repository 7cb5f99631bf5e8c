"""Train the shape network on one GPU beside as many processors as there are.

``python -m recipes.train_embedded_prior.gpu.train --run.out DIR --run.meshes PACK`` is ``train
shape`` for a machine whose GPU takes steps faster than its processors make sets: they make a few
variants of every part, and all sets stay in the GPU's memory, to be drawn again in other
orientations. ``--findings`` takes what ``make_findings`` made ahead. The run folder is that of
``train``: ``export`` and ``compare_shapes`` read it.

Conventions
-----------
* Which sets a step sees depends on how fast they are made: a run cannot be repeated exactly.
* The learning rate follows running time from the first step on.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import multiprocessing
import os
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.priors.embedded.text import Tokenizer
from recipes.entry_point import start
from recipes.train_embedded_prior.config import ShapeTrainConfig
from recipes.train_embedded_prior.data.findings import Findings, read_findings
from recipes.train_embedded_prior.data.shape_dataset import (
    TEXT_LENGTH,
    ShapeSetMaker,
    decode_sets,
)
from recipes.train_embedded_prior.evaluate import autocast
from recipes.train_embedded_prior.gpu.compiled import BatchLoss, fastest_loss, lay_out_like
from recipes.train_embedded_prior.gpu.set_pool import ORIENTATIONS, SetPool
from recipes.train_embedded_prior.shape_task import ShapeTask, filled_iou
from recipes.train_embedded_prior.state import TrainState, open_run, write_record
from recipes.train_embedded_prior.train import learning_rate, training_source

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Options:
    """Train the shape network on a GPU."""

    run: ShapeTrainConfig
    """The run; its length is given in minutes, and it has one replica."""
    findings: tuple[Path, ...] = ()
    """Files of ``make_findings`` of the same seed and share of meshes: these parts come first."""
    variants: int = 5
    """Sets made of every part."""
    pool_sets: int = 150_000
    """Sets kept on the GPU, 213 kB each."""
    first_sets: int = 2000
    """Sets that there must be before the first step."""
    held_out: Path | None = None
    """Stored sets (``.npy``) to measure IoU on; None = it is not measured."""
    measure_seconds: float = 60.0
    """Time between two measurements."""
    compiled: bool = True
    """Compile the network and its loss while the first sets are made; where that cannot be done,
    they run as they are."""


Part = tuple[int, Findings | None]
_MAKERS: list[tuple[ShapeSetMaker, int]] = []
"""Of a worker process: how it makes sets, and how many of each part."""


def main(options: Options) -> None:
    """Train, log, and write the checkpoint."""
    config = options.run
    _check(options)
    known = read_findings(options.findings)
    torch.backends.cudnn.benchmark = True
    source, words = training_source(config)
    words = open_run(config, words)
    task = ShapeTask(config, source, words)
    maker = ShapeSetMaker(source, config.data, Tokenizer(words, TEXT_LENGTH), config.seed)
    pool = SetPool(options.pool_sets, config.device)
    context = multiprocessing.get_context("spawn")
    began = time.monotonic()
    with context.Pool(config.workers, _prepare, (maker, options.variants)) as workers:
        made = workers.imap_unordered(_make, _parts(known))
        feeder = threading.Thread(target=_feed, args=(made, pool), daemon=True)
        feeder.start()
        state = TrainState.start(config, task.make_model)
        loss = fastest_loss(task, state.model, compiled=options.compiled)
        lay_out_like(state.ema, state.model)
        while len(pool) < min(options.first_sets, options.pool_sets) and feeder.is_alive():
            time.sleep(0.2)
        _train(options, state, loss, pool, began)


def _check(options: Options) -> None:
    """Refuse what this trainer cannot do.

    Raises:
        UserError: an option is out of its range.
    """
    run = options.run
    for name, is_fine, expected, found in (
        ("minutes", run.minutes is not None, "a length in minutes", "steps"),
        ("resume", not run.resume, "a new run", "one to be resumed"),
        ("replicas", run.replicas == 1, "1", run.replicas),
        ("workers", run.workers >= 1, "1 or more", run.workers),
        ("batch-sets", run.batch_sets % ORIENTATIONS == 0, "a multiple of 8", run.batch_sets),
    ):
        if not is_fine:
            raise UserError(f"--run.{name}: expected {expected}, found {found}")


def _train(
    options: Options, state: TrainState, batch_loss: BatchLoss, pool: SetPool, began: float
) -> None:
    """Take steps until the time is over: one at least, however long the first sets took."""
    config = options.run
    assert config.minutes is not None
    log = _Log(options, state, pool, began)
    first = saved = time.monotonic()
    end = began + 60 * config.minutes
    while (now := time.monotonic()) < end or state.step == 0:
        done = (now - first) / (end - first) if end > first else 1.0
        rng = np.random.default_rng((config.seed, state.step, 6))
        batch = pool.draw(config.batch_sets, rng)
        with autocast(config.device, config.precision):
            loss = batch_loss(batch, rng)
        state.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        state.update(config, learning_rate(config, state.step, done))
        state.elapsed_s = time.monotonic() - first
        log.step(loss)
        if time.monotonic() - saved > 60 * config.checkpoint_minutes:
            state.save(config.out)
            saved = time.monotonic()
    state.save(config.out)
    per_step = max(1, round(pool.added / max(state.step, 1)))
    write_record(dataclasses.replace(config, fresh_sets=per_step))
    log.measure()


class _Log:
    """Lines of ``log.jsonl``: losses, how many sets there are, and IoU on held-out parts."""

    def __init__(self, options: Options, state: TrainState, pool: SetPool, began: float) -> None:
        self._options, self._state, self._pool, self._began = options, state, pool, began
        self._losses: list[torch.Tensor] = []
        self._measured = time.monotonic()
        self._held_out = None if options.held_out is None else np.load(options.held_out)

    def step(self, loss: torch.Tensor) -> None:
        """Note a step's loss."""
        self._losses.append(loss.detach())
        if len(self._losses) == 100:
            self._write(loss=float(torch.stack(self._losses).mean()))
            self._losses.clear()
            if time.monotonic() - self._measured > self._options.measure_seconds:
                self.measure()

    @torch.no_grad()
    def measure(self) -> None:
        """Measure the averaged weights."""
        if self._held_out is None:
            return
        model, device = self._state.ema.eval(), self._options.run.device
        found = []
        for first in range(0, len(self._held_out), 50):
            batch = decode_sets(self._held_out[first : first + 50]).to(device)
            with autocast(device, self._options.run.precision):
                out = model(batch.volumes, batch.evidence, batch.scores, batch.tokens)
            found += [filled_iou(out, batch)["iou"]] * len(batch.tokens)
        self._write(held_out_iou=sum(found) / len(found))
        self._measured = time.monotonic()

    def _write(self, **values: float) -> None:
        entry = {"step": self._state.step, "s": time.monotonic() - self._began}
        entry |= {"sets": self._pool.added} | values
        text = json.dumps({k: float(f"{v:.5g}") for k, v in entry.items()})
        with (self._options.run.out / "log.jsonl").open("a", encoding="utf-8") as file:
            file.write(text + "\n")
        _LOG.info(text)


def _parts(known: dict[int, Findings]) -> Iterator[Part]:
    """Number the parts: those of which something is known, then all others."""
    yield from known.items()
    index = 0
    while True:
        if index not in known:
            yield index, None
        index += 1


def _feed(made: Iterator[np.ndarray], pool: SetPool) -> None:
    """Add what is made; a part that fails is left out, and said."""
    while True:
        try:
            pool.add(next(made))
        except StopIteration:
            return
        except Exception as error:
            _LOG.warning("a part is left out: %s: %s", type(error).__name__, error)


def _prepare(maker: ShapeSetMaker, variants: int) -> None:
    torch.set_num_threads(1)
    os.nice(5)  # the trainer's process comes first
    _MAKERS.append((maker, variants))


def _make(part: Part) -> np.ndarray:  # [variants] of set_dtype
    (maker, variants), (index, known) = _MAKERS[0], part
    return np.stack(maker.variants(index, variants, known))


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    start(main, Options, __doc__)
