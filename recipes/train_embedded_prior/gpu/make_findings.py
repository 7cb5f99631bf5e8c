"""Compute in advance the findings that take most of the time of a training set (``data.findings``).

``python -m recipes.train_embedded_prior.gpu.make_findings --meshes PACK --out FILE --first 0 --last
20000`` helps a machine whose processors cannot keep up with its GPU: with findings computed
elsewhere, only a ninth of a set's work is left to it. An interrupted command loses at most the last
few hundred findings.
"""

from __future__ import annotations

import multiprocessing
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gscomplete.priors.embedded.text import Tokenizer
from gscomplete.util.atomic import atomic_path
from recipes.entry_point import start
from recipes.train_embedded_prior.config import ShapeDataConfig
from recipes.train_embedded_prior.data.findings import read_rows
from recipes.train_embedded_prior.data.mesh_source import MixedSource
from recipes.train_embedded_prior.data.shape_dataset import TEXT_LENGTH, ShapeSetMaker


@dataclass(frozen=True)
class Options:
    """Make findings ahead."""

    meshes: Path
    """Pack of meshes."""
    out: Path
    """File of the findings; those in it already are kept."""
    first: int
    """First part."""
    last: int
    """First part that is not made."""
    seed: int = 0
    mesh_share: float = 0.7
    """Share of parts of meshes, as in training."""
    minutes: float = 60.0
    """Stop after so many minutes."""
    jobs: int = 2


def main(options: Options) -> None:
    """Make, and write every few hundred."""
    rows = list(read_rows(options.out)) if options.out.exists() else []
    made = {int(row["index"]) for row in rows}
    wanted = [k for k in range(options.first, options.last) if k not in made]
    if not wanted:
        return
    began = time.monotonic()
    context = multiprocessing.get_context("spawn")
    with context.Pool(options.jobs, _prepare, (options,)) as pool:
        for row in pool.imap_unordered(_made, wanted, chunksize=8):
            rows.append(row)
            over = time.monotonic() - began > 60 * options.minutes
            if len(rows) % 256 == 0 or over:
                _write(rows, options.out)
                sys.stdout.write(f"{len(rows)} findings, {time.monotonic() - began:.0f} s\n")
                sys.stdout.flush()
            if over:
                break
    _write(rows, options.out)


def _write(rows: list[np.ndarray], path: Path) -> None:
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.save(file, np.stack(rows))


_MAKER: list[ShapeSetMaker] = []
"""Of a worker process."""


def _prepare(options: Options) -> None:
    torch.set_num_threads(1)
    source = MixedSource(options.meshes, options.mesh_share)
    data = ShapeDataConfig(mesh_share=options.mesh_share)
    _MAKER.append(ShapeSetMaker(source, data, Tokenizer((), TEXT_LENGTH), options.seed))


def _made(index: int) -> np.ndarray:
    found: np.ndarray = _MAKER[0].findings(index).stored(index)
    return found


if __name__ == "__main__":
    start(main, Options, __doc__)
