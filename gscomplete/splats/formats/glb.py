"""Splats in binary glTF: GLB files with the extension KHR_gaussian_splatting.

Conventions
-----------
* A primitive of mode POINTS has POSITION and, named after the extension, ROTATION (quaternion,
  xyzw), SCALE (linear standard deviations), OPACITY (0 to 1) and SH_DEGREE_l_COEF_n (harmonics, in
  the order and with the sign of 3DGS); ``kernel`` is ``ellipse``, ``colorSpace`` must be the
  gamma-encoded one. Written values are float32: nothing is lost.
* Functions here use the GLB's own axes: right-handed, y up.
* Nodes may move, turn and scale evenly; what they hold is brought to the scene's axes.
* Compressed, sparse and external data are refused.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.splats.ply_files.header import MESH_FIRST
from gscomplete.splats.record import Splats, concatenate
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.util.arrays import Float32Array
from gscomplete.util.atomic import atomic_path

EXTENSION = "KHR_gaussian_splatting"
TURN = Similarity(1.0, torch.diag(torch.tensor([-1.0, -1.0, 1.0])), torch.zeros(3))
"""From a GLB's axes to those of a PLY of the same object, and back: 180 degrees about z, as
PlayCanvas's splat-transform turns."""
_COLOR_SPACE = "srgb_rec709_display"
_KINDS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_UNEVEN = 1e-4
_DEEPEST = 64


def write_glb_splats(path: Path, splats: Splats) -> None:
    """Write splats as one primitive, in the GLB's axes.

    Raises:
        UserError: the file cannot be written.
    """
    columns: list[tuple[str, str, Float32Array]] = [
        ("POSITION", "VEC3", splats.means.numpy()),
        (f"{EXTENSION}:ROTATION", "VEC4", splats.quaternions.numpy()[:, [1, 2, 3, 0]]),
        (f"{EXTENSION}:SCALE", "VEC3", splats.scales.numpy()),
        (f"{EXTENSION}:OPACITY", "SCALAR", splats.opacities.clamp(0, 1).numpy()),
    ]
    for degree in range(splats.sh_degree + 1):
        for number in range(2 * degree + 1):
            name = f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{number}"
            columns.append((name, "VEC3", splats.sh[:, degree**2 + number].numpy()))
    accessors: list[dict[str, Any]] = []
    views: list[dict[str, int]] = []
    attributes, parts, offset = {}, [], 0
    for name, kind, values in columns:
        data = np.ascontiguousarray(values, "<f4").tobytes()
        attributes[name] = len(accessors)
        accessor: dict[str, Any] = {
            "bufferView": len(views),
            "componentType": 5126,
            "count": len(splats),
            "type": kind,
        }
        if name == "POSITION":
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        accessors.append(accessor)
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(data)})
        parts.append(data)
        offset += len(data)
    told = {"kernel": "ellipse", "colorSpace": _COLOR_SPACE}
    primitive = {"attributes": attributes, "mode": 0, "extensions": {EXTENSION: told}}
    document = {
        "asset": {"version": "2.0", "generator": "splatcomplete-data"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + offset  # floats keep the binary chunk a multiple of 4
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(struct.pack("<4sIIII", b"glTF", 2, size, len(text), _JSON) + text)
        file.write(struct.pack("<II", offset, _BIN))
        file.writelines(parts)


@dataclass(frozen=True, slots=True)
class _File:
    """A GLB's document and binary chunk."""

    path: Path
    document: dict[str, Any]
    binary: bytes


def read_glb_splats(path: Path) -> tuple[Splats, int]:
    """Read all splats of a GLB's scene, in its axes.

    Returns:
        The splats, and the number of primitives that are none and were left.

    Raises:
        UserError: it is no GLB, damaged, holds no splats, or uses what is not read.
    """
    file = _open(path)
    found: list[Splats] = []
    others = 0
    try:
        for node, transform in _placed_nodes(file):
            for primitive in file.document["meshes"][node["mesh"]]["primitives"]:
                if EXTENSION in primitive.get("extensions", {}):
                    found.append(transform_splats(_primitive(file, primitive), transform))
                else:
                    others += 1
    except (
        *(KeyError, IndexError, TypeError, ValueError),
        *(AttributeError, OverflowError, RecursionError),
    ) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{path}: GLB: malformed document ({error!r})") from error
    if not found:
        raise UserError(
            f"{path}: expected a primitive with {EXTENSION}, found none: a mesh; {MESH_FIRST}"
        )
    degree = max(splats.sh_degree for splats in found)
    padded = [splats.with_sh_degree(degree) for splats in found]
    return concatenate(padded), others


def _open(path: Path) -> _File:
    """Split a GLB into its chunks."""
    raw = path.read_bytes()
    if len(raw) < 20 or raw[:4] != b"glTF":
        raise UserError(f"{path}: expected a GLB file, found another beginning")
    version, size, length, kind = struct.unpack_from("<IIII", raw, 4)
    if version != 2 or size > len(raw) or kind != _JSON or 20 + length > size:
        raise UserError(f"{path}: GLB: expected version 2 and {size:,} bytes, found {len(raw):,}")
    try:
        document = json.loads(raw[20 : 20 + length])
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: GLB: cannot read its JSON ({error})") from error
    if not isinstance(document, dict):
        raise UserError(f"{path}: GLB: expected a JSON object")
    binary, start = b"", 20 + length
    if start + 8 <= size:
        length, kind = struct.unpack_from("<II", raw, start)
        if kind == _BIN:
            binary = raw[start + 8 : start + 8 + length]
    return _File(path, document, binary)


def _placed_nodes(file: _File) -> list[tuple[dict[str, Any], Similarity]]:
    """Return the nodes with meshes of the scene, and how they lie in it."""
    document = file.document
    nodes = document["nodes"]
    scenes = document.get("scenes")
    roots = scenes[document.get("scene", 0)]["nodes"] if scenes else list(range(len(nodes)))
    identity = Similarity(1.0, torch.eye(3, dtype=torch.float64), torch.zeros(3))
    placed: list[tuple[dict[str, Any], Similarity]] = []
    waiting = [(index, identity, 0) for index in roots]
    while waiting:
        index, above, depth = waiting.pop()
        if depth > _DEEPEST or len(placed) > len(nodes):
            raise UserError(f"{file.path}: GLB: nodes: expected a tree, found a loop")
        node = nodes[index]
        here = above.compose(_transform(file.path, node))
        if "mesh" in node:
            placed.append((node, here))
        waiting += [(child, here, depth + 1) for child in node.get("children", ())]
    return placed


def _transform(path: Path, node: dict[str, Any]) -> Similarity:
    """Return a node's transform.

    Raises:
        UserError: it is no similarity.
    """
    if "matrix" in node:
        matrix = np.array(node["matrix"], np.float64).reshape(4, 4).T
        linear, move = matrix[:3, :3], matrix[:3, 3]
    else:
        x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
        turn = rotation_matrices(torch.tensor([[w, x, y, z]], dtype=torch.float64))[0].numpy()
        linear = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)), np.float64)
        move = np.array(node.get("translation", (0.0, 0.0, 0.0)), np.float64)
    scale = float(np.cbrt(np.linalg.det(linear)))
    if not scale > 0 or np.abs(linear.T @ linear / scale**2 - np.eye(3)).max() > _UNEVEN:
        raise UserError(f"{path}: GLB: expected nodes that scale evenly and do not mirror")
    left, _, right = np.linalg.svd(linear)  # what rounding left of a rotation, made exact
    return Similarity(scale, torch.from_numpy(left @ right), torch.from_numpy(move))


