"""Meshes come with their shape, place and colours, whatever the format says them in."""

import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from gscomplete.errors import UserError
from splatcomplete_data.cli.mesh import MeshOptions, make
from splatcomplete_data.mesh.files.load import BakedLight, load_mesh, mesh_to_discs
from splatcomplete_data.mesh.files.parts import GREY

DATA = Path(__file__).resolve().parents[4] / "../shared/data/mesh"

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"


def textured_quad(folder: Path) -> Path:
    """A unit square with a 4 x 4 picture: red below left, green, blue above left, white."""
    pixels = np.zeros((4, 4, 3), np.uint8)
    pixels[2:, :2], pixels[2:, 2:] = (255, 0, 0), (0, 255, 0)
    pixels[:2, :2], pixels[:2, 2:] = (0, 0, 255), (255, 255, 255)
    Image.fromarray(pixels).save(folder / "picture.png")
    (folder / "quad.mtl").write_text("newmtl m\nKd 0.4 0.4 0.4\nmap_Kd picture.png\n")
    (folder / "quad.obj").write_text(
        "mtllib quad.mtl\n" + QUAD + "usemtl m\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )
    return folder / "quad.obj"


@pytest.mark.parametrize("kind", ["obj", "stl", "ply", "glb"])
def test_a_name_that_is_no_text_is_as_good_as_another(tmp_path: Path, kind: str) -> None:
    plain, other = tmp_path / f"box.{kind}", tmp_path / f"\udcff.{kind}"
    trimesh.creation.box().export(plain)
    other.write_bytes(plain.read_bytes())
    expected, found = (mesh_to_discs(load_mesh(path), 500) for path in (plain, other))
    np.testing.assert_array_equal(found.means, expected.means)


def test_texture_lies_the_right_way_up(tmp_path: Path) -> None:
    splats = mesh_to_discs(load_mesh(textured_quad(tmp_path)), 2000)
    x, y = splats.means[:, 0].numpy(), splats.means[:, 1].numpy()
    colors = splats.base_colors.numpy()
    for left, below, color in (
        (True, True, (1, 0, 0)),
        (False, True, (0, 1, 0)),
        (True, False, (0, 0, 1)),
        (False, False, (1, 1, 1)),
    ):
        inside = (np.abs(x - (0.25 if left else 0.75)) < 0.1) & (
            np.abs(y - (0.25 if below else 0.75)) < 0.1
        )
        # one plain colour, in float32
        np.testing.assert_allclose(colors[inside].mean(axis=0), color, rtol=0, atol=1e-6)


def test_override_texture_and_missing_override(tmp_path: Path) -> None:
    path = textured_quad(tmp_path)
    Image.new("RGB", (8, 8), (10, 200, 30)).save(tmp_path / "other.png")
    splats = mesh_to_discs(load_mesh(path, texture=tmp_path / "other.png"), 100)
    expected = np.tile(np.array([10, 200, 30]) / 255, (100, 1))
    np.testing.assert_allclose(splats.base_colors.numpy(), expected, atol=1e-3)
    with pytest.raises(UserError, match=r"none\.png"):
        load_mesh(path, texture=tmp_path / "none.png")


def test_a_texture_that_cannot_be_laid_on_is_told(tmp_path: Path) -> None:
    Image.new("RGB", (8, 8), (10, 200, 30)).save(tmp_path / "other.png")
    path = textured_quad(tmp_path)
    (tmp_path / "picture.png").unlink()
    assert load_mesh(path).notes
    assert not load_mesh(path, texture=tmp_path / "other.png").notes
    plain = trimesh.creation.box()
    plain.export(tmp_path / "box.ply")
    with pytest.raises(UserError, match="--texture: expected a mesh with texture coordinates"):
        load_mesh(tmp_path / "box.ply", texture=tmp_path / "other.png")
    with_both = trimesh.Scene([trimesh.load(path, process=False), plain])
    with_both.export(tmp_path / "both.glb")
    found = load_mesh(tmp_path / "both.glb", texture=tmp_path / "other.png")
    assert any("it has no texture coordinates, and keeps" in note for note in found.notes)


def test_textures_are_found_by_the_names_that_exporters_write(tmp_path: Path) -> None:
    textured_quad(tmp_path)
    (tmp_path / "lib" / "maps").mkdir(parents=True)
    (tmp_path / "picture.png").rename(tmp_path / "lib/maps/picture.png")
    (tmp_path / "quad.mtl").unlink()
    (tmp_path / "lib/quad.mtl").write_text("newmtl m\nmap_Kd -s 1 1 1 maps\\picture.png\n")
    text = (tmp_path / "quad.obj").read_text()
    (tmp_path / "quad.obj").write_text(text.replace("quad.mtl", "lib/quad.mtl"))
    mesh = load_mesh(tmp_path / "quad.obj")
    assert mesh.parts[0].texture is not None
    assert mesh.notes == ()


def test_node_transforms_are_applied(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    matrix = trimesh.transformations.compose_matrix(
        scale=[2, 2, 2], angles=[0, 0, np.pi / 2], translate=[10, 0, 0]
    )
    scene.add_geometry(trimesh.creation.box((1, 2, 3)), transform=matrix)
    scene.export(tmp_path / "a.glb")
    low, high = load_mesh(tmp_path / "a.glb").bounds()
    np.testing.assert_allclose(high - low, [4, 2, 6], atol=1e-5)
    np.testing.assert_allclose((high + low) / 2, [10, 0, 0], atol=1e-5)


def test_gltf_factors_are_linear_unless_told_otherwise(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    factor = [0.2, 0.4, 0.6, 1.0]
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=factor)
    box.visual = trimesh.visual.TextureVisuals(material=material)
    box.export(tmp_path / "a.glb")
    encoded = (0.484529, 0.665185, 0.797738)  # 1.055 x ** (1 / 2.4) - 0.055
    for kind, expected in (("linear", encoded), ("srgb", factor[:3])):
        mesh = load_mesh(tmp_path / "a.glb", gltf_colors=kind)
        found = mesh_to_discs(mesh, 50).base_colors.numpy()
        # six digits and float32; the factors are whole 255ths, which a byte holds too
        np.testing.assert_allclose(found, np.tile(expected, (50, 1)), rtol=0, atol=1e-6)


def test_vertex_and_face_colours_and_none(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    box.export(tmp_path / "plain.obj")
    plain = mesh_to_discs(load_mesh(tmp_path / "plain.obj"), 20)
    np.testing.assert_allclose(plain.base_colors.numpy(), GREY, atol=1e-5)
    box.visual.vertex_colors = np.tile([255, 128, 0, 255], (8, 1)).astype(np.uint8)
    box.export(tmp_path / "vertex.ply")
    vertex = mesh_to_discs(load_mesh(tmp_path / "vertex.ply"), 20).base_colors.numpy()
    np.testing.assert_allclose(vertex, np.tile([1, 128 / 255, 0], (20, 1)), atol=1e-5)
    faces = trimesh.creation.box()
    faces.visual.face_colors = np.tile([0, 0, 255, 255], (12, 1)).astype(np.uint8)
    faces.export(tmp_path / "face.ply")
    face = mesh_to_discs(load_mesh(tmp_path / "face.ply"), 20).base_colors.numpy()
    np.testing.assert_allclose(face, np.tile([0, 0, 1], (20, 1)), atol=1e-5)


def test_cut_out_textures_leave_holes(tmp_path: Path) -> None:
    pixels = np.full((8, 8, 4), 255, np.uint8)
    pixels[:, 4:, 3] = 0  # the right half is transparent
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(pixels), alphaMode="MASK"
    )
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    square.visual = trimesh.visual.TextureVisuals(
        uv=[[0.02, 0], [0.98, 0], [0.98, 1], [0.02, 1]], material=material
    )
    square.export(tmp_path / "a.glb")
    splats = mesh_to_discs(load_mesh(tmp_path / "a.glb"), 1000)
    assert 400 < len(splats) < 600
    assert float(splats.means[:, 0].max()) < 0.6


def test_baked_light_darkens_what_faces_away() -> None:
    light = BakedLight((0.0, 0.0, 2.0), 0.4)
    normals = np.array([[0, 0, 1], [1, 0, 0], [0, 0, -1]], float)
    np.testing.assert_allclose(light.shade(normals), [1.0, 0.8, 0.6], atol=1e-6)


@pytest.mark.parametrize("content", [b"", b"v 0 0 0\n", b"v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n"])
def test_files_without_a_surface_are_user_errors(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.obj"
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"bad\.obj"):
        load_mesh(path)


def test_unreadable_files_are_user_errors(tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(b"not a glb at all")
    for name in ("a.glb", "missing.obj", "a.unknown"):
        with pytest.raises(UserError, match=name):
            load_mesh(tmp_path / name)


def test_real_odd_cases(caplog: pytest.LogCaptureFixture) -> None:
    if not DATA.is_dir():
        pytest.skip("real data are not here (../shared/data)")
    caplog.set_level(logging.ERROR)
    with pytest.raises(UserError, match="Draco"):
        load_mesh(DATA / "playcanvas/chess-board.glb")
    table = load_mesh(
        DATA / "aws_house/BalconyTable_01/meshes/aws_BalconyTable_01_visual.DAE",
        allow_outside=DATA,
    )
    colors = mesh_to_discs(table, 500).base_colors
    assert float((colors[:, 0] - colors[:, 2]).max()) > 0.8  # its texture lies in another folder


def test_georeferenced_meshes_keep_their_triangles(tmp_path: Path) -> None:
    east, north = np.meshgrid(0.01 * np.arange(20), 0.01 * np.arange(20), indexing="ij")
    corners = np.stack([500_000 + east, 5_300_000 + north, np.full_like(east, 300)], -1)
    lines = ["v {:.3f} {:.3f} {:.3f}".format(*corner) for corner in corners.reshape(-1, 3)]
    index = 1 + np.arange(400).reshape(20, 20)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1)
    lines += ["f {} {} {} {}".format(*quad) for quad in quads.reshape(-1, 4)]
    (tmp_path / "utm.obj").write_text("\n".join(lines))
    mesh = load_mesh(tmp_path / "utm.obj")
    assert mesh.triangles == 2 * 19 * 19
    assert mesh.degenerate == 0
    assert mesh.offset is not None
    low, high = mesh.bounds()
    np.testing.assert_allclose(low + mesh.offset, [500_000, 5_300_000, 300], atol=1e-6)
    np.testing.assert_allclose(high - low, [0.19, 0.19, 0], atol=1e-6)
    made = make(MeshOptions(file=tmp_path / "utm.obj", count=200))
    assert made.file_from_source is not None
    np.testing.assert_allclose(made.file_from_source.translation.numpy(), -np.array(mesh.offset))
    assert any("was subtracted from the coordinates" in note for note in made.notes)


def test_meshes_near_the_origin_stay_where_they_are(tmp_path: Path) -> None:
    trimesh.creation.box(transform=np.diag([1.0, 2.0, 3.0, 1.0])).export(tmp_path / "a.ply")
    assert load_mesh(tmp_path / "a.ply").offset is None
    assert make(MeshOptions(file=tmp_path / "a.ply", count=200)).file_from_source is None


def test_textures_that_cannot_be_read_are_noted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = textured_quad(tmp_path)
    assert load_mesh(path).notes == ()
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 7)  # the picture has 16, more than twice that
    (note,) = load_mesh(path).notes
    assert note.startswith("texture picture.png: parts of the mesh lack it")
    assert "exceeds limit" in note
    with pytest.raises(UserError, match=r"picture\.png: cannot read it as an image.*limit"):
        load_mesh(path, texture=tmp_path / "picture.png")
    monkeypatch.undo()
    (tmp_path / "picture.png").write_bytes(b"no picture")
    (note,) = load_mesh(path).notes
    assert note.startswith("texture picture.png: parts of the mesh lack it")


@pytest.mark.parametrize("lines", ["mtllib a.mtl\nmtllib b.mtl\n", "mtllib a.mtl b.mtl\n"])
def test_all_material_libraries_are_read(tmp_path: Path, lines: str) -> None:
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 1 0 0\n")
    (tmp_path / "b.mtl").write_text("newmtl blue\nKd 0 0 1\n")
    body = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 0 0\nv 6 0 0\nv 5 1 0\n"
    faces = "usemtl red\nf 1 2 3\nusemtl blue\nf 4 5 6\n"
    (tmp_path / "a.obj").write_text(lines + body + faces)
    mesh = load_mesh(tmp_path / "a.obj")
    assert mesh.notes == ()
    splats = mesh_to_discs(mesh, 200)
    colors, is_left = splats.base_colors.numpy(), splats.means[:, 0].numpy() < 3
    np.testing.assert_allclose(colors[is_left].mean(axis=0), (1, 0, 0), atol=1e-3)
    np.testing.assert_allclose(colors[~is_left].mean(axis=0), (0, 0, 1), atol=1e-3)


@pytest.mark.parametrize("kind", ["obj", "ply", "off"])
def test_faces_that_are_not_finite_are_counted(tmp_path: Path, kind: str) -> None:
    corners, faces = "0 0 0\n1 0 0\n0 1 0\nnan 0 1\n", "3 0 1 2\n3 0 1 3\n3 1 2 3\n"
    text = {
        "obj": "v " + corners.strip().replace("\n", "\nv ") + "\nf 1 2 3\nf 1 2 4\nf 2 3 4\n",
        "ply": "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
        "property float z\nelement face 3\nproperty list uchar int vertex_indices\nend_header\n"
        + corners
        + faces,
        "off": "OFF\n4 3 0\n" + corners + faces,
    }[kind]
    (tmp_path / f"a.{kind}").write_text(text)
    mesh = load_mesh(tmp_path / f"a.{kind}")
    assert (mesh.triangles, mesh.degenerate, mesh.non_finite) == (1, 0, 2)
