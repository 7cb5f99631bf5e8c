"""Reduce a mesh to what a pack holds of an object, and write it; ``mesh_pack`` says what that is.

Conventions
-----------
* A mesh with few enough faces keeps them. Others are decimated (MeshLab, quadric errors). A point
  of a new face gets the mean colour of the nearest samples of the old surface that face the same
  way.
* Nearly transparent faces are left out and counted.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float32Array, Float64Array, IntArray
from gscomplete.util.atomic import atomic_path
from gscomplete.util.optional import import_optional
from recipes.train_embedded_prior.data.mesh_pack import STEPS
from splatcomplete_data.mesh.discs import sample_triangles, triangle_areas_and_normals
from splatcomplete_data.mesh.files.load import Mesh
from splatcomplete_data.mesh.files.parts import GREY

MOST_FACES = 8000
"""With more faces, the block of the texture that two faces share would be smaller than 4 px."""
_TEXTURE_PX, _LARGEST_BLOCK_PX = 256, 64
"""Largest sides of the texture and of a block."""
_MERGED = 2e-5
"""Corners in the same cell of a grid with this spacing become one vertex, object sizes."""
_LEAST_ALPHA = 0.1
"""Faces with a smaller mean alpha are left out."""
_SAMPLES, _NEAREST, _MEAN_OF = 200_000, 6, 3
"""Samples of the old surface; how many of the nearest are compared; how many of these are averaged:
those that are nearest when their facing counts as well."""
_FACING = 0.01
"""A sample that faces at a right angle counts as this much farther away, object sizes."""
_FLAT = 0.02
"""A face whose colours differ from their mean by less is stored with one colour."""
_JPEG_QUALITY = 92


@dataclass(frozen=True, slots=True)
class PackedMesh:
    """The fields of an object's file, and what the manifest says about the object."""

    fields: dict[str, Any]
    """Arrays by name, as ``mesh_pack`` reads them."""
    colour: str
    """``texture``, ``flat`` (several plain colours), ``single``, or ``none`` (no colours given)."""
    faces: int
    faces_source: int
    see_through: int
    """Faces of the source that were left out."""
    side: float
    """Longest side in the file's units."""


@dataclass(frozen=True, slots=True)
class _Texels:
    """The N texels of all faces."""

    face: IntArray  # [N]
    weights: Float32Array  # [N, 3] barycentric
    row: IntArray  # [N] row in the picture
    column: IntArray  # [N]
    block_px: int
    side_px: int


def packed(
    mesh: Mesh,
    upright: Float64Array,  # [3, 3] turns the file's axes into z-up ones
    most_faces: int,
) -> PackedMesh:
    """Turn a mesh z up, centre its box, scale its longest side to 1, and reduce it to few faces.

    Its colours become a small texture or a palette.

    Args:
        mesh: the surface, as read.
        upright: a rotation.
        most_faces: a mesh with more faces is decimated to about so many.

    Raises:
        UserError: the mesh is transparent, or cannot be decimated to ``MOST_FACES``.
    """
    source = np.concatenate([part.vertices for part in mesh.parts]).astype(np.float64) @ upright.T
    seen = np.flatnonzero(_alphas(mesh) >= _LEAST_ALPHA)
    if not len(seen):
        raise UserError("expected a surface, found a transparent one")
    low, high = source[seen].min(axis=(0, 1)), source[seen].max(axis=(0, 1))
    side = float((high - low).max())
    source = (source - (low + high) / 2) / side
    vertices, faces, kept = _merged(source[seen])
    reduced = len(faces) > most_faces
    if reduced:
        vertices, faces = _decimated(vertices, faces, most_faces)
    if not 0 < len(faces) <= MOST_FACES:
        raise UserError(f"expected at most {MOST_FACES:,} faces, could not reduce {len(faces):,}")
    texels = _texels(len(faces))
    if reduced:
        colors = _nearest_colors(mesh, source, seen, vertices[faces], texels)
    else:
        colors = mesh.colors_at(seen[kept][texels.face], texels.weights)[:, :3]
    colour, stored = _stored_colors(np.clip(colors, 0.0, 1.0), texels, len(faces))
    if all(part.texture is None and (part.colors == GREY).all() for part in mesh.parts):
        colour = "none"
    extent = np.ptp(vertices, axis=0)
    steps = (vertices - vertices.min(axis=0)) / np.maximum(extent, 1e-9) * STEPS
    fields = {
        "v": np.rint(steps).astype(np.uint16),
        "ext": (extent / extent.max()).astype(np.float32),
        "f": faces.astype(np.uint16),
        **stored,
    }
    return PackedMesh(fields, colour, len(faces), len(source), len(source) - len(seen), side)


