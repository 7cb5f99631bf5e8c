"""What a run finds out about a part before it asks the shape network.

It takes three quarters of the time of a training set and less than 200 bytes.

``python -m recipes.train_embedded_prior.data.findings --meshes PACK --out FILE --first A --last B``
makes them ahead, for a machine whose processors cannot keep up with its accelerator
(``train_on_gpu``).

Conventions
-----------
* Planes are in the frame that the part is posed in.
* Findings hold for the part that they were made of: it is known again by its number of splats.
"""

from __future__ import annotations

import multiprocessing
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gscomplete.shape.symmetry import SymmetryMap, mirror, plane_of
from gscomplete.shape.symmetry_choice import CANDIDATES
from gscomplete.splats import Splats
from gscomplete.util.atomic import atomic_path
from recipes.entry_point import start

DTYPE = np.dtype(
    [
        ("index", "i8"),
        ("splats", "i4"),
        ("center", "f8", (3,)),
        ("size", "f8"),
        ("azimuth_deg", "f8"),
        ("count", "i1"),
        ("planes", "f4", (CANDIDATES, 3)),
    ]
)
"""Of one part; planes are angle, offset, score."""


@dataclass(frozen=True, slots=True)
class GuessedFrame:
    """Where a run guesses the complete object, and the view that it takes for c."""

    center: tuple[float, float, float]
    size: float
    azimuth_deg: float


@dataclass(frozen=True, slots=True)
class Findings:
    """What a run finds out about one part."""

    splats: int
    """Of the part, by which it is known again."""
    guess: GuessedFrame
    planes: tuple[SymmetryMap, ...]
    """Candidates, the likeliest first."""

    def are_of(self, part: Splats) -> bool:
        """Return whether this is the part, which draws of other library versions may change."""
        return self.splats == len(part)

    def stored(self, index: int) -> np.ndarray:  # [] of DTYPE
        """Return the stored form."""
        row = np.zeros((), DTYPE)
        row["index"], row["splats"] = index, self.splats
        row["center"], row["size"] = self.guess.center, self.guess.size
        row["azimuth_deg"], row["count"] = self.guess.azimuth_deg, len(self.planes)
        for k, plane in enumerate(self.planes):
            row["planes"][k] = (*plane_of(plane), plane.score)
        return row

    @classmethod
    def of(cls, row: np.ndarray) -> Findings:  # [] of DTYPE
        """Read the stored form."""
        planes = row["planes"][: int(row["count"])].tolist()
        x, y, z = row["center"].tolist()
        return cls(
            int(row["splats"]),
            GuessedFrame((x, y, z), float(row["size"]), float(row["azimuth_deg"])),
            tuple(mirror(*plane) for plane in planes),
        )


def read_findings(paths: Sequence[Path]) -> dict[int, Findings]:
    """Return the findings of files by the number of their part."""
    rows = [row for path in paths for row in np.load(path)]
    return {int(row["index"]): Findings.of(row) for row in rows}


@dataclass(frozen=True)
class Options:
    """Make findings ahead."""

    meshes: Path
    """Pack of meshes."""
    out: Path
    """File of the findings; what it holds already is kept."""
    first: int
    """First part."""
    last: int
    """First part that is not made."""
    seed: int = 0
    mesh_share: float = 0.7
    """Share of parts of meshes, as in training."""
    minutes: float = 60.0
    """Stop after so long."""
    jobs: int = 2


def main(options: Options) -> None:
    """Make, and write every few hundred."""
    rows = list(np.load(options.out)) if options.out.exists() else []
    made = {int(row["index"]) for row in rows}
    wanted = [k for k in range(options.first, options.last) if k not in made]
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


def _prepare(options: Options) -> None:
    from gscomplete.priors.embedded.text import Tokenizer
    from recipes.train_embedded_prior.config import ShapeDataConfig
    from recipes.train_embedded_prior.data.mesh_source import MixedSource
    from recipes.train_embedded_prior.data.shape_dataset import TEXT_LENGTH, ShapeSetMaker

    torch.set_num_threads(1)
    source = MixedSource(options.meshes, options.mesh_share)
    data = ShapeDataConfig(mesh_share=options.mesh_share)
    _MAKER.append(ShapeSetMaker(source, data, Tokenizer((), TEXT_LENGTH), options.seed))


_MAKER: list = []


def _made(index: int) -> np.ndarray:
    found: np.ndarray = _MAKER[0].findings(index).stored(index)
    return found


if __name__ == "__main__":
    start(main, Options, __doc__)
