"""Mesh files to coloured triangles, by way of trimesh.

Conventions
-----------
* Every format trimesh reads; node transforms are applied, so vertices are in the file's frame and
  units. Degenerate and non-finite triangles are dropped. Of a mesh too far from the origin for
  float32, ``Mesh.offset`` is taken away (``points``).
* Colours are sRGB in [0, 1]. glTF factors and vertex colours are linear by its specification and
  converted, unless ``GltfColors`` says that the exporter wrote sRGB into them.
* With a texture, an OBJ's ``Kd`` is ignored (as by most viewers; exporters leave 0.8 or 0.4 there
  next to a photo), while a glTF's factor multiplies as specified.
* Texture coordinates are OpenGL's: v upwards, wrapping round, bilinear between texels. Textures
  larger than ``MAX_TEXTURE_PX`` are box-filtered down: splats are far coarser than texels.
* Alpha is texture x factor (x vertex alpha) where the material says so. Cut-outs (glTF MASK) are
  kept where it reaches the material's cutoff; blended surfaces (BLEND) keep it as opacity.
* What trimesh drops almost silently is noticed: textures that are missing or unreadable, Draco
  geometry, triangles that are not finite or have no area. ``Mesh.notes`` and the counts tell.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.resolvers import FilePathResolver

from gscomplete.errors import UserError
from gscomplete.splats import Splats
from splatcomplete_data.mesh import file_checks
from splatcomplete_data.mesh.discs import (
    DiscSettings,
    discs_at,
    sample_triangles,
    triangle_areas_and_normals,
)
from splatcomplete_data.mesh.gltf_uv import own_coordinates
from splatcomplete_data.mesh.side_files import side_files, without_options
from splatcomplete_data.mesh.textures import (
    as_srgb,
    open_image,
    sample_texture,
    texture_array,
    unit_colors,
    unit_rgb,
)
from splatcomplete_data.pictures import UNREADABLE
from splatcomplete_data.points import Offset, offset_for_float32

FloatArray = NDArray[np.float32]
GltfColors = Literal["linear", "srgb"]
"""What the numbers of a glTF's colour factors are; ``srgb`` for exporters that got it wrong."""

MAX_TEXTURE_PX = 1024
"""Larger textures are reduced to this side before sampling."""
GREY = 0.7
"""Colour of a surface without any."""
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class BakedLight:
    """A distant light whose shading is multiplied into the colours, as a photo would show it."""

    direction: tuple[float, float, float]
    """Towards the light, in the file's frame; need not be unit."""
    strength: float = 0.4
    """How much darker than its colour a surface facing away gets, in [0, 1]."""

    def shade(self, normals: NDArray[np.floating]) -> FloatArray:  # [N, 3] unit, outward -> [N]
        """Return the factor on the colours: 1 towards the light, 1 - strength away from it."""
        direction = np.asarray(self.direction, np.float64)
        cosine = normals @ (direction / np.linalg.norm(direction))
        return (1.0 - self.strength * (0.5 - 0.5 * cosine)).astype(np.float32)


