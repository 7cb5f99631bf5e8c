"""Feed the readers mutated files: ``python -m recipes.stress_readers [--count 2000] [--seed 0]``.

A small valid file of every kind is mutated, as bytes (changed, removed, doubled, overwritten, cut
off, other numbers) or inside its packing (``packings``), and read. Anything but a finite result or
a ``UserError`` within the limits on time and memory is a failure, and the file that caused it is
kept. Which mutation is number n depends on (seed, n) alone; so an hour of other ones is
``--count 1000000 --seed 1 --minutes 60``. Readers run in a process of their own: one that dies
fails only what it was reading.
"""

from __future__ import annotations

import collections
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from gscomplete.errors import UserError
from recipes.entry_point import start
from recipes.stress_readers.mutations import mutate
from recipes.stress_readers.worker import CURRENT, Answer, read_all

_START_S = 900
"""Longest time until the first answer: everything that is compiled is."""


@dataclass(frozen=True)
class Options:
    """Feed the readers mutated files."""

    count: int = 2000
    """Mutated files at most."""
    first: int = 0
    """Number of the first mutation."""
    minutes: float = float("inf")
    """End after these many minutes."""
    seed: int = 0
    """Seed of the mutations."""
    limit_s: int = 10
    """Longest time for one file."""
    limit_gb: float = 2.0
    """Most address space beyond what the process has at its start; a reader that wants more for a
    small file fails."""
    keep: Path = Path("stress_failures")
    """Folder for files that made a reader fail; not created when there is none."""


def main(options: Options) -> int:
    """Run all mutations and report; return 1 if any made a reader fail."""
    counts: collections.Counter[str] = collections.Counter()
    slowest = Answer(-1, "", "", 0.0)
    started = time.monotonic()
    first, last = options.first, options.first + options.count
    while first < last and _minutes_since(started) < options.minutes:
        with tempfile.TemporaryDirectory() as name:
            work, said = Path(name), ""
            for answer in _answers(work, options, first, last):
                if isinstance(answer, str):
                    said = answer
                    break
                is_failed = answer.text not in ("read", "refused")
                counts["failed" if is_failed else answer.text] += 1
                slowest = max(slowest, answer, key=lambda a: a.seconds)
                first = answer.number + 1
                if is_failed:
                    _keep(options, work, answer)
                if _minutes_since(started) >= options.minutes:
                    break
            if said and first < last:
                if not (work / CURRENT).exists():
                    raise UserError(f"the readers' process gave no answer: {said}")
                counts["failed"] += 1
                _keep(options, work, Answer(first, (work / CURRENT).read_text(), said, 0.0))
                first += 1
    told = {"slowest_s": round(slowest.seconds, 2), "slowest": f"{slowest.number} {slowest.file}"}
    minutes = round(_minutes_since(started), 1)
    sys.stdout.write(json.dumps({**counts, **told, "minutes": minutes}) + "\n")
    return 1 if counts["failed"] else 0


def _answers(work: Path, options: Options, first: int, last: int) -> Iterator[Answer | str]:
    """Yield what a process of readers answers; at its end, how it ended."""
    context = get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    limits = (options.limit_s, options.limit_gb)
    asked = (work, options.seed, first, last, *limits, theirs)
    process = context.Process(target=read_all, args=asked)
    process.start()
    theirs.close()
    longest_s = _START_S
    try:
        while ours.poll(longest_s):
            yield ours.recv()
            longest_s = 3 * options.limit_s
        yield "hangs in native code"
    except EOFError:
        yield "its process died"
    finally:
        process.kill()
        process.join()


def _minutes_since(started: float) -> float:
    """Return the minutes that have passed."""
    return (time.monotonic() - started) / 60


def _keep(options: Options, work: Path, answer: Answer) -> None:
    """Report a failure and keep its file."""
    sys.stdout.write(json.dumps({"number": answer.number, answer.file: answer.text}) + "\n")
    sys.stdout.flush()
    options.keep.mkdir(parents=True, exist_ok=True)
    sound = work / "seeds" / answer.file
    damaged = mutate(sound.name, sound.read_bytes(), options.seed, answer.number)
    (options.keep / f"{answer.number}_{sound.name}").write_bytes(damaged)


if __name__ == "__main__":
    start(main, Options, __doc__)
