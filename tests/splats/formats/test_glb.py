"""Splats in GLB files keep every value; nodes place them; damage is named."""

import dataclasses
import json
import struct

import numpy as np
import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Similarity, Splats, read_splats, transform_splats, write_splats
from gscomplete.splats.formats.glb import EXTENSION, read_glb_splats, write_glb_splats
from splatcomplete_data.cli import main


def some_splats(count=40, bands=9):
    generator = torch.Generator().manual_seed(1)
    return Splats(
        torch.randn(count, 3, generator=generator),
        torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=1),
        torch.rand(count, 3, generator=generator) + 0.01,
        torch.rand(count, generator=generator),
        torch.randn(count, bands, 3, generator=generator),
    )


def chunks(path):
    """Split a GLB, by the letter of the glTF 2.0 specification."""
    raw = path.read_bytes()
    magic, version, size, length, kind = struct.unpack_from("<4sIIII", raw)
    assert (magic, version, size, kind) == (b"glTF", 2, len(raw), 0x4E4F534A)
    assert length % 4 == 0
    extent, kind = struct.unpack_from("<II", raw, 20 + length)
    assert (kind, extent % 4, 28 + length + extent) == (0x004E4942, 0, len(raw))
    return json.loads(raw[20 : 20 + length]), raw[28 + length :]


