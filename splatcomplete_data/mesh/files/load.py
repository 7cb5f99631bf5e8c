"""Mesh files to coloured triangles, by way of trimesh, and those to discs.

Conventions
-----------
* Every format trimesh reads; ``parts`` says how colours, textures and alpha are read. Of a mesh too
  far from the origin for float32, ``Mesh.offset`` is taken away (``points``).
* Textures larger than ``MAX_TEXTURE_PX`` are box-filtered down: splats are far coarser than texels.
* Losses that trimesh hardly reports are recorded in ``Mesh.notes`` and counts: textures that are
  missing or unreadable, Draco geometry, triangles that are not finite or have no area.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from trimesh.resolvers import Resolver

from gscomplete.errors import UserError
from gscomplete.splats import Splats
from gscomplete.util.arrays import Float32Array, Float64Array, IntArray
from gscomplete.util.file_names import shown_name
from gscomplete.util.parse import is_text
from gscomplete.views import UpAxis, up_rotation
from splatcomplete_data.mesh.discs import (
    discs_at,
    sample_triangles,
    triangle_areas_and_normals,
)
from splatcomplete_data.mesh.files import file_checks
from splatcomplete_data.mesh.files.parts import MeshPart, PartReader
from splatcomplete_data.mesh.files.side_files import (
    beside,
    material_libraries,
    side_files,
    without_options,
)
from splatcomplete_data.mesh.files.textures import open_image
from splatcomplete_data.named_files import Reach
from splatcomplete_data.points import Offset, offset_for_float32

GltfColors = Literal["linear", "srgb"]
"""What the numbers of a glTF's colour factors are; ``srgb`` for exporters that got it wrong."""

_ABOVE_Z_UP = (0.5, -0.35, 0.8)
"""Where the soft light comes from, z up."""
MAX_TEXTURE_PX = 1024
"""Larger textures are reduced to this side before sampling."""


@dataclass(frozen=True, slots=True)
class BakedLight:
    """A distant light whose shading is multiplied into the colours, as a photo would show it."""

    direction: tuple[float, float, float]
    """Towards the light, in the file's frame; need not be unit."""
    strength: float = 0.4
    """How much darker than its colour a surface facing away gets, in [0, 1]."""

    @classmethod
    def from_above(cls, up: UpAxis) -> BakedLight:
        """Return the soft light of ``--light``, for a file whose axis ``up`` points up."""
        x, y, z = (up_rotation(up).T @ torch.tensor(_ABOVE_Z_UP, dtype=torch.float64)).tolist()
        return cls((x, y, z))

    def shade(self, normals: NDArray[np.floating]) -> Float32Array:  # [N, 3] unit, outward -> [N]
        """Return the factor on the colours: 1 towards the light, 1 - strength away from it."""
        direction = np.asarray(self.direction, np.float64)
        cosine = normals @ (direction / np.linalg.norm(direction))
        return (1.0 - self.strength * (0.5 - 0.5 * cosine)).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Mesh:
    """A mesh file's surface, ready for sampling."""

    parts: tuple[MeshPart, ...]
    notes: tuple[str, ...] = ()
    """What a user should know about the file, such as a texture that is missing."""
    degenerate: int = 0
    """Triangles without area, left out."""
    non_finite: int = 0
    """Triangles with coordinates that are not finite, left out."""
    offset: Offset | None = None
    """Taken from the file's coordinates; None = nothing."""

    @property
    def triangles(self) -> int:
        """Number of triangles of all parts."""
        return sum(len(part.vertices) for part in self.parts)

    def bounds(self) -> tuple[Float64Array, Float64Array]:
        """Return the corners [3] of the axis-aligned box."""
        corners = np.concatenate([part.vertices.reshape(-1, 3) for part in self.parts])
        return corners.min(axis=0).astype(np.float64), corners.max(axis=0).astype(np.float64)

    def colors_at(
        self,
        triangle: IntArray,  # [N] index into all parts' triangles
        weights: Float32Array,  # [N, 3] barycentric
    ) -> Float32Array:  # [N, 4]
        """Return sRGB and alpha at surface points."""
        rgba, first = np.empty((len(triangle), 4), np.float32), 0
        for part in self.parts:
            last = first + len(part.vertices)
            inside = (triangle >= first) & (triangle < last)
            rgba[inside] = part.colors_at(triangle[inside] - first, weights[inside])
            first = last
        return rgba


