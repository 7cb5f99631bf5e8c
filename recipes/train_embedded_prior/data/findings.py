"""Findings: what a run computes about a part before it asks the shape network.

Computing them takes three quarters of the time of a training set, storing them less than 200 bytes.
``gpu.make_findings`` computes them in advance.

Conventions
-----------
* Planes are in the frame that the part is posed in.
* Findings belong to one part, which is recognised by its number of splats.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscomplete.errors import UserError
from gscomplete.shape.symmetry import SymmetryMap, mirror, plane_of
from gscomplete.shape.symmetry_choice import CANDIDATES
from gscomplete.splats import Splats

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
        """Return whether they belong to a part; other library versions may draw another one."""
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


def read_rows(path: Path) -> np.ndarray:  # [N] of DTYPE
    """Return what a file holds, in the stored form.

    Raises:
        UserError: the file is missing, damaged or of another kind.
    """
    try:
        rows: np.ndarray = np.load(path)
    except (OSError, ValueError, EOFError) as error:
        raise UserError(f"{path}: expected findings (.npy), found damage: {error}") from None
    if rows.dtype != DTYPE:
        raise UserError(f"{path}: expected rows of {DTYPE.names}, found {rows.dtype}")
    return rows


def read_findings(paths: Sequence[Path]) -> dict[int, Findings]:
    """Return the findings of files by the number of their part.

    Raises:
        UserError: as from :func:`read_rows`.
    """
    return {int(row["index"]): Findings.of(row) for path in paths for row in read_rows(path)}
