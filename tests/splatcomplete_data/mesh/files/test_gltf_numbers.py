"""Texture coordinates and positions of glTF files are those that the file means."""

import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gscomplete.errors import UserError
from splatcomplete_data.mesh.files.load import load_mesh, mesh_to_discs

QUARTERS = {
    "upper left": (1, 0, 0),
    "upper right": (0, 1, 0),
    "lower left": (0, 0, 1),
    "lower right": (1, 1, 0),
}
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
WHOLE = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float64)
"""glTF coordinates, v downwards, that show the whole picture upright on ``CORNERS``."""


def picture() -> bytes:
    """64 pixels square, a colour in every quarter."""
    pixels = np.zeros((64, 64, 3), np.uint8)
    for (name, color), rows, columns in zip(
        QUARTERS.items(), (0, 0, 32, 32), (0, 32, 0, 32), strict=True
    ):
        assert name
        pixels[rows : rows + 32, columns : columns + 32] = np.array(color) * 255
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def data_uri(content: bytes) -> str:
    return "data:application/octet-stream;base64," + base64.b64encode(content).decode()


def quad(
    folder: Path,
    stored: list[np.ndarray],
    texture: dict[str, Any] | None = None,
    *,
    normalized: bool = False,
    kind: str = "gltf",
    corners: np.ndarray = CORNERS,
    node: dict[str, Any] | None = None,
) -> Path:
    """A square with a picture; ``stored`` are its sets of texture coordinates.

    Its corners [4, 4] are shares of their type's range if they are integers; the last is padding.
    """
    kinds = {"float32": 5126, "uint8": 5121, "uint16": 5123, "int8": 5120, "int16": 5122}
    is_whole = corners.dtype.kind in "iu"
    blocks = [corners.tobytes(), np.array([0, 1, 2, 0, 2, 3], "<u2").tobytes()]
    accessors: list[dict[str, Any]] = [
        {
            "bufferView": 0,
            "componentType": kinds[corners.dtype.name],
            "normalized": is_whole,
            "count": 4,
            "type": "VEC3",
        },
        {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
    ]
    views: list[dict[str, Any]] = []
    for uv in stored:
        row = uv.tobytes()
        width = len(row) // 4
        padded = -(-width // 4) * 4  # rows begin at multiples of 4, as the format asks
        blocks.append(b"".join(row[i * width : (i + 1) * width].ljust(padded) for i in range(4)))
        accessors.append(
            {
                "bufferView": len(blocks) - 1,
                "componentType": kinds[uv.dtype.name],
                "normalized": normalized,
                "count": 4,
                "type": "VEC2",
            }
        )
    start = 0
    for number, block in enumerate(blocks):
        views.append({"buffer": 0, "byteOffset": start, "byteLength": len(block)})
        if number > 1 and len(block) > 4 * 2 * stored[number - 2].itemsize:
            views[-1]["byteStride"] = len(block) // 4
        if number == 0 and is_whole:
            views[-1]["byteStride"] = len(block) // 4
        start += len(block)
    attributes = {"POSITION": 0} | {f"TEXCOORD_{n}": 2 + n for n in range(len(stored))}
    content = b"".join(blocks)
    header: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **(node or {})}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1, "material": 0}]}],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, **(texture or {})}}}
        ],
        "textures": [{"source": 0}],
        "images": [{"uri": data_uri(picture())}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(content)}],
    }
    path = folder / f"quad.{kind}"
    if kind == "glb":
        text = json.dumps(header).encode()
        text += b" " * (-len(text) % 4)
        content += bytes(-len(content) % 4)
        chunks = [(b"JSON", text), (b"BIN\0", content)]
        body = b"".join(len(data).to_bytes(4, "little") + name + data for name, data in chunks)
        lengths = (2).to_bytes(4, "little") + (12 + len(body)).to_bytes(4, "little")
        path.write_bytes(b"glTF" + lengths + body)
        return path
    (folder / "the quad.bin").write_bytes(content)
    header["buffers"][0]["uri"] = "the%20quad.bin"
    path.write_text(json.dumps(header))
    return path


def shown(path: Path) -> dict[str, tuple[float, ...]]:
    """Return the mean colour of every quarter of the square, as one sees it."""
    splats = mesh_to_discs(load_mesh(path), 2000)
    x, y = splats.means[:, 0].numpy(), splats.means[:, 1].numpy()
    colors = splats.base_colors.numpy()
    result = {}
    for name in QUARTERS:
        middle_x = 0.75 if "right" in name else 0.25
        middle_y = 0.75 if "upper" in name else 0.25
        inside = (np.abs(x - middle_x) < 0.15) & (np.abs(y - middle_y) < 0.15)
        result[name] = tuple(np.round(colors[inside].mean(axis=0), 1).tolist())
    return result


@pytest.mark.parametrize("kind", ["gltf", "glb"])
@pytest.mark.parametrize("dtype", ["float32", "uint8", "uint16", "int16"])
def test_normalized_integers_are_shares_of_their_range(
    tmp_path: Path, dtype: str, kind: str
) -> None:
    is_float = dtype == "float32"
    stored = (WHOLE * (1 if is_float else np.iinfo(dtype).max)).astype(dtype)
    path = quad(tmp_path, [stored], normalized=not is_float, kind=kind)
    assert shown(path) == QUARTERS


