"""Parts are cut out of files as training leaves them."""

import json

import numpy as np
import pytest
import torch
import trimesh

from gscomplete.splats import Similarity, read_splats, write_splats
from gscomplete.splats.formats.any_file import write_any_splats
from splatcomplete_data import cli
from tests.builders.folders import write_object_folder
from tests.builders.objects import BALL, half, moved


def file_with(path, means, rows):
    """Write a ball some of whose positions, chosen by their numbers, are not finite."""
    write_splats(path, BALL)
    raw = bytearray(path.read_bytes())
    start = raw.index(b"end_header\n") + len(b"end_header\n")
    size = (len(raw) - start) // len(BALL)
    for row in rows:
        raw[start + row * size : start + row * size + 4] = means
    path.write_bytes(bytes(raw))
    return path


NAN = b"\x00\x00\xc0\x7f"


def test_splats_that_cannot_be_drawn_are_left_out_and_counted(tmp_path):
    path = file_with(tmp_path / "a.ply", NAN, [3, 5])
    assert not bool(read_splats(path).splats.means.isfinite().all())
    out = tmp_path / "part"
    assert cli.main(["partial", str(path), "--cut", "plane:90", "--out", str(out)]) == 0
    record = json.loads((out / "object.json").read_text())
    step = record["steps"][0]
    assert (step["name"], step["before"], step["after"]) == ("drawable", len(BALL), len(BALL) - 2)
    assert step["reasons"] == {"non_finite_mean": 2}
    assert record["counts"]["complete"] == len(BALL) - 2
    # heights on a ball are uniform: the outermost of 4000 lie some 1 / 4000 inside
    assert record["frame"]["size_file"] == pytest.approx(1.0, abs=4 / 4000)


def test_a_file_of_nothing_else_is_a_user_error(tmp_path, capsys):
    path = file_with(tmp_path / "a.ply", NAN, range(len(BALL)))
    assert cli.main(["partial", str(path), "--cut", "plane:90", "--out", str(tmp_path / "b")]) == 2
    assert "a.ply: expected splats that can be drawn" in capsys.readouterr().err


def test_whole_files_have_no_such_step(tmp_path):
    path = file_with(tmp_path / "a.ply", NAN, [])
    out = tmp_path / "part"
    assert cli.main(["partial", str(path), "--cut", "plane:90", "--out", str(out)]) == 0
    names = [step["name"] for step in json.loads((out / "object.json").read_text())["steps"]]
    assert names == ["cut_plane"]


def test_boxes_of_a_file_cut_as_those_given_one_by_one(tmp_path):
    path = file_with(tmp_path / "a.ply", NAN, [])
    boxes = ["0,0,0,1,1,1", "remove:0.5,0,0,0.3,1,1"]
    (tmp_path / "boxes.txt").write_text("\n".join(boxes))
    flags = {"one": [f"--box={box}" for box in boxes], "file": [f"--box={tmp_path / 'boxes.txt'}"]}
    for name, given in flags.items():
        assert cli.main(["partial", str(path), *given, "--out", str(tmp_path / name / "part")]) == 0
    parts = [(tmp_path / name / "part/partial.ply").read_bytes() for name in flags]
    assert parts[0] == parts[1]
    assert len(parts[0]) < path.stat().st_size


def test_a_part_of_an_object_remembers_where_the_source_lies(tmp_path):
    box = trimesh.creation.box()
    box.apply_translation([500_000.0, 5_300_000.0, 300.0])
    (tmp_path / "far.obj").write_text(trimesh.exchange.obj.export_obj(box, digits=3))
    whole, part = tmp_path / "whole", tmp_path / "part"
    arguments = ["mesh", str(tmp_path / "far.obj"), "--count", "500", "--out", str(whole)]
    assert cli.main(arguments) == 0
    assert cli.main(["partial", str(whole), "--cut", "plane:90", "--out", str(part)]) == 0
    moved, kept = (
        json.loads((folder / "object.json").read_text())["file_from_source"]
        for folder in (whole, part)
    )
    assert kept == moved
    assert moved["translation"] == [-500_000, -5_300_000, -300]


def test_nothing_cannot_be_cut(tmp_path, capsys):
    write_splats(tmp_path / "none.ply", BALL.select(torch.arange(0)))
    words = ["partial", str(tmp_path / "none.ply"), "--cut", "plane:90"]
    assert cli.main([*words, "--out", str(tmp_path / "b")]) == 2
    assert "none.ply: expected splats, found none" in capsys.readouterr().err


def test_a_view_out_of_range_is_named(tmp_path, capsys):
    path = file_with(tmp_path / "a.ply", NAN, [])
    arguments = ["partial", str(path), "--cut", "plane:90", "--view", "2000000,0"]
    assert cli.main([*arguments, "--out", str(tmp_path / "b")]) == 2
    assert "--view: expected an azimuth" in capsys.readouterr().err