def rewritten(path, document, binary):
    """Write a GLB of other content."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(binary), len(text), 0x4E4F534A)
    path.write_bytes(head + text + struct.pack("<II", len(binary), 0x004E4942) + binary)
    return path


def written(path, splats):
    write_glb_splats(path, splats)
    return path


def assert_same(a, b, **tolerance):
    for (name, x), (_, y) in zip(a.fields(), b.fields(), strict=True):
        torch.testing.assert_close(x, y, msg=name, **(tolerance or {"atol": 1e-6, "rtol": 1e-6}))


@pytest.mark.parametrize("bands", [1, 4, 9, 16])
def test_values_stand_where_the_extension_puts_them(tmp_path, bands):
    splats = some_splats(bands=bands)
    document, binary = chunks(written(tmp_path / "a.glb", splats))
    (primitive,) = document["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    told = primitive["extensions"][EXTENSION]
    assert told == {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    assert document["extensionsUsed"] == [EXTENSION]

    def column(name):
        accessor = document["accessors"][primitive["attributes"][name]]
        view = document["bufferViews"][accessor["bufferView"]]
        values = np.frombuffer(binary, "<f4", view["byteLength"] // 4, view["byteOffset"])
        return values.reshape(accessor["count"], -1)

    np.testing.assert_array_equal(column("POSITION"), splats.means)
    turned = column(f"{EXTENSION}:ROTATION")
    np.testing.assert_array_equal(turned[:, 3], splats.quaternions[:, 0])
    np.testing.assert_array_equal(turned[:, :3], splats.quaternions[:, 1:])
    np.testing.assert_array_equal(column(f"{EXTENSION}:SCALE"), splats.scales)
    np.testing.assert_array_equal(column(f"{EXTENSION}:OPACITY")[:, 0], splats.opacities)
    last = {1: (0, 0), 4: (1, 2), 9: (2, 4), 16: (3, 6)}[bands]
    name = f"{EXTENSION}:SH_DEGREE_{last[0]}_COEF_{last[1]}"
    np.testing.assert_array_equal(column(name), splats.sh[:, bands - 1])
    assert_same(read_glb_splats(tmp_path / "a.glb")[0], splats)


def test_nodes_place_their_splats(tmp_path):
    splats = some_splats()
    document, binary = chunks(written(tmp_path / "a.glb", splats))
    half = 2**-0.5
    document["nodes"] = [
        {"children": [1, 2], "translation": [1, 2, 3], "scale": [2, 2, 2]},
        {"mesh": 0, "rotation": [0, 0, half, half]},
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]},
    ]
    found, others = read_glb_splats(rewritten(tmp_path / "b.glb", document, binary))
    assert (len(found), others) == (2 * len(splats), 0)
    turn = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    placed = [
        transform_splats(splats, Similarity(2.0, turn, torch.tensor([1.0, 2, 3]))),
        transform_splats(splats, Similarity(2.0, torch.eye(3), torch.tensor([11.0, 2, 3]))),
    ]
    halves = [found.select(torch.arange(len(splats)) + start) for start in (0, len(splats))]
    if float((halves[0].means - placed[0].means).abs().max()) > 1:
        halves.reverse()
    for half_found, expected in zip(halves, placed, strict=True):
        torch.testing.assert_close(half_found.means, expected.means, atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(half_found.sh, expected.sh, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda d: d["nodes"][0].update(scale=[1, 1, -1]), "do not mirror"),
        (lambda d: d["nodes"][0].update(scale=[1, 2, 1]), "scale evenly"),
        (lambda d: d["nodes"][0].update(children=[0]), "loop"),
        (lambda d: d["accessors"][1].update(count=10**9), "expected .* bytes"),
        (lambda d: d["accessors"][0].pop("bufferView"), "sparse or compressed"),
        (lambda d: d["accessors"][2].update(type="MAT4"), "malformed"),
        (lambda d: d.pop("nodes"), "malformed"),
        (lambda d: d["meshes"][0]["primitives"][0].pop("extensions"), "found none"),
        (
            lambda d: d["meshes"][0]["primitives"][0]["extensions"][EXTENSION].update(kernel="x"),
            "kernel: expected ellipse",
        ),
    ],
)
def test_what_is_not_read_is_named(tmp_path, change, named):
    document, binary = chunks(written(tmp_path / "a.glb", some_splats()))
    change(document)
    with pytest.raises(UserError, match=named):
        read_glb_splats(rewritten(tmp_path / "b.glb", document, binary))


def test_a_short_file_is_named(tmp_path):
    path = written(tmp_path / "a.glb", some_splats())
    raw = path.read_bytes()
    for size in (0, 10, 30, len(raw) - 1):
        path.write_bytes(raw[:size])
        with pytest.raises(UserError, match=r"a\.glb"):
            read_glb_splats(path)


def test_convert_goes_there_and_back_without_loss(tmp_path, capsys):
    splats = some_splats(bands=16)
    write_splats(tmp_path / "a.ply", splats)
    words = ["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.glb")]
    assert main(words) == 0
    assert "lost" not in capsys.readouterr().out
    means = read_glb_splats(tmp_path / "b.glb")[0].means
    torch.testing.assert_close(means, splats.means * torch.tensor([-1.0, -1, 1]))
    assert main(["convert", str(tmp_path / "b.glb"), str(tmp_path / "c.ply")]) == 0
    assert "y up" in capsys.readouterr().out
    back = read_splats(tmp_path / "c.ply").splats
    sign = (back.quaternions * splats.quaternions).sum(dim=1, keepdim=True).sign()
    back = dataclasses.replace(back, quaternions=sign * back.quaternions)  # q and -q turn alike
    assert_same(back, splats, atol=1e-5, rtol=1e-4)


def test_a_negative_scale_is_named(tmp_path):
    splats = some_splats()
    splats.scales[3, 1] = -0.1
    path = written(tmp_path / "a.glb", splats)
    with pytest.raises(UserError, match=r"a\.glb: scale: expected no negative one, found 1 splats"):
        read_glb_splats(path)


@pytest.mark.parametrize(
    ("group", "name"),
    [("bufferViews", "byteOffset"), ("accessors", "count"), ("nodes", "children")],
)
def test_numbers_that_cannot_be_held_are_named(tmp_path, group, name):
    path = written(tmp_path / "a.glb", some_splats())
    document, binary = chunks(path)
    document[group][0][name] = [float("inf")] if name == "children" else float("inf")
    with pytest.raises(UserError, match=r"a\.glb: GLB: malformed document"):
        read_glb_splats(rewritten(path, document, binary))
