"""Numbers of glTF files that trimesh does not read as they are meant.

Conventions
-----------
* trimesh takes numbers as they are stored. Integers may be ``normalized``, shares of their type's
  range: texture coordinates, and positions by KHR_mesh_quantization.
* trimesh takes the first set of texture coordinates. A base colour texture may ask for another
  one; and the extension KHR_texture_transform scales, turns and moves them:
  uv' = offset + R (scale x uv).
* glTF's v points down, its R turns anticlockwise as one sees the picture; what is returned has v
  upwards, as everything in ``mesh``.
* What is returned has one entry per geometry that trimesh makes of a file that it has read, in its
  order; None = what trimesh read is right.
"""

from __future__ import annotations

import base64
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gscomplete.util.arrays import Float64Array
from splatcomplete_data.mesh.files.side_files import beside, gltf_binary, gltf_text
from splatcomplete_data.named_files import Reach

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_FLOAT = 5126
_TRIANGLES = 4
_MODES_READ = (0, 1, 4, 5)
"""Points, lines, triangles and strips: what trimesh makes a geometry of."""


@dataclass(frozen=True, slots=True)
class OwnNumbers:
    """Correct numbers of a file where trimesh reads others; see the module's conventions."""

    coordinates: list[Float64Array | None]  # [V, 2] each
    position_ranges: list[int | None]
    """The stored integer that means 1, where positions are shares of it."""
    has_inner_texture: list[bool]
    """Whether a colour texture lies within the file itself."""


def own_numbers(path: Path, reach: Reach) -> OwnNumbers:
    """Return the texture coordinates and ranges that trimesh does not read as the file means them.

    Args:
        path: a glTF or GLB file that trimesh has read.
        reach: where its buffers are read.

    Raises:
        ValueError: or an IndexError, KeyError, TypeError or AttributeError: the file is damaged.
        OSError: a buffer cannot be read.
    """
    file = _Gltf(path, reach)
    primitives = [
        primitive
        for mesh in file.header.get("meshes", [])
        for primitive in mesh["primitives"]
        if primitive.get("mode", _TRIANGLES) in _MODES_READ
    ]
    return OwnNumbers(
        [file.coordinates(primitive) for primitive in primitives],
        [file.position_range(primitive) for primitive in primitives],
        [file.has_inner_texture(primitive) for primitive in primitives],
    )


class _Gltf:
    """A glTF file's header, and its buffers as they are asked for."""

    def __init__(self, path: Path, reach: Reach) -> None:
        """Read the header."""
        self.path, self.reach = path, reach
        self.header: Any = json.loads(gltf_text(path))
        self.buffers: dict[int, bytes] = {}

    def coordinates(self, primitive: Any) -> Float64Array | None:
        """Return a primitive's coordinates, if trimesh does not read them as they are meant."""
        texture = self.base_texture(primitive)
        transform = texture.get("extensions", {}).get("KHR_texture_transform", {})
        chosen = transform.get("texCoord", texture.get("texCoord", 0))
        index = primitive["attributes"].get(f"TEXCOORD_{chosen}")
        if index is None:
            return None
        accessor = self.header["accessors"][index]
        if chosen == 0 and not transform and accessor["componentType"] == _FLOAT:
            return None
        uv = _transformed(self.numbers(accessor), transform)
        return np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)

    def position_range(self, primitive: Any) -> int | None:
        """Return the stored integer that means 1 in a primitive's positions, if any does."""
        accessor = self.header["accessors"][primitive["attributes"]["POSITION"]]
        dtype = np.dtype(_COMPONENTS[accessor["componentType"]])
        if accessor.get("normalized", False) and dtype.kind in "iu":
            return int(np.iinfo(dtype).max)
        return None

    def base_texture(self, primitive: Any) -> Any:
        """Return the reference to a primitive's colour texture; an empty one if it has none."""
        if "material" not in primitive:
            return {}
        material = self.header["materials"][primitive["material"]]
        glossy = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
        metallic = material.get("pbrMetallicRoughness", {})
        return glossy.get("diffuseTexture", metallic.get("baseColorTexture", {}))

    def has_inner_texture(self, primitive: Any) -> bool:
        """Tell whether the picture of a primitive's colour texture lies within the file."""
        index = self.base_texture(primitive).get("index")
        if index is None:
            return False
        texture = self.header["textures"][index]
        others = [value.get("source") for value in texture.get("extensions", {}).values()]
        sources = [s for s in (texture.get("source"), *others) if s is not None]
        images = [self.header["images"][source] for source in sources]
        return any("bufferView" in i or i.get("uri", "").startswith("data:") for i in images)

    def numbers(self, accessor: Any) -> Float64Array:  # [V, 2]
        """Return what an accessor of pairs holds."""
        dtype, count = np.dtype(_COMPONENTS[accessor["componentType"]]), accessor["count"]
        if accessor["type"] != "VEC2":
            raise ValueError(f"texture coordinates: expected VEC2, found {accessor['type']}")
        if "bufferView" not in accessor:  # zeros by specification
            return np.zeros((count, 2))
        view = self.header["bufferViews"][accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        strides = (view.get("byteStride", 2 * dtype.itemsize), dtype.itemsize)
        stored = np.ndarray((count, 2), dtype, self.buffer(view["buffer"]), start, strides)
        values = stored.astype(np.float64)
        if accessor.get("normalized", False) and dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(dtype).max, -1.0)
        return values

    def buffer(self, index: int) -> bytes:
        """Return the bytes of a buffer, wherever they are."""
        if index not in self.buffers:
            uri = self.header["buffers"][index].get("uri")
            if uri is None:
                self.buffers[index] = gltf_binary(self.path)
            elif uri.startswith("data:"):
                self.buffers[index] = base64.b64decode(uri.partition("base64,")[2])
            else:
                file = beside(self.path, uri)
                refusal = self.reach.refusal(file)
                if refusal is not None:
                    raise ValueError(f"file {uri} {refusal}")
                self.buffers[index] = file.read_bytes()
        return self.buffers[index]


def _transformed(uv: Float64Array, transform: Any) -> Float64Array:  # [V, 2] -> [V, 2]
    """Apply KHR_texture_transform, v downwards."""
    angle = transform.get("rotation", 0.0)
    cosine, sine = math.cos(angle), math.sin(angle)
    u, v = (uv * np.asarray(transform.get("scale", (1.0, 1.0)), np.float64)).T
    turned = np.stack([cosine * u + sine * v, cosine * v - sine * u], axis=1)
    return turned + np.asarray(transform.get("offset", (0.0, 0.0)), np.float64)
