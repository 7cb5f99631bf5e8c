"""Training sets on their way to the trainer: made ahead by worker processes, read in order.

Conventions
-----------
* Shard k holds sets ``k * shard_sets`` to ``(k + 1) * shard_sets - 1`` in one ``.npy`` file that
  appears atomically; worker w of W makes the shards k with k % W == w.
* A file only buffers the values of a pure function, so the reader deletes files that it has passed.
* Workers stay at most ``ahead`` shards before the reader and have the lowest priority, so that
  they use the processor when the trainer waits for them and get out of its way otherwise.
"""

from __future__ import annotations

import hashlib
import logging
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.priors.embedded.text import Tokenizer
from gscomplete.util.atomic import atomic_path
from gscomplete.util.jsonio import dumps
from recipes.train_embedded_prior.config import DataConfig
from recipes.train_embedded_prior.data.dataset import SetMaker, Source

_LOG = logging.getLogger(__name__)
_POLL_S = 0.05


class SetSpec(Protocol):
    """What the shards of one folder hold; picklable for worker processes."""

    @property
    def shard_sets(self) -> int:
        """Sets per shard."""
        ...

    def maker(self, seed: int | None = None) -> Callable[[int], np.ndarray]:
        """Return the function that makes the sets, of another seed if one is given."""
        ...

    def key(self) -> str:
        """Name the contents: folders of different options never mix."""
        ...


@dataclass(frozen=True, slots=True)
class ShardSpec:
    """The sets of the four-view denoiser."""

    source: Source
    data: DataConfig
    words: tuple[str, ...]
    text_length: int
    resolution_px: int
    seed: int
    shard_sets: int

    def maker(self, seed: int | None = None) -> SetMaker:
        """Return the function that makes the sets, of another seed if one is given."""
        tokenizer = Tokenizer(self.words, self.text_length)
        chosen = self.seed if seed is None else seed
        return SetMaker(self.source, self.data, tokenizer, self.resolution_px, chosen)

    def key(self) -> str:
        """Name the contents: folders of different options never mix."""
        text = dumps([self.data, self.words, self.text_length, self.resolution_px, self.seed])
        return hashlib.sha256(f"{text}{self.shard_sets}".encode()).hexdigest()[:12]


class ShardReader:
    """Sets by index, made by worker processes on the way. Use as a context manager.

    With 0 workers the reader makes the sets itself; with None it waits for another reader's
    workers to make them.
    """

    def __init__(
        self,
        spec: SetSpec,
        folder: Path,
        *,
        workers: int | None,
        first: int,
        ahead: int = 12,
        behind: int = 1,
    ) -> None:
        """Prepare to read.

        Args:
            spec: what to read.
            folder: where shards are buffered, in a folder of their own.
            workers: see above.
            first: the set to start with; older ones may be read too, as far as ``behind``
                reaches, and are made first if they are gone.
            ahead: shards made before they are wanted.
            behind: shards kept after the newest one that was wanted.
        """
        self._spec = spec
        self._folder = folder / spec.key()
        self._folder.mkdir(parents=True, exist_ok=True)
        self._workers = workers
        self._ahead = ahead
        self._behind = behind
        context = multiprocessing.get_context("spawn")
        self._wanted = context.Value("q", first // spec.shard_sets)
        self._context = context
        self._processes: list[Any] = []
        self._open: dict[int, np.ndarray] = {}
        self.waited_s = 0.0

    def __enter__(self) -> ShardReader:
        """Start the workers."""
        for number in range(self._workers or 0):
            process = self._context.Process(
                target=_work,
                args=(
                    self._spec,
                    self._folder,
                    number,
                    self._workers,
                    self._ahead,
                    self._behind,
                    self._wanted,
                ),
                daemon=True,
            )
            process.start()
            self._processes.append(process)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the workers."""
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.join()

    def read(self, indices: Sequence[int]) -> np.ndarray:  # [B] of set_dtype
        """Return sets, the newest last, waiting for those not made yet.

        Raises:
            UserError: a worker died.
        """
        size = self._spec.shard_sets
        self._pass(indices[-1] // size)
        return np.stack([self._shard(index // size)[index % size] for index in indices])

    def _pass(self, number: int) -> None:
        """Note where reading is; forget and delete shards well behind it."""
        self._wanted.value = max(self._wanted.value, number)
        for old in [k for k in self._open if k < number - self._behind]:
            del self._open[old]
            if self._workers is not None:
                shard_path(self._folder, old).unlink(missing_ok=True)

    def _shard(self, number: int) -> np.ndarray:
        if number not in self._open:
            path = shard_path(self._folder, number)
            started = time.monotonic()
            while not path.exists():
                self._check_workers(number)
                time.sleep(_POLL_S)
            self.waited_s += time.monotonic() - started
            self._open[number] = np.load(path)
        return self._open[number]

    def _check_workers(self, number: int) -> None:
        if self._workers == 0:
            _make_shard(self._spec.maker(), self._spec, self._folder, number)
        for process in self._processes:
            if process.exitcode is not None:
                raise UserError(
                    f"training data: a worker ended with exit code {process.exitcode}; "
                    "its traceback is above"
                )


def shard_path(folder: Path, number: int) -> Path:
    """Return the file of a shard."""
    return folder / f"sets-{number:06d}.npy"


def _make_shard(
    maker: Callable[[int], np.ndarray], spec: SetSpec, folder: Path, number: int
) -> None:
    first = number * spec.shard_sets
    stored = np.stack([maker(index) for index in range(first, first + spec.shard_sets)])
    with atomic_path(shard_path(folder, number)) as temporary, temporary.open("wb") as file:
        np.save(file, stored)


def _work(
    spec: SetSpec,
    folder: Path,
    number: int,
    workers: int,
    ahead: int,
    behind: int,
    wanted: Any,
) -> None:
    """Make this worker's shards in order, staying near the reader."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(19)
    torch.set_num_threads(1)
    _use_one_numba_thread()
    maker = spec.maker()
    parent = os.getppid()
    oldest = max(wanted.value - behind, 0)
    shard = oldest + (number - oldest) % workers
    while os.getppid() == parent:
        if shard_path(folder, shard).exists():
            shard += workers
        elif shard > wanted.value + ahead:
            time.sleep(_POLL_S)
        else:
            _make_shard(maker, spec, folder, shard)


def _use_one_numba_thread() -> None:
    import numba

    numba.set_num_threads(1)
