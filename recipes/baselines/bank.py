"""A bank of meshes to retrieve from: ``python -m recipes.baselines.bank --meshes PACK --out FILE``.

Conventions
-----------
* The bank holds ``POINTS`` coloured points of every object of the pack's ``train`` split: z up, box
  centred, largest side 1. It is one ``.npz`` file; retrieval does not need the pack.
* The distance of an object from P adds the mean distance of P's points to the object's and that of
  the nearer half of the object's points to P's. It counts place and colour, and is the least over
  turns about the up axis.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.spatial import cKDTree

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float32Array
from gscomplete.util.atomic import atomic_path
from recipes.entry_point import start
from recipes.train_embedded_prior.data.mesh_pack import read_manifest, read_mesh
from recipes.train_embedded_prior.procedural.quads import turn_about
from splatcomplete_data.mesh.discs import sample_triangles

POINTS = 4096
"""Points of an object; a random order lets the first of them stand for all."""
_FEW = 96
_TURNS = 16
_COLOR_LENGTH = 0.1
"""Length that black and white are apart."""
_NEAREST_SHARE = 0.5


@dataclass(frozen=True)
class Options:
    """Sample the meshes of a pack's train split into a bank."""

    meshes: Path
    """Folder of the pack of meshes."""
    out: Path
    """File to write, ``.npz``."""
    objects: int = 500
    """Number of meshes, evenly spread over the list; those without colours are left out."""


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """Objects to retrieve."""

    ids: tuple[str, ...]
    points: Float32Array  # [N, POINTS, 3]
    colors: Float32Array  # [N, POINTS, 3] in [0, 1]


@dataclass(frozen=True, slots=True, eq=False)
class Retrieved:
    """The nearest object, turned as it is nearest."""

    id: str
    points: Float32Array  # [POINTS, 3]
    colors: Float32Array  # [POINTS, 3]
    distance: float


def make_bank(options: Options) -> Bank:
    """Sample the meshes.

    Raises:
        UserError: there is no manifest, or a mesh cannot be read.
    """
    rows = [e for e in read_manifest(options.meshes) if e.split == "train" and e.colour != "none"]
    step = max(1.0, len(rows) / options.objects)
    chosen = [rows[int(k * step)] for k in range(min(options.objects, len(rows)))]
    order = np.random.default_rng(0).permutation(POINTS)
    points, colors = [], []
    for entry in track(chosen, "meshes", console=Console(file=sys.stderr)):
        mesh = read_mesh(options.meshes, entry)
        triangles = mesh.vertices[mesh.faces]
        face, weights = sample_triangles(triangles, POINTS, 0)
        points.append(np.einsum("nk,nkc->nc", weights, triangles[face])[order])
        colors.append(mesh.colors_at(face, weights)[order])
    return Bank(tuple(entry.id for entry in chosen), np.stack(points), np.stack(colors))


def write_bank(bank: Bank, path: Path) -> None:
    """Write a bank."""
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(
            stream,
            ids=np.array(bank.ids),
            points=bank.points.astype(np.float16),
            colors=(bank.colors * 255 + 0.5).clip(0, 255).astype(np.uint8),
        )


def read_bank(path: Path) -> Bank:
    """Read a bank.

    Raises:
        UserError: there is none, or it is damaged.
    """
    try:
        with np.load(path) as stored:
            points = stored["points"].astype(np.float32)
            colors = stored["colors"].astype(np.float32) / 255
            return Bank(tuple(map(str, stored["ids"])), points, colors)
    except (OSError, KeyError, ValueError) as error:
        made = "python -m recipes.baselines.bank --meshes PACK --out FILE"
        raise UserError(f"{path}: --bank: expected a bank of {made}: {error}") from error


def nearest(bank: Bank, points: Float32Array, colors: Float32Array) -> Retrieved:
    """Retrieve the object nearest to a part.

    Args:
        bank: objects.
        points: [N, 3] of P in the object frame, in random order.
        colors: [N, 3] of P.
    """
    part = _joint(points[:_FEW], colors[:_FEW])
    tree = cKDTree(_joint(points[:POINTS], colors[:POINTS]))
    turns = [turn_about("z", 360.0 * k / _TURNS).astype(np.float32) for k in range(_TURNS)]
    found = (math.inf, 0, 0)
    for number in range(len(bank.ids)):
        few, paint = bank.points[number, :_FEW], bank.colors[number, :_FEW]
        object_tree = cKDTree(_joint(bank.points[number, :512], bank.colors[number, :512]))
        for index, turn in enumerate(turns):
            away, _ = tree.query(_joint(few @ turn.T, paint))
            near = np.sort(away)[: int(_NEAREST_SHARE * len(away))].mean()
            if near >= found[0]:
                continue
            back = part.copy()
            back[:, :3] = part[:, :3] @ turn
            cost = float(near + object_tree.query(back)[0].mean())
            found = min(found, (cost, number, index))
    cost, number, index = found
    return Retrieved(
        bank.ids[number], bank.points[number] @ turns[index].T, bank.colors[number], cost
    )


def _joint(points: Float32Array, colors: Float32Array) -> Float32Array:  # [N, 6]
    return np.concatenate([points, _COLOR_LENGTH * colors], axis=1)


def main(options: Options) -> None:
    """Make the bank."""
    write_bank(make_bank(options), options.out)
    sys.stdout.write(f"written: {options.out}\n")


if __name__ == "__main__":
    start(main, Options, __doc__)