def load_mesh(
    path: Path,
    *,
    texture: Path | None = None,
    gltf_colors: GltfColors = "linear",
    max_texture_px: int = MAX_TEXTURE_PX,
    allow_outside: Path | None = None,
) -> Mesh:
    """Read a mesh file.

    Args:
        path: the file; materials, textures and buffers are found through it.
        texture: image that replaces the base colour of every part, for files that lost theirs.
        gltf_colors: how a glTF's factors and vertex colours are to be read.
        max_texture_px: larger textures are reduced to this side.
        allow_outside: folder below which files that the mesh names are read, too; None = only
            those below its own folder. Others are listed in notes.

    Raises:
        UserError: the file cannot be read, has no surface (a Draco-compressed file without a
            decoder gives one point), or no texture coordinates for ``texture``.
    """
    if not path.is_file():
        raise UserError(
            f"{path}: expected a mesh file, found {'a folder' if path.is_dir() else 'none'}"
        )
    if path.stat().st_size == 0:
        raise UserError(f"{path}: expected a mesh file, found an empty file")
    file_checks.check_suffix(path)
    file_checks.check_not_splats(path)
    file_checks.refuse_unknown_geometry(path)
    reach = Reach.of(path, allow_outside)
    try:
        resolver = _NamedFiles(path, reach)
        with np.errstate(all="ignore"):  # of coordinates that no integer holds
            scene, lost = _load_scene(path, resolver)
    except Exception as error:  # trimesh raises whatever its format readers happen to raise
        raise UserError(f"{path}: cannot read it as a mesh ({error})") from error
    is_gltf = path.suffix.lower() in file_checks.GLTF_SUFFIXES
    reader = PartReader(path, is_gltf and gltf_colors == "linear", max_texture_px, reach)
    if texture is not None:
        reader.override = reader.texture_array(open_image(texture), True)
    try:
        if is_gltf:
            reader.read_numbers(scene)
        reader.offset = _offset(reader.placed(scene))
        parts = tuple(reader.parts(scene))
        reader.non_finite += sum(lost[scene.graph[node][1]] for node in scene.graph.nodes_geometry)
    except (ValueError, IndexError, TypeError, KeyError, AttributeError) as error:
        # faces, coordinates or colours of a damaged file that trimesh did not check
        raise UserError(f"{path}: damaged: its parts do not fit together ({error})") from error
    if not parts:
        found = f"{reader.degenerate} without area, {reader.non_finite} not finite"
        raise UserError(
            f"{path}: expected a surface, found no usable triangle ({found}; a point cloud?)"
        )
    if texture is not None and not any(part.uv is not None for part in parts):
        raise UserError(
            f"{path}: --texture: expected a mesh with texture coordinates to lay {texture} on, "
            "found none"
        )
    lost_files = file_checks.lost_files(path, reach, with_pictures=texture is None)
    notes = [*lost_files, *dict.fromkeys(reader.notes)]
    return Mesh(parts, tuple(notes), reader.degenerate, reader.non_finite, reader.offset)


def mesh_to_discs(
    mesh: Mesh,
    count: int,
    seed: int = 0,
    *,
    light: BakedLight | None = None,
) -> Splats:
    """Cover a mesh with about ``count`` oriented discs (fewer where textures are cut out).

    Args:
        mesh: the surface.
        count: number of splats.
        seed: seed of the sampling.
        light: shading to multiply in, for meshes of flat colours; None = the colours as they are.

    Raises:
        UserError: nothing of the mesh is opaque.
    """
    vertices = np.concatenate([part.vertices for part in mesh.parts])
    triangle, weights = sample_triangles(vertices, count, seed)
    areas, normals = triangle_areas_and_normals(vertices.astype(np.float64))
    rgba = mesh.colors_at(triangle, weights)
    kept = rgba[:, 3] >= 0.5
    if not kept.any():
        raise UserError("mesh_to_discs: the mesh is transparent everywhere")
    points = np.einsum("nk,nkc->nc", weights, vertices[triangle])
    spacing = float(np.sqrt(areas.sum() / count))
    unit = normals[triangle] / np.linalg.norm(normals[triangle], axis=1, keepdims=True)
    colors = np.clip(rgba[:, :3], 0.0, 1.0)
    if light is not None:
        colors *= light.shade(unit)[:, None]
    return discs_at(points[kept], unit[kept].astype(np.float32), colors[kept], spacing)


