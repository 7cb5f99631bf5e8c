"""Feed the readers mutated files: ``python -m recipes.stress_readers [--count 2000] [--seed 0]``.

A small valid file of every kind is mutated (bytes changed, runs removed, doubled, swapped or
overwritten, numbers replaced, the end cut off) and read. Anything but a result or a ``UserError``
within the limits on time and memory is a failure, and the file that caused it is kept. Which
mutation is number n depends on (seed, n) alone. Readers run in a process of their own: one that
dies fails only what it was reading.
"""

from __future__ import annotations

import collections
import json
import shutil
import sys
import tempfile
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from gscomplete.errors import UserError
from recipes.entry_point import start
from recipes.stress_readers.worker import Answer, read_all

_START_S = 900
"""Longest time until the first answer: everything that is compiled is."""


@dataclass(frozen=True)
class Options:
    """Feed the readers mutated files."""

    count: int = 2000
    """Mutated files."""
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
    context = get_context("spawn")
    first = 0
    while first < options.count:
        with tempfile.TemporaryDirectory() as name:
            ours, theirs = context.Pipe(duplex=False)
            limits = (options.limit_s, options.limit_gb)
            work = (Path(name), options.seed, first, options.count, *limits, theirs)
            process = context.Process(target=read_all, args=work)
            process.start()
            theirs.close()
            answer = Answer(first - 1, "", "", 0.0)
            try:
                while ours.poll(_START_S if answer.number < first else 3 * options.limit_s):
                    answer = ours.recv()
                    failed = answer.text not in ("read", "refused")
                    counts["failed" if failed else answer.text] += 1
                    slowest = max(slowest, answer, key=lambda a: a.seconds)
                    if failed:
                        _keep(options.keep, Path(name), answer)
                text = "hangs in native code"
            except EOFError:
                text = "its process died"
            process.kill()
            process.join()
            first = answer.number + 1
            if answer.number < 0 and first == 0:
                raise UserError(f"the readers' process gave no answer: {text}")
            if first < options.count:
                counts["failed"] += 1
                damaged = max((Path(name) / "mutated").iterdir(), key=lambda p: p.stat().st_mtime)
                _keep(options.keep, Path(name), Answer(first, damaged.name, text, 0.0))
                first += 1
    told = {"slowest_s": round(slowest.seconds, 2), "slowest": f"{slowest.number} {slowest.file}"}
    sys.stdout.write(json.dumps({**counts, **told}) + "\n")
    return 1 if counts["failed"] else 0


def _keep(keep: Path, work: Path, answer: Answer) -> None:
    """Report a failure and keep its file."""
    sys.stdout.write(json.dumps({"number": answer.number, answer.file: answer.text}) + "\n")
    sys.stdout.flush()
    keep.mkdir(parents=True, exist_ok=True)
    shutil.copy(work / "mutated" / answer.file, keep / f"{answer.number}_{answer.file}")


if __name__ == "__main__":
    start(main, Options, __doc__)
