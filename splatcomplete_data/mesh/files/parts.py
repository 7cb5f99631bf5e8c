"""The coloured triangles of a scene that trimesh has read.

Conventions
-----------
* Node transforms are applied, so vertices are in the file's frame and units. Degenerate and
  non-finite triangles are left out and counted.
* Colours are sRGB in [0, 1]. glTF factors and vertex colours are linear by its specification and
  converted where ``is_linear`` says so.
* With a texture, an OBJ's ``Kd`` is ignored (as by most viewers; exporters leave 0.8 or 0.4 there
  next to a photo), while a glTF's factor multiplies as specified.
* Texture coordinates are OpenGL's: v upwards, wrapping round, bilinear between texels.
* Alpha is texture x factor where the material says so; that of vertices is not read. Cut-outs
  (glTF MASK) are kept where it reaches the cutoff; blended surfaces (BLEND) keep it as opacity.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float32Array, Float64Array, IntArray
from splatcomplete_data.mesh.discs import triangle_areas_and_normals
from splatcomplete_data.mesh.files.gltf_numbers import own_numbers
from splatcomplete_data.mesh.files.textures import (
    as_srgb,
    sample_texture,
    texture_array,
    unit_colors,
    unit_rgb,
)
from splatcomplete_data.named_files import Reach
from splatcomplete_data.pictures import UNREADABLE
from splatcomplete_data.points import Offset

GREY = 0.7
"""Colour of a surface without any."""
_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class MeshPart:
    """Triangles of one material: corner colours times an optional texture."""

    vertices: Float32Array  # [T, 3, 3] corners, file frame
    colors: Float32Array  # [T, 3, 3] sRGB in [0, 1] at the corners
    uv: Float32Array | None = None  # [T, 3, 2]
    texture: Float32Array | None = None  # [H, W, 4] sRGB and alpha in [0, 1], top row first
    alpha: float = 1.0  # factor on the texture's alpha
    blended: bool = False  # True = alpha is opacity; False = what is below 1/2 is cut out

    def colors_at(
        self,
        triangle: IntArray,  # [N]
        weights: Float32Array,  # [N, 3] barycentric
    ) -> Float32Array:  # [N, 4]
        """Return sRGB and alpha at surface points."""
        rgba = np.ones((len(triangle), 4), np.float32)
        rgba[:, :3] = np.einsum("nk,nkc->nc", weights, self.colors[triangle])
        if self.uv is not None and self.texture is not None:
            uv = np.einsum("nk,nkc->nc", weights, self.uv[triangle])
            rgba *= sample_texture(self.texture, uv)
        rgba[:, 3] *= self.alpha
        return rgba


@dataclass(slots=True)
class PartReader:
    """Turns a loaded scene into parts, and collects notes about anything unusual."""

    path: Path
    is_linear: bool
    max_texture_px: int
    reach: Reach
    override: Float32Array | None = None
    notes: list[str] = field(default_factory=list)
    degenerate: int = 0
    non_finite: int = 0
    textures: dict[tuple[int, bool], Float32Array] = field(default_factory=dict)
    coordinates: dict[str, Float64Array] = field(default_factory=dict)
    """Texture coordinates by geometry, where trimesh's are not those that the file means."""
    vertices: dict[str, Float64Array] = field(default_factory=dict)
    """Vertices [V, 3] by geometry, where trimesh's are not those that the file means."""
    textured: set[str] = field(default_factory=set)
    """Geometries whose colour texture lies within the file itself."""
    offset: Offset | None = None

    def read_numbers(self, scene: Any) -> None:
        """Read the numbers of a glTF file that trimesh does not read as the file means them."""
        own, geometries = own_numbers(self.path, self.reach), scene.geometry
        if len(own.coordinates) == len(geometries):
            for (name, geometry), uv in zip(geometries.items(), own.coordinates, strict=True):
                if uv is not None and len(uv) == len(geometry.vertices):
                    self.coordinates[name] = uv
            for (name, geometry), most in zip(geometries.items(), own.position_ranges, strict=True):
                if most is not None and isinstance(geometry, trimesh.Trimesh):
                    self.vertices[name] = np.maximum(geometry.vertices / most, -1.0)
            pairs = zip(geometries, own.has_inner_texture, strict=True)
            self.textured = {name for name, is_textured in pairs if is_textured}
        elif any(most is not None for most in own.position_ranges):
            self.note("integer positions: their normalization is not applied, so sizes are wrong")
        if len(self.coordinates) < sum(uv is not None for uv in own.coordinates):
            self.note("texture transforms, additional or integer coordinates: some are not applied")

    def placed(self, scene: Any) -> Iterator[tuple[str, Float64Array]]:
        """Yield the name and the triangles [T, 3, 3] of every mesh that the scene graph places."""
        for node in scene.graph.nodes_geometry:
            transform, name = scene.graph[node]
            geometry = scene.geometry[name]
            if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces) > 0:
                vertices = self.vertices.get(name, geometry.vertices)
                points = vertices @ transform[:3, :3].T + transform[:3, 3]
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
            if part.texture is None and self.override is not None:
                self.note(f"{name}: it has no texture coordinates, and keeps its colours")
            elif part.texture is None and name in self.textured:
                self.note(f"{name}: its texture is not read (perhaps KTX2)")
            yield MeshPart(
                vertices[kept].astype(np.float32),
                part.colors[kept],
                None if part.uv is None else part.uv[kept],
                part.texture,
                part.alpha,
                part.blended,
            )

    def appearance(self, geometry: Any, uv: Float64Array | None) -> MeshPart:
        """Return colours, texture coordinates and texture of one mesh; its vertices are unused.

        ``uv`` replaces the mesh's own texture coordinates where those are not the ones meant.
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
        image = self.base_image(material) if self.override is None else None
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
            self.note(f"a texture of {image.size} pixels is a placeholder; its file may be missing")
        return image

    def note(self, text: str) -> None:
        """Keep a note, and log it."""
        _logger.warning("%s: %s", self.path, text)
        self.notes.append(text)

    def texture_array(self, image: Image.Image, has_alpha: bool) -> Float32Array:  # [H, W, 4]
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
