"""The process that reads mutated files, one after the other."""

from __future__ import annotations

import logging
import resource
import shutil
import signal
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType

from gscomplete.errors import UserError
from recipes.stress_readers.finite import require_finite
from recipes.stress_readers.mutations import mutate
from recipes.stress_readers.seeds import Reader, seed_files

CURRENT = "current"
"""File beside the mutated ones that names the one which is being read."""
_SEED_LIMIT_S = 600
"""Longest time for an undamaged file: the first of a kind compiles."""


@dataclass(frozen=True)
class Answer:
    """The outcome of reading one mutated file."""

    number: int
    file: str
    """Path below ``mutated``."""
    text: str
    """``read``, ``refused``, or what went wrong."""
    seconds: float


def read_all(
    folder: Path,
    seed: int,
    first: int,
    count: int,
    limit_s: int,
    limit_gb: float,
    answers: Connection,
) -> None:
    """Read mutations ``first`` to ``count`` and send an answer to each."""
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    seeds = seed_files(folder / "seeds")
    for path, reader in seeds:
        answer = try_reader(reader, folder / "seeds" / path, _SEED_LIMIT_S)
        if answer != "read":
            raise UserError(f"{path}: the seed itself gives: {answer}")
    limit = _address_space() + int(limit_gb * 1e9)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    numbers = range(first, count)
    for number, path, reader in mutated(folder, seeds, seed, numbers):
        (folder / CURRENT).write_text(str(path))
        started = time.perf_counter()
        text = try_reader(reader, folder / "mutated" / path, limit_s)
        answers.send(Answer(number, str(path), text, time.perf_counter() - started))


def mutated(
    folder: Path, seeds: list[tuple[Path, Reader]], seed: int, numbers: range
) -> Iterator[tuple[int, Path, Reader]]:
    """Put one mutated file after the other in a copy of the seeds; yield its path there.

    Args:
        folder: holds the seeds, and gets their copy ``mutated``.
        seeds: what ``seed_files`` gives.
        seed: of the mutations.
        numbers: which ones.
    """
    shutil.copytree(folder / "seeds", folder / "mutated")
    for number in numbers:
        path, reader = seeds[number % len(seeds)]
        sound = (folder / "seeds" / path).read_bytes()
        damaged = folder / "mutated" / path
        damaged.write_bytes(mutate(path.name, sound, seed, number))
        yield number, path, reader
        damaged.write_bytes(sound)


def try_reader(reader: Reader, path: Path, limit_s: int) -> str:
    """Read a file; return ``read``, ``refused``, or what went wrong."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"longer than {limit_s} s")

    signal.signal(signal.SIGALRM, stop)
    signal.alarm(limit_s)
    try:
        require_finite(reader(path))
    except UserError as error:
        if f"longer than {limit_s} s" in str(error):  # a reader took the alarm for a damaged file
            return f"TimeoutError: {error}"[:200]
        return "refused"
    except BaseException as error:  # any other exception is a failure of the reader
        return f"{type(error).__name__}: {error}"[:200]
    finally:
        signal.alarm(0)
    return "read"


def _address_space() -> int:
    """Return how many bytes of addresses the process has."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return pages * resource.getpagesize()