class _NamedFiles(Resolver):
    """Finds the files that a mesh names, also where trimesh does not understand the name."""

    def __init__(self, path: Path, reach: Reach) -> None:
        self.path, self.reach = path, reach
        self.file_path, self.file_name = str(path), shown_name(path.name)

    @functools.cached_property
    def libraries(self) -> dict[str, Path]:
        """The material libraries of an OBJ; trimesh asks for the first line's alone."""
        return material_libraries(self.path) if self.path.suffix.lower() == ".obj" else {}

    @functools.cached_property
    def named(self) -> dict[str, Path]:
        """The files by the names in the mesh file."""
        return side_files(self.path, self.reach)

    def get(self, name: str) -> bytes:
        """Return a file's bytes.

        Raises:
            FileNotFoundError: there is no such file, or it may not be read.
        """
        if len(self.libraries) > 1 and name.strip().lower().endswith(".mtl"):
            found = [f.read_bytes() for f in self.libraries.values() if self.reach.reads(f)]
            if found:
                return b"\n".join(found)
        plain = beside(self.path, name)
        places = [plain, self.path.parent / name.strip(), self.path.parent / plain.name]
        if without_options(name) in self.named:
            places.append(self.named[without_options(name)])
        for place in places:
            if self.reach.reads(place):
                return place.read_bytes()
        refusal = self.reach.refusal(plain) or "is missing"
        raise FileNotFoundError(f"file {name} {refusal}")

    def keys(self) -> list[str]:
        """List the files that the mesh names."""
        return list(self.named)

    def namespaced(self, namespace: str) -> _NamedFiles:
        """Return this: names are relative to the mesh, whatever asks."""
        return self

    def write(self, name: str, data: str | bytes) -> None:
        """Refuse: nothing is written here."""
        raise PermissionError(name)


def _load_scene(path: Path, resolver: Resolver) -> tuple[Any, Counter[str]]:
    """Load a scene as trimesh does by default, and count what that drops.

    Returns:
        The scene, and by geometry the faces with vertices that are not finite, which are gone;
        those of COLLADA files, which trimesh always drops, are not counted.
    """
    lost: Counter[str] = Counter()
    if path.suffix.lower() in file_checks.GLTF_SUFFIXES:  # of these trimesh drops none
        return _load_file(path, resolver), lost
    scene = _load_file(path, resolver, process=False)
    for name, geometry in scene.geometry.items():
        if isinstance(geometry, trimesh.Trimesh):
            faces = len(geometry.faces)
            geometry.process()
            lost[name] = faces - len(geometry.faces)
    return scene, lost


def _load_file(path: Path, resolver: Resolver, **more: Any) -> Any:
    """Load a scene; trimesh names parts after a file and encodes the names, which may fail."""
    if is_text(path.name):
        return trimesh.load_scene(str(path), resolver=resolver, **more)
    with path.open("rb") as stream:
        return trimesh.load_scene(stream, file_type=path.suffix[1:], resolver=resolver, **more)


def _offset(placed: Iterator[tuple[str, Float64Array]]) -> Offset | None:
    """Choose what is taken from the coordinates of all meshes of a file."""
    lows, highs = [], []
    for _, corners in placed:
        points = corners.reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) > 0:
            lows.append(points.min(axis=0))
            highs.append(points.max(axis=0))
    return offset_for_float32(np.min(lows, axis=0), np.max(highs, axis=0)) if lows else None
