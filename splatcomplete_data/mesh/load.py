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
* Alpha is texture x factor (x vertex alpha) where the material says so. Cut-outs (glTF MASK) are
  kept where it reaches the material's cutoff; blended surfaces (BLEND) keep it as opacity.
* What trimesh drops almost silently is noticed: textures that are missing, Draco geometry,
  triangles that are not finite or have no area. ``Mesh.notes`` and ``Mesh.step`` tell.
"""

from __future__ import annotations

import logging
import re
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
from splatcomplete_data.mesh.discs import (
    DiscSettings,
    discs_at,
    sample_triangles,
    triangle_areas_and_normals,
)
from splatcomplete_data.mesh.side_files import gltf_text, side_files
from splatcomplete_data.mesh.textures import (
    as_srgb,
    open_image,
    sample_texture,
    texture_array,
    unit_colors,
    unit_rgb,
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
    check_not_splats(path)
    _refuse_draco(path)
    try:
        resolver = FilePathResolver(str(path), allow_anywhere=True)
        scene = trimesh.load_scene(str(path), resolver=resolver)
    except Exception as error:  # trimesh raises whatever its format readers happen to raise
        raise UserError(f"{path}: cannot read it as a mesh ({error})") from error
    is_linear = path.suffix.lower() in (".gltf", ".glb") and gltf_colors == "linear"
    reader = _PartReader(path, is_linear, max_texture_px)
    if texture is not None:
        reader.override = reader.texture_array(open_image(texture), True)
    try:
        parts = tuple(reader.parts(scene))
    except (ValueError, IndexError, TypeError, KeyError, AttributeError) as error:
        # faces, coordinates or colours of a damaged file that trimesh did not check
        raise UserError(f"{path}: damaged: its parts do not fit together ({error})") from error
    if not parts:
        found = f"{reader.degenerate} without area, {reader.non_finite} not finite"
        raise UserError(
            f"{path}: expected a surface, found no usable triangle ({found}; a point cloud?)"
        )
    notes = [*_missing_files(path), *dict.fromkeys(reader.notes)]
    return Mesh(parts, tuple(notes), reader.degenerate, reader.non_finite)


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

    def parts(self, scene: Any) -> Iterator[MeshPart]:
        """Yield the coloured triangles of every mesh that the scene graph places."""
        for node in scene.graph.nodes_geometry:
            transform, name = scene.graph[node]
            geometry = scene.geometry[name]
            if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
                continue
            points = geometry.vertices @ transform[:3, :3].T + transform[:3, 3]
            vertices = points[geometry.faces]
            with np.errstate(all="ignore"):
                areas, _ = triangle_areas_and_normals(vertices.astype(np.float32))
            finite = np.isfinite(areas)
            kept = finite & (areas > 0)
            self.non_finite += int((~finite).sum())
            self.degenerate += int((finite & ~kept).sum())
            if not kept.any():
                continue
            part = self.appearance(geometry)
            yield MeshPart(
                vertices[kept].astype(np.float32),
                part.colors[kept],
                None if part.uv is None else part.uv[kept],
                part.texture,
                part.alpha,
                part.blended,
            )

    def appearance(self, geometry: Any) -> MeshPart:
        """Return colours, texture coordinates and texture of one mesh; its vertices are unused."""
        visual, faces = geometry.visual, geometry.faces
        corners = np.ones((len(faces), 3, 3), np.float32)
        if visual.kind == "face":
            return MeshPart(corners, corners * unit_rgb(visual.face_colors)[:, None, :])
        if visual.kind == "vertex":
            colors = as_srgb(unit_rgb(visual.vertex_colors), self.is_linear)
            return MeshPart(corners, colors[faces])
        if visual.kind != "texture":
            return MeshPart(corners, corners * np.float32(GREY))
        uv = getattr(visual, "uv", None)
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
            except (OSError, ValueError, SyntaxError) as error:
                raise UserError(f"{self.path}: texture: cannot read it ({error})") from error
        return self.textures[key]


def check_not_splats(path: Path) -> None:
    """Refuse a splat PLY where a mesh is expected.

    Raises:
        UserError: the file holds splats.
    """
    if path.suffix.lower() != ".ply":
        return
    with path.open("rb") as stream:
        head = stream.read(4096)
    if b"property float rot_0" in head or b"packed_position" in head:
        raise UserError(f"{path}: expected a mesh, found Gaussian splats (use: partial, crop)")


def _refuse_draco(path: Path) -> None:
    """Refuse glTF with Draco or meshopt geometry, of which trimesh reads nothing but zeros.

    Raises:
        UserError: the file needs a decoder.
    """
    if path.suffix.lower() not in (".glb", ".gltf"):
        return
    text = gltf_text(path)
    for name in ("KHR_draco_mesh_compression", "EXT_meshopt_compression"):
        if name in text:
            raise UserError(
                f"{path}: geometry is compressed with {name}, expected plain buffers; decode it "
                "first: npx @gltf-transform/cli copy in.glb out.glb (Draco), or export without"
            )


def _missing_files(path: Path) -> Iterator[str]:
    """Yield a note for every file that a mesh file names and that is not there."""
    if path.suffix.lower() in (".gltf", ".glb") and re.search(
        r'"baseColorTexture"\s*:\s*\{[^{}]*"texCoord"\s*:\s*[1-9]', gltf_text(path)
    ):
        yield "a base colour texture asks for a second UV set; it is drawn with the first"
    for name, file in side_files(path).items():
        if not file.exists():
            yield f"missing file {name}: parts of the mesh are without their texture or material"
