"""A small valid file of every kind that is read, each with its reader.

Conventions
-----------
* Every kind has a folder of its own, with what its files need beside them; a reader is given a file
  in a copy of that folder, where all others are undamaged.
* A reader returns what was read, which has to be finite (``finite.require_finite``), and raises
  ``UserError`` for what it refuses.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from recipes.stress_readers.seeds.captures import capture_seeds
from recipes.stress_readers.seeds.folders import folder_seeds
from recipes.stress_readers.seeds.meshes import mesh_seeds
from recipes.stress_readers.seeds.pictures import picture_seeds
from recipes.stress_readers.seeds.priors import prior_seeds
from recipes.stress_readers.seeds.runs import run_seeds
from recipes.stress_readers.seeds.scans import scan_seeds
from recipes.stress_readers.seeds.splats import splat_seeds

Reader = Callable[[Path], object]

_KINDS: dict[str, Callable[[Path], list[tuple[str, Reader]]]] = {
    "splats": splat_seeds,
    "meshes": mesh_seeds,
    "scans": scan_seeds,
    "pictures": picture_seeds,
    "captures": capture_seeds,
    "folders": folder_seeds,
    "runs": run_seeds,
    "priors": prior_seeds,
}


def seed_files(folder: Path) -> list[tuple[Path, Reader]]:
    """Write a valid file of every kind; return each, relative to the folder, with its reader."""
    found: list[tuple[Path, Reader]] = []
    for kind, write in _KINDS.items():
        home = folder / kind
        home.mkdir(parents=True)
        found += [(Path(kind, name), reader) for name, reader in write(home)]
    return found
