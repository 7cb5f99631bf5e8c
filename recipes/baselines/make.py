"""Make the baselines that run here: ``python -m recipes.baselines.make --dataset DIR --out DIR``.

Every object of the dataset gets ``OUT/METHOD/ID.ply`` by every method, in P's file frame, ready for
``gscomplete report --dataset DIR --runs ours=RUNS OUT/*``. Existing files are kept, so the same
command resumes where it was stopped. An object to which a method does not apply, or on which it
fails, is reported with the reason and skipped; the exit code is 1 if any failed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from rich.console import Console
from rich.progress import track

from gscomplete.errors import UserError
from gscomplete.evaluate.subject import objects_of
from gscomplete.folders import ObjectFolder
from gscomplete.priors import Prior, load_prior
from gscomplete.splats import write_splats
from recipes.baselines.bank import Bank, read_bank
from recipes.baselines.here import NotApplicable, completed_here, read_part
from recipes.entry_point import start

Method = Literal["partial", "likeliest_mirror", "best_mirror", "poisson", "nearest_mesh"]
ALL: tuple[Method, ...] = get_args(Method)


@dataclass(frozen=True)
class Options:
    """Complete a dataset by the baselines that need no other system."""

    dataset: Path
    """Folder of object folders."""
    out: Path
    """Folder for METHOD/ID.ply."""
    methods: tuple[Method, ...] = ALL
    """Baselines to make."""
    bank: Path | None = None
    """The file of ``recipes.baselines.bank``; None = ``nearest_mesh`` is left out."""


@dataclass(frozen=True, slots=True)
class Left:
    """A completion that was not made, and why."""

    method: str
    object: str
    reason: str
    failed: bool
    """False = the method has nothing for such an object."""


def make(options: Options) -> list[Left]:
    """Make what is not there yet.

    Returns:
        What was not made.

    Raises:
        UserError: the dataset or the bank cannot be read.
    """
    methods: tuple[str, ...] = options.methods
    if options.bank is None and "nearest_mesh" in methods:
        methods = tuple(name for name in methods if name != "nearest_mesh")
        sys.stderr.write("nearest_mesh: left out: it needs --bank (recipes.baselines.bank)\n")
    objects = objects_of(options.dataset)
    bank = None if options.bank is None else read_bank(options.bank)
    prior = load_prior("embedded")
    left: list[Left] = []
    for known in track(objects, "objects", console=Console(file=sys.stderr)):
        left += _make_all(known, methods, options.out, prior, bank)
    return left


def _make_all(
    known: ObjectFolder, methods: tuple[str, ...], out: Path, prior: Prior, bank: Bank | None
) -> list[Left]:
    """Complete one object by all methods that have not completed it yet."""
    missing = [name for name in methods if not (out / name / f"{known.id}.ply").is_file()]
    if not missing:
        return []
    try:
        part = read_part(known, prior, bank)
    except UserError as error:
        return [Left(name, known.id, str(error), failed=True) for name in missing]
    left = []
    for name in missing:
        (out / name).mkdir(parents=True, exist_ok=True)
        try:
            write_splats(out / name / f"{known.id}.ply", completed_here(name, part))
        except NotApplicable as error:
            left.append(Left(name, known.id, str(error), failed=False))
        except UserError as error:
            left.append(Left(name, known.id, str(error), failed=True))
    return left


def summary(left: list[Left]) -> str:
    """Say by method and reason what was not made."""
    lines = []
    for method, reason in dict.fromkeys((entry.method, entry.reason) for entry in left):
        ids = [entry.object for entry in left if (entry.method, entry.reason) == (method, reason)]
        lines.append(f"{method}: none of {', '.join(ids)}: {reason}\n")
    return "".join(lines)


def main(options: Options) -> int:
    """Make the baselines; 1 = one failed."""
    left = make(options)
    sys.stdout.write(summary(left))
    sys.stdout.write(f"written: {options.out}\n")
    return 1 if any(entry.failed for entry in left) else 0


if __name__ == "__main__":
    start(main, Options, __doc__)
