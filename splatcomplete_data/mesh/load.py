"""Mesh files to coloured triangles, by way of trimesh.

Conventions
-----------
* Every format trimesh reads; node transforms are applied, so vertices are in the file's frame and
  units. Degenerate and non-finite triangles are dropped.
* Colours are sRGB in [0, 1]. glTF factors and vertex colours are linear by its specification and
  converted, unless ``GltfColors`` says that the exporter wrote sRGB into them.
* With a texture, an OBJ's ``Kd`` is ignored (as by most viewers; exporters leave 0.8 or 0.4 there
  next to a photo), while a glTF's factor multiplies as specified.
* Texture coordinates are OpenGL's: v upwards, wrapping round, bilinear between texels. Textures
  larger than ``MAX_TEXTURE_PX`` are box-filtered down: splats are far coarser than texels.
* Surfaces marked as cut-outs or blended are kept where alpha is at least 1/2 in the texture.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.resolvers import FilePathResolver

from gscomplete.errors import UserError
from gscomplete.splats import Splats
from splatcomplete_data.mesh.discs import (
    DiscSettings,
    discs_at,
    sample_triangles,
    triangle_areas_and_normals,
)

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
        return rgba


@dataclass(frozen=True, slots=True)
class Mesh:
    """A mesh file's surface, ready for sampling."""

    parts: tuple[MeshPart, ...]

    @property
    def triangles(self) -> int:
        """Number of triangles of all parts."""
        return sum(len(part.vertices) for part in self.parts)

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the corners [3] of the axis-aligned box."""
        corners = np.concatenate([part.vertices.reshape(-1, 3) for part in self.parts])
        return corners.min(axis=0).astype(np.float64), corners.max(axis=0).astype(np.float64)


def load_mesh(
    path: Path, *, texture: Path | None = None, gltf_colors: GltfColors = "linear"
) -> Mesh:
    """Read a mesh file.

    Args:
        path: the file; materials and textures are found through it, also outside its folder.
        texture: image that replaces the base colour of every part, for files that lost theirs.
        gltf_colors: how a glTF's factors and vertex colours are to be read.

    Raises:
        UserError: the file cannot be read, or has no surface (a Draco-compressed file without a
            decoder gives one point).
    """
    try:
        resolver = FilePathResolver(str(path), allow_anywhere=True)
        scene = trimesh.load_scene(str(path), resolver=resolver)
    except Exception as error:  # trimesh raises whatever its format readers happen to raise
        raise UserError(f"{path}: cannot read it as a mesh ({error})") from error
    is_linear = path.suffix.lower() in (".gltf", ".glb") and gltf_colors == "linear"
    override = None if texture is None else _texture_array(_open_image(texture), True)
    parts = tuple(_parts(scene, is_linear, override))
    if not parts:
        raise UserError(
            f"{path}: expected a surface, found no triangle with an area "
            "(Draco-compressed, or a point cloud?)"
        )
    return Mesh(parts)


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


def sample_texture(
    texture: FloatArray,  # [H, W, C], top row first
    uv: FloatArray,  # [N, 2], v upwards
) -> FloatArray:  # [N, C]
    """Look a texture up bilinearly, wrapping round at its edges."""
    height, width = texture.shape[:2]
    x = np.nan_to_num(uv[:, 0].astype(np.float64)) * width - 0.5
    y = (1.0 - np.nan_to_num(uv[:, 1].astype(np.float64))) * height - 0.5
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = (x - column)[:, None], (y - row)[:, None]
    left, right = column % width, (column + 1) % width
    top, bottom = row % height, (row + 1) % height
    upper = texture[top, left] * (1 - fx) + texture[top, right] * fx
    lower = texture[bottom, left] * (1 - fx) + texture[bottom, right] * fx
    return (upper * (1 - fy) + lower * fy).astype(np.float32)


def srgb_from_linear(values: FloatArray) -> FloatArray:
    """Encode linear light in [0, 1] as sRGB."""
    values = np.clip(values, 0.0, 1.0)
    encoded = np.where(
        values <= 0.0031308, 12.92 * values, 1.055 * np.maximum(values, 1e-9) ** (1 / 2.4) - 0.055
    )
    return encoded.astype(np.float32)


def _parts(scene: Any, is_linear: bool, override: FloatArray | None) -> Iterator[MeshPart]:
    """Yield the coloured triangles of every mesh that the scene graph places."""
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
            continue
        points = geometry.vertices @ transform[:3, :3].T + transform[:3, 3]
        vertices = points[geometry.faces]
        areas, _ = triangle_areas_and_normals(vertices)
        kept = np.isfinite(areas) & (areas > 0)
        if not kept.any():
            continue
        colors, uv, texture = _appearance(geometry, is_linear, override)
        uv_kept = None if uv is None else uv[geometry.faces][kept].astype(np.float32)
        yield MeshPart(vertices[kept].astype(np.float32), colors[kept], uv_kept, texture)


def _appearance(
    geometry: Any, is_linear: bool, override: FloatArray | None
) -> tuple[FloatArray, NDArray[np.floating] | None, FloatArray | None]:
    """Return corner colours [T, 3, 3], texture coordinates [V, 2] and texture of one mesh."""
    visual = geometry.visual
    corners = np.ones((len(geometry.faces), 3, 3), np.float32)
    if visual.kind == "face":
        return corners * _unit(visual.face_colors)[:, None, :], None, None
    if visual.kind == "vertex":
        return _convert(_unit(visual.vertex_colors), is_linear)[geometry.faces], None, None
    if visual.kind != "texture":
        return corners * np.float32(GREY), None, None
    uv = getattr(visual, "uv", None)
    material = visual.material
    image = _base_image(material)
    texture = override
    if texture is None and image is not None and uv is not None:
        alpha_mode = getattr(material, "alphaMode", None) or "OPAQUE"
        texture = _texture_array(image, alpha_mode != "OPAQUE")
    factor = getattr(material, "baseColorFactor", None)
    if factor is None and texture is None:
        factor = getattr(material, "diffuse", None)
    if factor is not None and override is None:
        corners = corners * _convert(_unit(np.asarray(factor)), is_linear)
    painted = (getattr(visual, "vertex_attributes", None) or {}).get("color")
    if painted is not None:
        corners = corners * _convert(_unit(np.asarray(painted)), is_linear)[geometry.faces]
    return corners.astype(np.float32), uv if texture is not None else None, texture


def _base_image(material: Any) -> Image.Image | None:
    """Return a material's colour image, if it has a real one."""
    image = getattr(material, "baseColorTexture", None)
    if image is None:
        image = getattr(material, "image", None)
    if image is not None and max(image.size) <= 2:
        _logger.warning("a texture is a placeholder of %s pixels: missing file?", image.size)
    return image


