"""Read packs of coloured training meshes: a manifest and one ``.npz`` an object.

Conventions
-----------
* z up, right-handed, box centred, longest side 1. Colours are sRGB in [0, 1].
* Fields of an object: ``v`` uint16 [V, 3] in steps of ``ext`` / 4095 from a corner, ``f`` [F, 3];
  ``fc`` [F] indices into the palette ``pal`` uint8 [K, 3], one colour a face; or ``tex``, the bytes
  of a square picture in which every two faces share a block of ``s`` x ``s`` px, row by row.
* ``MANIFEST.tsv`` names, for each object, its id (the file's path without ending), split, noun,
  caption, source, licence, author and colour (``none`` where only the shape is known). Authors
  taken from XML carry what stood before their name.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float32Array, IntArray

MANIFEST = "MANIFEST.tsv"
STEPS = 4095
"""Of a box side, from corner to corner."""


@dataclass(frozen=True, slots=True)
class PackEntry:
    """One row of the manifest."""

    id: str
    split: str
    noun: str
    caption: str
    source: str
    licence: str
    author: str
    colour: str

    @property
    def number(self) -> int:
        """The end of the id as a number: a seed."""
        return int.from_bytes(self.id.encode()[-6:], "little")


@dataclass(frozen=True, slots=True)
class PackMesh:
    """A coloured mesh."""

    vertices: Float32Array  # [V, 3]
    faces: IntArray  # [F, 3]
    face_colors: Float32Array | None  # [F, 3]
    texture: Float32Array | None  # [S, S, 3] top row first
    block_px: int

    def colors_at(
        self,
        face: IntArray,  # [N]
        weights: Float32Array,  # [N, 3] barycentric
    ) -> Float32Array:  # [N, 3]
        """Return the colours of points on faces."""
        if self.texture is None:
            assert self.face_colors is not None
            return self.face_colors[face]
        corners = _corners_px(face, self.block_px, len(self.texture))
        place = np.einsum("nk,nkc->nc", weights, corners)
        first = np.clip(np.floor(place).astype(np.intp), 0, len(self.texture) - 2)
        x, y = first.T
        right, down = (place - first).astype(np.float32).T[:, :, None]
        upper = self.texture[y, x] * (1 - right) + self.texture[y, x + 1] * right
        lower = self.texture[y + 1, x] * (1 - right) + self.texture[y + 1, x + 1] * right
        mixed: Float32Array = upper * (1 - down) + lower * down
        return mixed


def _corners_px(
    face: IntArray,  # [N]
    block_px: int,
    side_px: int,
) -> Float32Array:  # [N, 3, 2] x, y
    """Return where the corners of faces lie in the texture."""
    row, column = np.divmod(face // 2, side_px // block_px)
    reach = block_px - 2
    lower = np.array([[0, 0], [reach, 0], [0, reach]], np.float32)
    corners = np.where((face % 2 == 0)[:, None, None], lower, (block_px - 1) - lower)
    origin = np.stack([column, row], axis=1)[:, None] * block_px
    return (corners + origin).astype(np.float32)


def read_manifest(folder: Path) -> list[PackEntry]:
    """Return the rows of a pack's manifest.

    Raises:
        UserError: there is no manifest, or a column is missing.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise UserError(f"{path}: expected the manifest of a pack of meshes, found no file")
    names = PackEntry.__dataclass_fields__
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE)
        missing = set(names) - set(reader.fieldnames or ())
        if missing:
            raise UserError(f"{path}: expected the columns {sorted(missing)}, found none of them")
        return [PackEntry(**{name: row[name] for name in names}) for row in reader]


def read_mesh(folder: Path, entry: PackEntry) -> PackMesh:
    """Read one object of a pack.

    Raises:
        UserError: the file is missing or lacks a field.
    """
    path = folder / f"{entry.id}.npz"
    try:
        with np.load(path) as stored:
            extent = stored["ext"]
            vertices = (stored["v"].astype(np.float32) / STEPS - 0.5) * extent
            faces = stored["f"].astype(np.int64)
            if "tex" in stored:
                picture = Image.open(io.BytesIO(stored["tex"].tobytes())).convert("RGB")
                texture = np.asarray(picture, np.float32) / 255
                return PackMesh(vertices, faces, None, texture, int(stored["s"]))
            colors = stored["pal"][stored["fc"]].astype(np.float32) / 255
            return PackMesh(vertices, faces, colors, None, 0)
    except (OSError, KeyError, ValueError) as error:
        raise UserError(f"{path}: expected an object of a pack of meshes: {error}") from None