def test_a_part_of_an_spz_file_remembers_its_turned_axes(tmp_path):
    pytest.importorskip("gsply")
    path, out = tmp_path / "ball.spz", tmp_path / "part"
    write_any_splats(path, BALL)
    assert cli.main(["partial", str(path), "--cut", "plane:90", "--out", str(out)]) == 0
    turned = Similarity.from_json(json.loads((out / "object.json").read_text())["file_from_source"])
    assert turned.rotation.diagonal().tolist() == [1.0, -1.0, -1.0]


def record_of(folder):
    return json.loads((folder / "object.json").read_text())


@pytest.mark.parametrize("name", ["complete.ply", "partial.ply"])
def test_a_file_of_an_object_folder_keeps_its_up_axis(tmp_path, capsys, name):
    path = file_with(tmp_path / "a.ply", NAN, [])
    ball, part = tmp_path / "ball", tmp_path / "part"
    arguments = ["partial", str(path), "--cut", "plane:90", "--up", "X", "--prompt", "a ball"]
    assert cli.main([*arguments, "--subset", "mesh", "--out", str(ball)]) == 0
    arguments = ["partial", str(ball / name), "--cut", "plane:0", "--out", str(part)]
    assert cli.main(arguments) == 0
    record = record_of(part)
    assert (record["frame"]["up"], record["prompt"], record["subset"]) == ("X", "a ball", "mesh")
    assert "up axis assumed" not in capsys.readouterr().out
    write_splats(ball / name, BALL)  # no longer the file that the record speaks of
    assert cli.main([*arguments, "--overwrite"]) == 0
    assert record_of(part)["frame"]["up"] == "-Y"
    assert "up axis assumed to be -Y" in capsys.readouterr().out


def test_the_up_axis_of_a_splat_file_is_assumed_aloud_unless_given(tmp_path, capsys):
    path = file_with(tmp_path / "a.ply", NAN, [])
    arguments = ["partial", str(path), "--cut", "plane:90", "--out", str(tmp_path / "part")]
    assert cli.main(arguments) == 0
    assert "up axis assumed to be -Y" in capsys.readouterr().out
    assert cli.main([*arguments, "--overwrite", "--up=-Y"]) == 0
    assert "up axis assumed" not in capsys.readouterr().out
    (tmp_path / "object.json").write_text("[]")  # of something else
    assert cli.main([*arguments, "--overwrite"]) == 0


def test_the_view_of_one_scanner_is_the_input_view(tmp_path):
    path = file_with(tmp_path / "a.ply", NAN, [])
    for azimuth, elevation in ((0, 20), (137, -5)):
        out = tmp_path / f"part{azimuth}"
        words = ["partial", str(path), "--cut", f"scan:{azimuth}/{elevation}", "--up", "X"]
        assert cli.main([*words, "--out", str(out)]) == 0
        views = record_of(out)["views"]
        turned = (views["azimuth_deg"] - azimuth + 180) % 360 - 180
        assert (turned, views["elevation_deg"]) == pytest.approx((0, elevation), abs=1e-3)


def test_a_mesh_that_is_scanned_is_seen_from_the_scanner(tmp_path):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.5]])
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in ((1, 3, 2), (1, 2, 4), (2, 3, 4), (3, 1, 4)))
    rows = "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
    (tmp_path / "a.obj").write_text(rows + faces)
    words = [
        "mesh",
        str(tmp_path / "a.obj"),
        "--count",
        "2000",
        "--cut",
        "scan:200/35",
        "--up",
        "Z",
    ]
    assert cli.main([*words, "--out", str(tmp_path / "part")]) == 0
    views = record_of(tmp_path / "part")["views"]
    found = views["azimuth_deg"] % 360, views["elevation_deg"]
    assert found == pytest.approx((200, 35), abs=1e-3)
    assert cli.main([*words, "--view", "10,20", "--out", str(tmp_path / "other")]) == 0
    assert record_of(tmp_path / "other")["views"]["azimuth_deg"] == 10


def test_a_replaced_complete_object_is_doubted(tmp_path, capsys):
    folder = write_object_folder(tmp_path / "ball", half(BALL), BALL)
    words = ["partial", str(folder), "--cut=plane:90", "--out", str(tmp_path / "o"), "--overwrite"]
    assert cli.main(words) == 0
    assert "doubtful" not in capsys.readouterr().out
    write_splats(folder / "complete.ply", moved(BALL, (0.1, 0.0, 0.0)))
    assert cli.main(words) == 0
    told = f"doubtful: {folder / 'complete.ply'} is not the file that object.json records"
    assert told in capsys.readouterr().out
