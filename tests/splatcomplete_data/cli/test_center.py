"""``--center`` lies in the source's frame, whatever is taken from the coordinates."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gscomplete.folders import read_object_folder
from gscomplete.splats import Similarity, read_splats
from splatcomplete_data import cli

FAR = np.array([500_123.0, 4_200_456.0, 120.0])


def source(folder: Path, command: str, place: np.ndarray) -> Path:
    """A unit box's corner at ``place``, as points or as a mesh."""
    folder.mkdir(exist_ok=True)
    if command == "mesh":
        box = trimesh.creation.box((1, 1, 1))
        box.apply_translation(place + 0.5)
        (folder / "a.obj").write_text(trimesh.exchange.obj.export_obj(box, digits=3))
        return folder / "a.obj"
    points = np.random.default_rng(0).uniform(0, 1, (900, 3)) * [0.6, 1, 1]
    points[:600, 0] = 0.0  # a wall: levelling turns it
    np.savetxt(folder / "a.xyz", points + place, fmt="%.4f")
    return folder / "a.xyz"


def made(folder: Path, command: str, place: np.ndarray, *more: str) -> int:
    path = source(folder, command, place)
    flags = ["--count", "800"] if command == "mesh" else ["--no-outliers"]
    return cli.main([command, str(path), *flags, *more, "--out", str(folder / "out")])


@pytest.mark.parametrize(
    ("command", "more"), [("scan", []), ("scan", ["--level"]), ("mesh", ["--cut", "plane:0"])]
)
def test_the_center_moves_with_the_splats(tmp_path, command, more):
    center = FAR + np.array([0.5, 0.4, 0.3])
    words = ["--center", ",".join(map(str, center)), "--object-size", "1.5"]
    assert made(tmp_path, command, FAR, *words, *more) == 0
    record = json.loads((tmp_path / "out/object.json").read_text())
    moved = Similarity.from_json(record["file_from_source"])
    found = np.array(record["frame"]["center_file"])
    assert np.abs(found).max() < 10  # the splats lie around the origin
    back = moved.inverse().rotation.numpy() @ found + moved.inverse().translation.numpy()
    # map coordinates of seven digits before the point: float64 leaves nine behind it
    np.testing.assert_allclose(back, center, atol=1e-6, rtol=0)


def test_without_an_offset_the_center_is_taken_as_it_is(tmp_path):
    assert made(tmp_path, "scan", np.zeros(3), "--center", "0.5,0.4,0.3") == 0
    record = json.loads((tmp_path / "out/object.json").read_text())
    assert record["frame"]["center_file"] == [0.5, 0.4, 0.3]


@pytest.mark.parametrize("command", ["scan", "mesh"])
@pytest.mark.parametrize("place", [np.zeros(3), FAR])
def test_a_box_far_from_the_part_is_refused(tmp_path, capsys, command, place):
    center = place + np.array([3.0, 0.5, 0.5])
    words = [f"--center={','.join(map(str, center))}", "--object-size", "0.9"]
    assert made(tmp_path, command, place, *words) == 2
    told = capsys.readouterr().err
    assert "--center, --object-size: expected a box that holds some of the part" in told
    triples = [text.split(",") for text in re.findall(r"[-\d.e+]+,[-\d.e+]+,[-\d.e+]+", told)]
    high, found = np.array(triples[1:], np.float64)
    np.testing.assert_allclose(found, center)
    # random points reach within 0.1 of the box that they fill, those off the wall within 0.6
    assert ((high - place > [0.5, 0.9, 0.9]) & (high < place + 1.1)).all()
    assert not (tmp_path / "out").exists()


def test_a_part_on_the_face_of_the_box_touches_it(tmp_path):
    words = ["--box", "0,0,0,0.01,9,9", "--center=-0.5,0.5,0.5", "--object-size", "1"]
    assert made(tmp_path, "scan", np.zeros(3), *words) == 0


@pytest.mark.parametrize("command", ["mesh", "partial"])
def test_what_is_cut_is_given_about_the_center(tmp_path, command):
    """The plane passes through the centre that the user gives, not that of the box."""
    words = ["--center", "0.3,0.5,0.5", "--object-size", "2", "--cut", "plane:0"]
    if command == "mesh":
        assert made(tmp_path, "mesh", np.zeros(3), *words) == 0
    else:
        assert made(tmp_path / "whole", "mesh", np.zeros(3)) == 0
        whole, out = tmp_path / "whole/out", tmp_path / "out"
        assert cli.main(["partial", str(whole), *words, "--out", str(out)]) == 0
    part = read_splats(tmp_path / "out/partial.ply").splats
    # 800 splats on a unit box are .09 apart
    assert 0.3 - 0.12 < float(part.means[:, 0].max()) <= 0.3


def test_a_center_without_a_size_is_remembered(tmp_path):
    assert made(tmp_path, "scan", np.zeros(3), "--center", "0.5,0.4,0.3") == 0
    found = read_object_folder(tmp_path / "out")
    assert found.frame_origin == "guess"
    assert (found.known_center, found.known_size) == ((0.5, 0.4, 0.3), None)