def _open_image(path: Path) -> Image.Image:
    """Open an image file.

    Raises:
        UserError: it is missing or not an image.
    """
    try:
        return Image.open(path)
    except OSError as error:
        raise UserError(f"{path}: cannot read it as an image ({error})") from error


def _texture_array(image: Image.Image, has_alpha: bool) -> FloatArray:  # [H, W, 4]
    """Turn an image into colours in [0, 1], reduced to ``MAX_TEXTURE_PX``."""
    image = image.convert("RGBA")
    factor = max(image.size) // MAX_TEXTURE_PX
    if factor > 1:
        image = image.reduce(factor)
    pixels = np.asarray(image, np.float32) / 255.0
    if not has_alpha:
        pixels = pixels.copy()
        pixels[..., 3] = 1.0
    return pixels


def _unit(colors: NDArray[Any]) -> FloatArray:
    """Scale colours [..., 3 or 4] of any type to RGB in [0, 1]."""
    values = np.asarray(colors)[..., :3]
    if np.issubdtype(values.dtype, np.integer):
        return (values / np.iinfo(values.dtype).max).astype(np.float32)
    return values.astype(np.float32)


def _convert(colors: FloatArray, is_linear: bool) -> FloatArray:
    """Encode colours as sRGB if they are linear."""
    return srgb_from_linear(colors) if is_linear else colors