@dataclass(frozen=True, slots=True)
class MeshPart:
    """Triangles of one material: corner colours times an optional texture."""

    vertices: FloatArray  # [T, 3, 3] corners, file frame
    colors: FloatArray  # [T, 3, 3] sRGB in [0, 1] at the corners
    uv: FloatArray | None = None  # [T, 3, 2]
    texture: FloatArray | None = None  # [H, W, 4] sRGB and alpha in [0, 1], top row first
    alpha: float = 1.0  # factor on the texture's alpha
    blended: bool = False  # True = alpha is opacity; False = what is below 1/2 is cut out

    def colors_at(
        self,
        triangle: NDArray[np.int64],  # [N]
        weights: FloatArray,  # [N, 3] barycentric
    ) -> FloatArray:  # [N, 4]
        """Return sRGB and alpha at surface points."""
        rgba = np.ones((len(triangle), 4), np.float32)
        rgba[:, :3] = np.einsum("nk,nkc->nc", weights, self.colors[triangle])
        if self.uv is not None and self.texture is not None:
            uv = np.einsum("nk,nkc->nc", weights, self.uv[triangle])
            rgba *= sample_texture(self.texture, uv)
        rgba[:, 3] *= self.alpha
        return rgba


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

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the corners [3] of the axis-aligned box."""
        corners = np.concatenate([part.vertices.reshape(-1, 3) for part in self.parts])
        return corners.min(axis=0).astype(np.float64), corners.max(axis=0).astype(np.float64)


def load_mesh(
    path: Path,
    *,
    texture: Path | None = None,
    gltf_colors: GltfColors = "linear",
    max_texture_px: int = MAX_TEXTURE_PX,
) -> Mesh:
    """Read a mesh file.

    Args:
        path: the file; materials and textures are found through it, also outside its folder.
        texture: image that replaces the base colour of every part, for files that lost theirs.
        gltf_colors: how a glTF's factors and vertex colours are to be read.
        max_texture_px: larger textures are reduced to this side.

    Raises:
        UserError: the file cannot be read, or has no surface (a Draco-compressed file without a
            decoder gives one point).
    """
    if not path.is_file():
        raise UserError(
            f"{path}: expected a mesh file, found {'a folder' if path.is_dir() else 'none'}"
        )
    if path.stat().st_size == 0:
        raise UserError(f"{path}: expected a mesh file, found an empty file")
    file_checks.check_not_splats(path)
    file_checks.refuse_draco(path)
    try:
        resolver = _NamedFiles(str(path), allow_anywhere=True)
        scene = trimesh.load_scene(str(path), resolver=resolver)
    except Exception as error:  # trimesh raises whatever its format readers happen to raise
        raise UserError(f"{path}: cannot read it as a mesh ({error})") from error
    is_gltf = path.suffix.lower() in file_checks.GLTF_SUFFIXES
    reader = _PartReader(path, is_gltf and gltf_colors == "linear", max_texture_px)
    if texture is not None:
        reader.override = reader.texture_array(open_image(texture), True)
    try:
        if is_gltf:
            reader.read_coordinates(scene)
        reader.offset = _offset(reader.placed(scene))
        parts = tuple(reader.parts(scene))
    except (ValueError, IndexError, TypeError, KeyError, AttributeError) as error:
        # faces, coordinates or colours of a damaged file that trimesh did not check
        raise UserError(f"{path}: damaged: its parts do not fit together ({error})") from error
    if not parts:
        found = f"{reader.degenerate} without area, {reader.non_finite} not finite"
        raise UserError(
            f"{path}: expected a surface, found no usable triangle ({found}; a point cloud?)"
        )
    notes = [*file_checks.lost_files(path), *dict.fromkeys(reader.notes)]
    return Mesh(parts, tuple(notes), reader.degenerate, reader.non_finite, reader.offset)


def mesh_to_discs(
    mesh: Mesh,
    count: int,
    seed: int = 0,
    *,
    settings: DiscSettings | None = None,
    light: BakedLight | None = None,
) -> Splats:
    """Cover a mesh with about ``count`` oriented discs (fewer where textures are cut out).

    Args:
        mesh: the surface.
        count: number of splats.
        seed: seed of the sampling.
        settings: disc shape; None = defaults.
        light: shading to multiply in, for meshes of flat colours; None = the colours as they are.

    Raises:
        UserError: nothing of the mesh is opaque.
    """
    vertices = np.concatenate([part.vertices for part in mesh.parts])
    triangle, weights = sample_triangles(vertices, count, seed)
    areas, normals = triangle_areas_and_normals(vertices.astype(np.float64))
    rgba = np.empty((len(triangle), 4), np.float32)
    first = 0
    for part in mesh.parts:
        last = first + len(part.vertices)
        inside = (triangle >= first) & (triangle < last)
        rgba[inside] = part.colors_at(triangle[inside] - first, weights[inside])
        first = last
    kept = rgba[:, 3] >= 0.5
    if not kept.any():
        raise UserError("mesh_to_discs: the mesh is transparent everywhere")
    points = np.einsum("nk,nkc->nc", weights, vertices[triangle])
    spacing = float(np.sqrt(areas.sum() / count))
    unit = normals[triangle] / np.linalg.norm(normals[triangle], axis=1, keepdims=True)
    colors = np.clip(rgba[:, :3], 0.0, 1.0)
    if light is not None:
        colors *= light.shade(unit)[:, None]
    return discs_at(points[kept], unit[kept].astype(np.float32), colors[kept], spacing, settings)


class _NamedFiles(FilePathResolver):
    """Finds the files that a mesh file names also where trimesh does not understand the name."""

    @functools.cached_property
    def named(self) -> dict[str, Path]:
        """The files by the names in the mesh file."""
        return side_files(Path(self.file_path))

    def get(self, name: str) -> bytes:
        """Return a file's bytes.

        Raises:
            FileNotFoundError: there is no such file.
        """
        try:
            content: bytes = super().get(name)
        except FileNotFoundError:
            file = self.named.get(without_options(name))
            if file is None or not file.is_file():
                raise
            content = file.read_bytes()
        return content


@dataclass(slots=True)
class _PartReader:
    """Turns a loaded scene into parts and notes what is odd on the way."""

    path: Path
    is_linear: bool
    max_texture_px: int
    override: FloatArray | None = None
    notes: list[str] = field(default_factory=list)
    degenerate: int = 0
    non_finite: int = 0
    textures: dict[tuple[int, bool], FloatArray] = field(default_factory=dict)
    coordinates: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """Texture coordinates by geometry, where trimesh's are not those that the file means."""
    offset: Offset | None = None

    def read_coordinates(self, scene: Any) -> None:
        """Read the texture coordinates that trimesh does not read as the file means them."""
        own, geometries = own_coordinates(self.path), scene.geometry
        if len(own) == len(geometries):
            for (name, geometry), uv in zip(geometries.items(), own, strict=True):
                if uv is not None and len(uv) == len(geometry.vertices):
                    self.coordinates[name] = uv
        if len(self.coordinates) < sum(uv is not None for uv in own):
            self.note("texture transforms, further or integer coordinates: some are not applied")

    def placed(self, scene: Any) -> Iterator[tuple[str, NDArray[np.float64]]]:
        """Yield the name and the triangles [T, 3, 3] of every mesh that the scene graph places."""
        for node in scene.graph.nodes_geometry:
            transform, name = scene.graph[node]
            geometry = scene.geometry[name]
            if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces) > 0:
                points = geometry.vertices @ transform[:3, :3].T + transform[:3, 3]
                yield name, points[geometry.faces]

    def parts(self, scene: Any) -> Iterator[MeshPart]:
        """Yield the coloured triangles of every mesh that the scene graph places."""
        for name, corners in self.placed(scene):
            vertices = corners if self.offset is None else corners - self.offset
            with np.errstate(all="ignore"):
                areas, _ = triangle_areas_and_normals(vertices.astype(np.float32))
            finite = np.isfinite(areas)
            kept = finite & (areas > 0)
            self.non_finite += int((~finite).sum())
            self.degenerate += int((finite & ~kept).sum())
            if not kept.any():
                continue
            part = self.appearance(scene.geometry[name], self.coordinates.get(name))
            yield MeshPart(
                vertices[kept].astype(np.float32),
                part.colors[kept],
                None if part.uv is None else part.uv[kept],
                part.texture,
                part.alpha,
                part.blended,
            )

    def appearance(self, geometry: Any, uv: NDArray[np.float64] | None) -> MeshPart:
        """Return colours, texture coordinates and texture of one mesh; its vertices are unused.

        ``uv`` are its texture coordinates where those that it holds are not meant.
        """
        visual, faces = geometry.visual, geometry.faces
        corners = np.ones((len(faces), 3, 3), np.float32)
        if visual.kind == "face":
            return MeshPart(corners, corners * unit_rgb(visual.face_colors)[:, None, :])
        if visual.kind == "vertex":
            colors = as_srgb(unit_rgb(visual.vertex_colors), self.is_linear)
            return MeshPart(corners, colors[faces])
        if visual.kind != "texture":
            return MeshPart(corners, corners * np.float32(GREY))
        uv = getattr(visual, "uv", None) if uv is None else uv
        material = visual.material
        image = self.base_image(material)
        mode = str(getattr(material, "alphaMode", None) or "OPAQUE").upper()
        texture = self.override if uv is not None else None
        if texture is None and image is not None and uv is not None:
            texture = self.texture_array(image, mode != "OPAQUE")
        factor = getattr(material, "baseColorFactor", None)
        alpha = 1.0
        if factor is not None and mode != "OPAQUE" and len(np.atleast_1d(factor)) > 3:
            alpha = float(unit_colors(np.asarray(factor))[3])
        if mode == "MASK":  # scaled so that the material's cutoff lands on 1/2
            cutoff = getattr(material, "alphaCutoff", None)
            alpha *= 0.5 / max(float(0.5 if cutoff is None else cutoff), 1e-3)
        if factor is None and texture is None:
            factor = getattr(material, "diffuse", None)
        if factor is not None and self.override is None:
            corners = corners * as_srgb(unit_rgb(np.asarray(factor)), self.is_linear)
        painted = (getattr(visual, "vertex_attributes", None) or {}).get("color")
        if painted is not None:
            corners = corners * as_srgb(unit_rgb(np.asarray(painted)), self.is_linear)[faces]
        corner_uv = None
        if texture is not None and uv is not None:
            corner_uv = uv[faces].astype(np.float32)
        colors = corners.astype(np.float32)
        return MeshPart(colors, colors, corner_uv, texture, alpha, mode == "BLEND")

    def base_image(self, material: Any) -> Image.Image | None:
        """Return a material's colour image, if it has a real one."""
        image = getattr(material, "baseColorTexture", None)
        if image is None:
            image = getattr(material, "image", None)
        if image is None:
            return None
        if max(image.size) <= 2:
            self.note(f"a texture is a placeholder of {image.size} pixels: missing file?")
        return image

    def note(self, text: str) -> None:
        """Keep a note, and log it."""
        _logger.warning("%s: %s", self.path, text)
        self.notes.append(text)

    def texture_array(self, image: Image.Image, has_alpha: bool) -> FloatArray:  # [H, W, 4]
        """Turn an image into colours in [0, 1], reduced to ``max_texture_px``.

        Raises:
            UserError: the image is damaged.
        """
        key = (id(image), has_alpha)
        if key not in self.textures:
            try:
                self.textures[key] = texture_array(image, has_alpha, self.max_texture_px)
            except UNREADABLE as error:
                raise UserError(f"{self.path}: texture: cannot read it ({error})") from error
        return self.textures[key]


def _offset(placed: Iterator[tuple[str, NDArray[np.float64]]]) -> Offset | None:
    """Choose what is taken from the coordinates of all meshes of a file."""
    lows, highs = [], []
    for _, corners in placed:
        points = corners.reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) > 0:
            lows.append(points.min(axis=0))
            highs.append(points.max(axis=0))
    return offset_for_float32(np.min(lows, axis=0), np.max(highs, axis=0)) if lows else None
