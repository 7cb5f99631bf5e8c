"""Records of arrays with one row per part, in files that are made once.

Networks are trained on them often, and making a part takes a second. An interrupted run goes on
with the files that exist.
"""

from __future__ import annotations

import dataclasses
import hashlib
import multiprocessing
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from gscomplete.util.atomic import atomic_path

Task = TypeVar("Task")
Sets = TypeVar("Sets")
"""A dataclass of arrays that have the same number of rows."""


def joined(parts: Sequence[Sets]) -> Sets:
    """Concatenate sets, of which there is at least one."""
    kind = type(parts[0])
    return kind(*(np.concatenate([getattr(p, name) for p in parts]) for name in _names(kind)))


def of_rows(sets: Sets, rows: NDArray[np.integer]) -> Sets:
    """Return the parts of some rows, which may be repeated."""
    return type(sets)(*(getattr(sets, name)[rows] for name in _names(type(sets))))


def made_once(
    kind: type[Sets],
    paths: dict[int, Path],
    make: Callable[[Executor, int], Sets],
    workers: int,
    description: str,
) -> list[Sets]:
    """Return the sets of all files; make the files that are missing.

    Args:
        kind: the dataclass.
        paths: paths of the files by the number of each file's first object.
        make: returns the contents of the file with that first object, made by an executor.
        workers: processes of the executor.
        description: label of the progress bar.
    """
    missing = [start for start, path in paths.items() if not path.is_file()]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        console = Console(file=sys.stderr)
        for start in track(missing, description, console=console):
            made = make(pool, start)
            with atomic_path(paths[start]) as temporary, temporary.open("wb") as file:
                np.savez(file, **{name: getattr(made, name) for name in _names(kind)})
    return [_read(kind, path) for path in paths.values()]


def stem_of(folder: Path, kind: str, contents: str) -> Path:
    """Return what the paths of a kind's files start with; other contents get another path."""
    return folder / f"{kind}-{hashlib.sha256(contents.encode()).hexdigest()[:8]}"


def made_of_tasks(
    kind: type[Sets],
    stem: Path,
    make: Callable[[Task], Sets],
    tasks: Sequence[Task],
    per_file: int,
    workers: int,
) -> list[Sets]:
    """Return the sets of tasks, which are kept in files; make the files that are missing.

    Args:
        kind: the dataclass.
        stem: start of the files' paths, which the number of a file's first task follows.
        make: makes the sets of one task; picklable.
        tasks: tasks in the order of their sets.
        per_file: number of tasks per file.
        workers: processes that make them.
    """
    stem.parent.mkdir(parents=True, exist_ok=True)
    starts = range(0, len(tasks), per_file)
    paths = {start: stem.with_name(f"{stem.name}-{start:06d}.npz") for start in starts}

    def of_file(pool: Executor, start: int) -> Sets:
        return joined(list(pool.map(make, tasks[start : start + per_file])))

    return made_once(kind, paths, of_file, workers, f"objects, {per_file} at a time")


def _read(kind: type[Sets], path: Path) -> Sets:
    with np.load(path) as arrays:
        return kind(*(arrays[name] for name in _names(kind)))


def _names(kind: type[Any]) -> list[str]:
    return [field.name for field in dataclasses.fields(kind)]
