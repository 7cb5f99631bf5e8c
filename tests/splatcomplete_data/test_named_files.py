"""What a file from elsewhere names is read only where its owner put it."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from gscomplete.errors import UserError
from splatcomplete_data import named_files
from splatcomplete_data.cli.images import ImagesOptions, make_request
from splatcomplete_data.dataset.build import build
from splatcomplete_data.dataset.recipe import Entry, Recipe
from splatcomplete_data.mesh.files.load import load_mesh
from splatcomplete_data.multiview.photos.colmap_model import read_colmap
from splatcomplete_data.multiview.photos.transforms_json import read_transforms
from splatcomplete_data.named_files import Reach
from splatcomplete_data.objects import ObjectRecord
from tests.builders import captures

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    """A textured triangle in a folder of its own, and a red picture outside."""
    Image.new("RGB", (4, 4), (200, 10, 10)).save(tmp_path / "secret.png")
    folder = tmp_path / "mesh"
    folder.mkdir()
    (folder / "a.obj").write_text("mtllib a.mtl\n" + TRIANGLE + "usemtl m\nf 1/1 2/2 3/3\n")
    (folder / "a.mtl").write_text("newmtl m\nmap_Kd ../secret.png\n")
    return folder / "a.obj"


@pytest.mark.parametrize("name", ["../secret.png", "ABSOLUTE", "linked.png", "..\\secret.png"])
def test_a_picture_outside_is_not_read_and_told(mesh: Path, name: str) -> None:
    outside = mesh.parent.parent
    (mesh.parent / "linked.png").symlink_to(outside / "secret.png")
    name = name.replace("ABSOLUTE", str(outside / "secret.png"))
    mesh.with_name("a.mtl").write_text(f"newmtl m\nmap_Kd {name}\n")
    found = load_mesh(mesh)
    assert all(part.texture is None for part in found.parts)
    (note,) = found.notes
    assert f"lies outside {mesh.parent} and is not read" in note
    assert f"--allow-outside {outside}" in note
    allowed = load_mesh(mesh, allow_outside=outside)
    assert allowed.parts[0].texture is not None
    assert allowed.notes == ()


def test_a_material_library_outside_names_nothing(mesh: Path) -> None:
    mesh.with_name("a.mtl").rename(mesh.parent.parent / "a.mtl")
    Image.new("RGB", (4, 4)).save(mesh.parent / "inside.png")
    (mesh.parent.parent / "a.mtl").write_text("newmtl m\nmap_Kd inside.png\n")
    mesh.write_text(mesh.read_text().replace("a.mtl", "../a.mtl"))
    found = load_mesh(mesh)
    texture = found.parts[0].texture
    assert texture is None or texture.shape[0] == 2  # trimesh's placeholder
    assert "../a.mtl lies outside" in found.notes[0]


@pytest.mark.parametrize("where", ["../hidden.bin", "ABSOLUTE"])
def test_a_buffer_outside_is_not_read(tmp_path: Path, where: str) -> None:
    (tmp_path / "g").mkdir()
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(trimesh.creation.box((1, 1, 1))))
    for name, content in files.items():
        (tmp_path / "g" / name).write_bytes(content)
    header = json.loads((tmp_path / "g/model.gltf").read_text())
    first = header["buffers"][0]["uri"]
    (tmp_path / "g" / first).rename(tmp_path / "hidden.bin")
    header["buffers"][0]["uri"] = where.replace("ABSOLUTE", str(tmp_path / "hidden.bin"))
    (tmp_path / "g/model.gltf").write_text(json.dumps(header))
    with pytest.raises(UserError, match=r"hidden\.bin lies outside"):
        load_mesh(tmp_path / "g/model.gltf")
    assert load_mesh(tmp_path / "g/model.gltf", allow_outside=tmp_path).triangles == 12


@pytest.mark.parametrize("kind", ["device", "pipe", "large"])
def test_only_regular_files_of_a_sane_size_are_read(mesh: Path, kind: str, monkeypatch) -> None:
    picture = mesh.parent / "p.png"
    if kind == "device":
        mesh.with_name("a.mtl").write_text("newmtl m\nmap_Kd /dev/zero\n")
    else:
        mesh.with_name("a.mtl").write_text("newmtl m\nmap_Kd p.png\n")
    if kind == "pipe":
        os.mkfifo(picture)
    if kind == "large":
        Image.new("RGB", (4, 4)).save(picture)
        monkeypatch.setattr(named_files, "MAX_FILE_BYTES", 10)
        (mesh.parent / "a.mtl").rename(mesh.parent / "b.mtl")
        reach = Reach.of(mesh)
        assert "larger than" in str(reach.refusal(picture))
        return
    found = load_mesh(mesh, allow_outside=Path("/dev"))
    assert found.parts[0].texture is None
    assert "is a device or pipe and is not read" in found.notes[0]


def test_names_that_are_no_path_are_no_file(tmp_path: Path) -> None:
    reach = Reach.of(tmp_path / "a.obj")
    assert not reach.reads(tmp_path / ("x" * 5000))
    assert not reach.reads(tmp_path / "a\0b")
    (tmp_path / "round").symlink_to(tmp_path / "round")
    assert not reach.reads(tmp_path / "round")


def test_photos_and_masks_outside_a_capture_are_not_read(tmp_path: Path) -> None:
    folder = captures.transforms_capture(tmp_path / "c")
    path = folder / "transforms.json"
    (folder / "images/photo_00.png").rename(tmp_path / "photo_00.png")
    data = json.loads(path.read_text())
    data["frames"][0]["file_path"] = "../photo_00.png"
    path.write_text(json.dumps(data))
    posed = read_transforms(path)
    assert len(posed.photos) == 7
    assert "1 of 8 frames left out (first: photo ../photo_00.png lies outside" in posed.notes[0]
    assert len(read_transforms(path, allow_outside=tmp_path).photos) == 8
    Image.new("L", (8, 8)).save(tmp_path / "mask.png")
    data["frames"][1]["mask_path"] = str(tmp_path / "mask.png")
    path.write_text(json.dumps(data))
    with pytest.raises(UserError, match=r"frames\[1\]: mask_path: .*mask\.png lies outside"):
        read_transforms(path)


def test_photos_outside_a_colmap_models_folder_are_not_read(tmp_path: Path) -> None:
    views = captures.cameras()
    names = captures.photos(tmp_path / "c/images", views)
    (tmp_path / "c/images" / names[0]).rename(tmp_path / names[0])
    names[0] = f"../../{names[0]}"
    captures.colmap_model(tmp_path / "c/sparse/0", views, names, text=False)
    with pytest.raises(UserError, match=r"photo \.\./\.\./photo_00\.png lies outside"):
        read_colmap(tmp_path / "c/sparse/0", tmp_path / "c/images")
    posed = read_colmap(tmp_path / "c/sparse/0", tmp_path / "c/images", tmp_path)
    assert len(posed.photos) == 8


@pytest.mark.parametrize("name", ["../a.ply", "ABSOLUTE"])
def test_a_recipe_names_nothing_outside_the_data(tmp_path: Path, name: str) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "a.ply").write_bytes(b"ply\n")
    file = name.replace("ABSOLUTE", str(tmp_path / "a.ply"))
    entry = Entry("cup", "scan", {"file": file, "prompt": "a cup"})
    recipe = Recipe("r", (), (entry,))
    with pytest.raises(UserError, match=r"'cup': file: .*a\.ply lies outside .*--allow-outside"):
        build(recipe, tmp_path / "data", tmp_path / "out", workers=1)
    entry.check_reach(tmp_path / "data", tmp_path)


def test_a_recipe_names_no_file_of_boxes_outside_the_data(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    values = {"file": "a.ply", "prompt": "a cup", "box": ["0,0,0,1,1,1", "../boxes.txt"]}
    entry = Entry("cup", "scan", values)
    with pytest.raises(UserError, match=r"'cup': box: \.\./boxes\.txt lies outside"):
        entry.check_reach(tmp_path / "data", None)
    entry.check_reach(tmp_path / "data", tmp_path)


def test_an_objects_files_are_plain_names(tmp_path: Path) -> None:
    from tests.builders.folders import object_record

    data = object_record().to_json()
    data["files"] = {"../../x": {"sha256": "0" * 64, "bytes": 1}}
    with pytest.raises(UserError, match=r"files: expected plain file names, found '\.\./\.\./x'"):
        ObjectRecord.from_json(data, "object.json")


def test_reach_follows_links_of_the_folder_itself(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    np.save(tmp_path / "real/a.npy", np.zeros(1))
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert Reach.of(tmp_path / "link/m.obj").reads(tmp_path / "link/a.npy")


def test_a_further_folder_has_to_be_there(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(TRIANGLE + "f 1 2 3\n")
    for name, found in (("none", "none"), ("a.obj", "a file")):
        allowed, message = tmp_path / name, f"--allow-outside .*{name}: .* folder, found {found}"
        with pytest.raises(UserError, match=message):
            load_mesh(tmp_path / "a.obj", allow_outside=allowed)
        with pytest.raises(UserError, match=message):
            build(Recipe("r", (), ()), tmp_path, tmp_path / "o", workers=1, allow_outside=allowed)
        with pytest.raises(UserError, match=message):
            make_request(ImagesOptions(images=tmp_path, allow_outside=allowed))