def write_packed(path: Path, mesh: PackedMesh, *, unit_m: float, made_of: str) -> None:
    """Write an object's file, whole or not at all.

    Args:
        path: the file; its folder is made.
        mesh: the object.
        unit_m: unit of the mesh file in metres; NaN = not known.
        made_of: digest of what the object is made of, stored in the file.

    Raises:
        UserError: it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    told = {"colour": mesh.colour, "faces_source": mesh.faces_source, "made_of": made_of}
    size_m = np.float32(mesh.side * unit_m)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **mesh.fields, **told, size_m=size_m)


def _alphas(mesh: Mesh) -> Float32Array:  # [T]
    """Return the mean alpha of every face."""
    faces = np.arange(mesh.triangles)
    weights = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]], np.float32)
    weights /= weights.sum(axis=1, keepdims=True)
    every = [mesh.colors_at(faces, np.tile(row, (len(faces), 1)))[:, 3] for row in weights]
    mean: Float32Array = np.mean(every, axis=0)
    return mean


def _merged(
    corners: Float64Array,  # [T, 3, 3]
) -> tuple[Float64Array, IntArray, IntArray]:  # [V, 3], [F, 3], [F]
    """Merge corners in the same place; return vertices, faces, and the triangle of each face.

    Triangles that lose a corner by it are left out.
    """
    places = np.rint(corners.reshape(-1, 3) / _MERGED).astype(np.int64)
    _, first, index = np.unique(places, axis=0, return_index=True, return_inverse=True)
    faces = index.reshape(-1, 3)
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return corners.reshape(-1, 3)[first], faces[whole], np.flatnonzero(whole)


def _decimated(
    vertices: Float64Array,  # [V, 3]
    faces: IntArray,  # [F, 3]
    count: int,
) -> tuple[Float64Array, IntArray]:
    """Decimate a mesh to about so many faces; return its vertices and faces.

    Raises:
        UserError: pymeshlab is missing or failed.
    """
    meshlab = import_optional("pymeshlab", "the decimation of meshes")
    meshes = meshlab.MeshSet()
    meshes.add_mesh(meshlab.Mesh(vertices, faces))
    try:
        meshes.apply_filter(
            "meshing_decimation_quadric_edge_collapse",
            targetfacenum=count,
            preserveboundary=True,
            preservenormal=True,
            planarquadric=True,
        )
        meshes.apply_filter("meshing_remove_unreferenced_vertices")
    except meshlab.PyMeshLabException as error:
        raise UserError(f"MeshLab cannot decimate it ({str(error).strip()})") from error
    mesh = meshes.current_mesh()
    return mesh.vertex_matrix(), mesh.face_matrix().astype(np.int64)


def _texels(faces: int) -> _Texels:
    """Lay out a picture for so many faces, two per block, as ``mesh_pack`` reads it."""
    columns = math.ceil(math.sqrt(math.ceil(faces / 2)))
    block = min(_TEXTURE_PX // columns, _LARGEST_BLOCK_PX)
    y, x = (axis.reshape(-1) for axis in np.mgrid[:block, :block])
    is_upper = x + y >= block
    across, down = (np.where(is_upper, block - 1 - axis, axis) / (block - 2) for axis in (x, y))
    weights = np.clip(np.stack([1 - across - down, across, down], axis=1), 0, None)
    weights /= weights.sum(axis=1, keepdims=True)
    number = np.arange(math.ceil(faces / 2))
    face = 2 * number[:, None] + is_upper
    corner_row, corner_column = (n[:, None] * block for n in np.divmod(number, columns))
    used = face < faces
    every = (np.broadcast_to(a, face.shape)[used] for a in (corner_row + y, corner_column + x))
    row, column = every
    shape = (*face.shape, 3)
    spread = np.broadcast_to(weights, shape)[used].astype(np.float32)
    return _Texels(face[used], spread, row, column, block, columns * block)


def _nearest_colors(
    mesh: Mesh,
    source: Float64Array,  # [T, 3, 3] triangles of the mesh, as placed in the pack
    seen: IntArray,  # [S] numbers of the triangles that are not left out
    corners: Float64Array,  # [F, 3, 3] corners of the decimated faces
    texels: _Texels,
) -> Float32Array:  # [N, 3]
    """Return mean colours of the nearest places of the old surface that face the same way."""
    triangle, weights = sample_triangles(source[seen].astype(np.float32), _SAMPLES, 1)
    colors = mesh.colors_at(seen[triangle], weights)[:, :3]
    places = np.einsum("nk,nkc->nc", weights, source[seen[triangle]])
    facing = _units(source[seen])[triangle]
    asked = np.einsum("nk,nkc->nc", texels.weights, corners[texels.face])
    distance, index = cKDTree(places).query(asked, k=_NEAREST)
    cosine = np.einsum("nkc,nc->nk", facing[index], _units(corners)[texels.face])
    order = np.argsort(distance + _FACING * (1 - cosine), axis=1)[:, :_MEAN_OF]
    mean: Float32Array = colors[np.take_along_axis(index, order, axis=1)].mean(axis=1)
    return mean


def _units(corners: Float64Array) -> Float64Array:  # [F, 3, 3] -> [F, 3]
    """Return the unit normals of triangles; zero for triangles without area."""
    _, normals = triangle_areas_and_normals(corners)  # type: ignore[arg-type]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.maximum(length, 1e-30), np.float64)


def _stored_colors(
    colors: Float32Array,  # [N, 3] of the texels
    texels: _Texels,
    faces: int,
) -> tuple[str, dict[str, Any]]:
    """Return the kind of the colours (``PackedMesh.colour``) and the fields that hold them."""
    counts = np.bincount(texels.face, minlength=faces)
    sums = [np.bincount(texels.face, channel, minlength=faces) for channel in colors.T]
    means = np.stack(sums, axis=1) / counts[:, None]
    if float(np.abs(colors - means[texels.face]).max()) < _FLAT:
        if float(np.ptp(means, axis=0).max()) < _FLAT:
            means = np.broadcast_to(means.mean(axis=0), means.shape)
        rounded = np.rint(means * 255).astype(np.uint8)
        palette, index = np.unique(rounded, axis=0, return_inverse=True)
        fields = {"pal": palette, "fc": index.reshape(-1).astype(np.uint16)}
        return ("single" if len(palette) == 1 else "flat"), fields
    picture = np.full((texels.side_px, texels.side_px, 3), 128, np.uint8)
    picture[texels.row, texels.column] = np.rint(colors * 255).astype(np.uint8)
    stored = io.BytesIO()
    Image.fromarray(picture).save(stored, "JPEG", quality=_JPEG_QUALITY, subsampling=0)
    return "texture", {"tex": np.frombuffer(stored.getvalue(), np.uint8), "s": texels.block_px}
