"""Pack meshes into a bank of known shapes: ``python -m recipes.train_embedded_prior.shape_bank``.

``--meshes PACK --out FILE`` takes the train split of a pack of meshes (``data.mesh_pack``), the
surfaces alone. The package's bank holds shapes that are free of any condition (CC0).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from gscomplete.priors.embedded.weights import packaged_weights
from gscomplete.shape.bank.store import BANK_CELLS, BANK_FILE, ShapeName, write_bank
from gscomplete.util.arrays import BoolArray
from recipes.entry_point import start
from recipes.train_embedded_prior.data.mesh_pack import PackMesh, read_manifest, read_mesh
from splatcomplete_data.mesh.discs import sample_triangles

_SAMPLES = 30_000


@dataclass(frozen=True)
class Options:
    """Pack the surfaces of meshes."""

    meshes: Path
    """Folder of the pack of meshes."""
    out: Path = packaged_weights() / BANK_FILE
    """File to write; the default is the package's own."""
    split: str = "train"
    licences: tuple[str, ...] = ("CC0-1.0",)
    """Shapes under other licences are left out."""


def surface_cells(mesh: PackMesh) -> BoolArray:  # [C, C, C]
    """Mark the cells of a mesh's own box cube that its surface passes."""
    triangles = mesh.vertices[mesh.faces]
    face, weights = sample_triangles(triangles, _SAMPLES, 1)
    points = np.einsum("nk,nkc->nc", weights, triangles[face])
    cell = np.clip((points + 0.5) * BANK_CELLS, 0, BANK_CELLS - 1).astype(np.int64)
    cells = np.zeros((BANK_CELLS,) * 3, bool)
    cells[tuple(cell.T)] = True
    return cells


def main(options: Options) -> None:
    """Read, mark, write."""
    entries = [
        entry
        for entry in read_manifest(options.meshes)
        if entry.split == options.split and entry.licence in options.licences
    ]
    surfaces = [
        surface_cells(read_mesh(options.meshes, entry))
        for entry in track(entries, "shapes", console=Console(file=sys.stderr))
    ]
    names = [ShapeName(entry.id, entry.noun, entry.caption) for entry in entries]
    write_bank(options.out, names, surfaces)
    size = options.out.stat().st_size / 1e6
    sys.stdout.write(f"{len(names)} shapes, {size:.1f} MB: {options.out}\n")


if __name__ == "__main__":
    start(main, Options, __doc__)