def _primitive(file: _File, primitive: dict[str, Any]) -> Splats:
    """Read one primitive."""
    told, attributes = primitive["extensions"][EXTENSION], primitive["attributes"]
    if told.get("extensions"):
        raise UserError(
            f"{file.path}: expected plain splats, found {', '.join(told['extensions'])}"
        )
    for name, known in (("kernel", "ellipse"), ("colorSpace", _COLOR_SPACE)):
        if told.get(name) != known:
            raise UserError(f"{file.path}: {name}: expected {known}, found {told.get(name)!r}")
    column = {name: _accessor(file, index) for name, index in attributes.items()}
    bands = 1
    while f"{EXTENSION}:SH_DEGREE_{bands}_COEF_0" in column and bands < 4:
        bands += 1
    harmonics = [
        column[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{number}"]
        for degree in range(bands)
        for number in range(2 * degree + 1)
    ]
    negative = int((column[f"{EXTENSION}:SCALE"] < 0).any(axis=1).sum())
    if negative:
        raise UserError(
            f"{file.path}: scale: expected no negative one, found {negative:,} splats with"
        )
    quaternions = torch.from_numpy(column[f"{EXTENSION}:ROTATION"][:, [3, 0, 1, 2]].copy())
    return Splats(
        torch.from_numpy(column["POSITION"]),
        torch.nn.functional.normalize(quaternions, dim=1),
        torch.from_numpy(column[f"{EXTENSION}:SCALE"]),
        torch.from_numpy(column[f"{EXTENSION}:OPACITY"].reshape(-1)),
        torch.from_numpy(np.stack(harmonics, axis=1)),
    )


def _accessor(file: _File, index: int) -> Float32Array:  # [N, components]
    """Return an accessor's values; whole numbers are shares of the largest of their type."""
    accessor = file.document["accessors"][index]
    if "sparse" in accessor or "bufferView" not in accessor:
        raise UserError(f"{file.path}: GLB: accessor {index}: sparse or compressed data")
    view = file.document["bufferViews"][accessor["bufferView"]]
    if view.get("buffer", 0) != 0 or "uri" in file.document["buffers"][0] or view.get("extensions"):
        raise UserError(f"{file.path}: GLB: accessor {index}: expected data in the file itself")
    dtype = np.dtype(_TYPES[accessor["componentType"]])
    width, count = _KINDS[accessor["type"]], int(accessor["count"])
    stride = int(view.get("byteStride", 0)) or width * dtype.itemsize
    start = int(view.get("byteOffset", 0)) + int(accessor.get("byteOffset", 0))
    end = start + stride * max(count - 1, 0) + width * dtype.itemsize
    if min(start, count, stride - width * dtype.itemsize) < 0 or end > len(file.binary):
        raise UserError(
            f"{file.path}: GLB: accessor {index}: expected {end:,} bytes of data, found "
            f"{len(file.binary):,}"
        )
    shape, strides = (count, width), (stride, dtype.itemsize)
    raw = np.ndarray(shape, dtype, file.binary, start, strides)
    if dtype.kind == "f":
        return raw.astype(np.float32)
    return np.maximum(raw / np.float64(np.iinfo(dtype).max), -1.0).astype(np.float32)
