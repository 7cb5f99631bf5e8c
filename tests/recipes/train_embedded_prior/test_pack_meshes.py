from pathlib import Path

import pytest
import trimesh

from gscomplete.errors import UserError
from recipes.train_embedded_prior import pack_meshes
from recipes.train_embedded_prior.data.mesh_pack import read_manifest, read_mesh
from recipes.train_embedded_prior.pack_meshes import Options


def write_meshes(folder: Path) -> Path:
    """Write a stool, two files of one ball, a hidden file and one that is no mesh."""
    (folder / "chairs" / "RedStool_02").mkdir(parents=True)
    box, ball = trimesh.creation.box((1, 1, 2)), trimesh.creation.icosphere(2)
    box.visual.face_colors, ball.visual.face_colors = (255, 0, 0, 255), (0, 0, 255, 255)
    box.export(folder / "chairs" / "RedStool_02" / "model.ply")
    ball.export(folder / "ball.glb")
    ball.export(folder / "ball.stl")
    (folder / "._ball.glb").write_bytes(b"no mesh")
    (folder / "broken cup.obj").write_text("v 0 0 0\n")
    return folder


def packed(tmp_path, **options) -> tuple[int, dict]:
    given = {"workers": 1, "source": "Mine", **options}
    asked = Options(tmp_path / "meshes", tmp_path / "pack", "CC0-1.0", **given)
    code = pack_meshes.main(asked)
    return code, {entry.id: entry for entry in read_manifest(tmp_path / "pack")}


def test_a_folder_becomes_a_pack_and_the_same_command_goes_on(tmp_path, capsys):
    write_meshes(tmp_path / "meshes")
    code, entries = packed(tmp_path)
    told = capsys.readouterr()
    assert code == 1
    assert "2 of 3 meshes packed" in told.out
    assert "broken cup.obj: " in told.err
    stool = entries["mine/chairs_redstool_02_model"]
    assert (stool.noun, stool.caption, stool.licence) == ("stool", "red stool", "CC0-1.0")
    assert (stool.split, stool.colour) == ("train", "single")
    mesh = read_mesh(tmp_path / "pack", stool)
    assert mesh.face_colors is not None
    assert mesh.face_colors.tolist() == [[1, 0, 0]] * 12
    assert read_mesh(tmp_path / "pack", entries["mine/ball"]).face_colors is not None
    file = tmp_path / "pack" / "mine" / "ball.npz"
    before = file.stat().st_mtime_ns
    (tmp_path / "meshes" / "chairs" / "RedStool_02" / "model.ply").unlink()
    assert packed(tmp_path)[1] == entries  # what was packed once stays in the pack
    assert file.stat().st_mtime_ns == before
    file.write_bytes(b"cut off")
    assert packed(tmp_path)[1] == entries
    read_mesh(tmp_path / "pack", entries["mine/ball"])
    packed(tmp_path, faces=100)
    assert len(read_mesh(tmp_path / "pack", entries["mine/ball"]).faces) <= 100


def test_words_say_what_names_do_not_and_nouns_are_held_out(tmp_path):
    write_meshes(tmp_path / "meshes")
    words = tmp_path / "words.csv"
    words.write_text("path,noun,caption,licence\nball.glb,marble,a blue marble,MIT\n")
    _, entries = packed(tmp_path, words=words, validation_share=1.0)
    ball = entries["mine/ball"]
    assert (ball.noun, ball.caption, ball.licence) == ("marble", "a blue marble", "MIT")
    assert {entry.split for entry in entries.values()} == {"validation"}
    words.write_text("path,noun\ncup.glb,cup\n")
    with pytest.raises(UserError, match=r"cup\.glb: no such mesh"):
        packed(tmp_path, words=words)
    words.write_text("file,noun\nball.glb,cup\n")
    with pytest.raises(UserError, match="column path"):
        packed(tmp_path, words=words)


def test_what_cannot_be_packed_is_refused_at_once(tmp_path):
    with pytest.raises(UserError, match="expected a folder"):
        packed(tmp_path)
    write_meshes(tmp_path / "meshes")
    for wrong in ({"faces": 3}, {"validation_share": 2.0}, {"workers": 0}):
        with pytest.raises(UserError, match=f"--{next(iter(wrong)).replace('_', '-')}: expected"):
            packed(tmp_path, **wrong)
    trimesh.creation.box().export(tmp_path / "meshes" / "Ball!.stl")
    with pytest.raises(UserError, match=r"mine/ball, as that of .*: rename it"):
        packed(tmp_path)