def test_integers_that_are_not_normalized_are_scaled_by_the_transform(tmp_path: Path) -> None:
    """As gltfpack writes them."""
    scale = {"KHR_texture_transform": {"scale": [1 / 4095, 1 / 4095]}}
    path = quad(tmp_path, [(WHOLE * 4095).astype(np.uint16)], {"extensions": scale})
    assert shown(path) == QUARTERS


@pytest.mark.parametrize(
    ("transform", "expected"),
    [
        ({"scale": [0.5, 0.5], "offset": [0.5, 0.0]}, dict.fromkeys(QUARTERS, (0, 1, 0))),
        ({"scale": [0.5, 0.5], "offset": [0.0, 0.5]}, dict.fromkeys(QUARTERS, (0, 0, 1))),
        # the specification's own examples: the lower left quarter, turned; and v upwards
        (
            {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]},
            dict.fromkeys(QUARTERS, (0, 0, 1)),
        ),
        (
            {"offset": [0, 1], "scale": [1, -1]},
            {
                "upper left": (0, 0, 1),
                "upper right": (1, 1, 0),
                "lower left": (1, 0, 0),
                "lower right": (0, 1, 0),
            },
        ),
        # coordinates turn anticlockwise, so the picture turns clockwise
        (
            {"offset": [0, 1], "rotation": np.pi / 2},
            {
                "upper left": (0, 0, 1),
                "upper right": (1, 0, 0),
                "lower right": (0, 1, 0),
                "lower left": (1, 1, 0),
            },
        ),
    ],
)
def test_texture_transforms_are_applied(
    tmp_path: Path, transform: dict[str, Any], expected: dict[str, tuple[float, ...]]
) -> None:
    texture = {"extensions": {"KHR_texture_transform": transform}}
    assert shown(quad(tmp_path, [WHOLE.astype(np.float32)], texture)) == expected


def test_the_set_that_a_texture_asks_for_is_used(tmp_path: Path) -> None:
    corner = np.full((4, 2), 0.25, np.float32)
    both = [corner, WHOLE.astype(np.float32)]
    assert shown(quad(tmp_path, both)) == dict.fromkeys(QUARTERS, (1, 0, 0))
    assert shown(quad(tmp_path, both, {"texCoord": 1})) == QUARTERS
    instead = {"texCoord": 0, "extensions": {"KHR_texture_transform": {"texCoord": 1}}}
    assert shown(quad(tmp_path, both, instead)) == QUARTERS


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int8", "int16"])
def test_normalized_positions_are_shares_of_their_range(tmp_path: Path, dtype: str) -> None:
    """As ``gltfpack -vpn`` writes them: the node's transform makes them the object again."""
    most = np.iinfo(dtype).max
    corners = np.zeros((4, 4), dtype)  # rows begin at multiples of 4 bytes
    corners[:, :2] = (CORNERS[:, :2] * most).astype(dtype)
    node = {"scale": [2.0, 3.0, 1.0], "translation": [5.0, 0.0, 0.0]}
    path = quad(tmp_path, [WHOLE.astype(np.float32)], corners=corners, node=node)
    mesh = load_mesh(path)
    low, high = mesh.bounds()
    np.testing.assert_allclose(low, [5, 0, 0], atol=1e-6)
    np.testing.assert_allclose(high, [7, 3, 0], atol=1e-6)
    assert mesh.notes == ()


@pytest.mark.parametrize("dtype", ["int8", "int16"])
def test_the_least_integer_means_minus_one_too(tmp_path: Path, dtype: str) -> None:
    info = np.iinfo(dtype)
    corners = np.zeros((4, 4), dtype)
    corners[:, :2] = np.where(CORNERS[:, :2] > 0, info.max, info.min)
    low, high = load_mesh(quad(tmp_path, [WHOLE.astype(np.float32)], corners=corners)).bounds()
    np.testing.assert_allclose(low, [-1, -1, 0])
    np.testing.assert_allclose(high, [1, 1, 0])


def test_a_picture_in_the_file_that_is_not_read_is_told(tmp_path: Path) -> None:
    path = quad(tmp_path, [WHOLE.astype("<f4")])
    assert load_mesh(path).notes == ()
    header = json.loads(path.read_text())
    header["images"] = [{"uri": data_uri(b"\xabKTX 20\xbb"), "mimeType": "image/ktx2"}]
    header["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]
    path.write_text(json.dumps(header))
    (note,) = load_mesh(path).notes
    assert "texture is not read" in note


def test_instances_of_an_extension_are_refused(tmp_path: Path) -> None:
    path = quad(tmp_path, [WHOLE.astype("<f4")])
    header = json.loads(path.read_text())
    header["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {}}}
    path.write_text(json.dumps(header))
    with pytest.raises(UserError, match="EXT_mesh_gpu_instancing"):
        load_mesh(path)
