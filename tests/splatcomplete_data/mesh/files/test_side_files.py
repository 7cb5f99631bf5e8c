"""The files that mesh files name are found, there or not."""

import json
import struct
from pathlib import Path

import pytest

from splatcomplete_data.mesh.files.side_files import side_files


def test_obj_libraries_and_their_maps(tmp_path: Path) -> None:
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib/a.mtl").write_text(
        "newmtl m\nmap_Kd -s 1 1 1 skin.png\nmap_bump bump map.png\n"
    )
    (tmp_path / "a.obj").write_text("mtllib lib/a.mtl\nmtllib none.mtl\nv 0 0 0\n")
    found = side_files(tmp_path / "a.obj")
    assert found == {
        "lib/a.mtl": tmp_path / "lib/a.mtl",
        "none.mtl": tmp_path / "none.mtl",
        "skin.png": tmp_path / "lib/skin.png",
        "bump map.png": tmp_path / "lib/bump map.png",
    }


def test_several_libraries_in_one_line_and_names_with_spaces(tmp_path: Path) -> None:
    (tmp_path / "my lib.mtl").write_text("newmtl m\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl b.mtl\nmtllib my lib.mtl\n")
    assert list(side_files(tmp_path / "a.obj")) == ["a.mtl", "b.mtl", "my lib.mtl"]


def test_gltf_glb_dae_and_ply(tmp_path: Path) -> None:
    text = json.dumps({"buffers": [{"uri": "a%20b.bin"}], "images": [{"uri": "data:image/png,"}]})
    (tmp_path / "a.gltf").write_text(text)
    assert side_files(tmp_path / "a.gltf") == {"a%20b.bin": tmp_path / "a b.bin"}
    body = text.encode()
    head = b"glTF" + struct.pack("<IIII", 2, 20 + len(body), len(body), 0x4E4F534A)
    (tmp_path / "a.glb").write_bytes(head + body)
    assert list(side_files(tmp_path / "a.glb")) == ["a%20b.bin"]
    (tmp_path / "a.dae").write_text("<image><init_from>..\\t\\x.png</init_from></image>")
    assert list(side_files(tmp_path / "a.dae").values()) == [tmp_path / "../t/x.png"]
    (tmp_path / "a.ply").write_bytes(b"ply\ncomment TextureFile t.jpg\nend_header\n\xff\x00")
    assert list(side_files(tmp_path / "a.ply")) == ["t.jpg"]


@pytest.mark.parametrize("name", ["a.stl", "none.obj", "."])
def test_other_files_name_nothing(tmp_path: Path, name: str) -> None:
    (tmp_path / "a.stl").write_bytes(b"mtllib a.mtl\n")
    assert side_files(tmp_path / name) == {}
