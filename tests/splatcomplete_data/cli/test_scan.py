"""Scans with map coordinates keep their digits, and the record says what was moved."""

import json

import numpy as np
import pytest

from gscomplete.splats import Similarity, read_splats
from splatcomplete_data import cli

FAR = np.array([500_000.0, 5_300_000.0, 300.0])


@pytest.mark.parametrize("kind", ["xyz", "las"])
def test_georeferenced_scans(tmp_path, kind):
    points = np.random.default_rng(0).uniform(0, 1, (5000, 3)).round(3) + FAR
    path = tmp_path / f"a.{kind}"
    if kind == "las":
        laspy = pytest.importorskip("laspy")
        las = laspy.create(point_format=2, file_version="1.2")
        las.header.scales, las.header.offsets = np.full(3, 0.001), FAR
        las.x, las.y, las.z = points.T
        las.write(str(path))
    else:
        np.savetxt(path, points, fmt="%.3f")
    out, eye = tmp_path / "out", FAR + np.array([0.5, -9.5, 0.5])
    box = "500000.5,5300000.5,300.5,2,2,2"
    words = ["scan", str(path), "--box", box, "--no-outliers", "--out", str(out)]
    assert cli.main([*words, "--viewpoint", ",".join(map(str, eye))]) == 0
    record = json.loads((out / "object.json").read_text())
    moved = Similarity.from_json(record["file_from_source"])
    means = read_splats(out / "partial.ply").splats.means.double()
    back = moved.inverse().apply(means).numpy()
    np.testing.assert_allclose(np.sort(back, axis=0), np.sort(points, axis=0), atol=1e-6)
    assert any("was subtracted from the coordinates" in note for note in record["notes"])
    assert record["views"]["azimuth_deg"] == pytest.approx(270)
    assert record["boxes"][0]["center"] == [500000.5, 5300000.5, 300.5]


def test_scans_near_the_origin_are_not_moved(tmp_path):
    np.savetxt(tmp_path / "a.xyz", np.random.default_rng(0).uniform(0, 1, (500, 3)))
    out = tmp_path / "out"
    assert cli.main(["scan", str(tmp_path / "a.xyz"), "--no-outliers", "--out", str(out)]) == 0
    record = json.loads((out / "object.json").read_text())
    assert record["file_from_source"] is None
    assert not any("was subtracted" in note for note in record["notes"])


def test_levelled_points_have_z_up_and_no_other_axis(tmp_path, capsys):
    np.savetxt(tmp_path / "a.xyz", np.random.default_rng(0).uniform(0, 1, (500, 3)))
    words = ["scan", str(tmp_path / "a.xyz"), "--level", "--up", "Y", "--out", str(tmp_path / "o")]
    assert cli.main(words) == 2
    assert "--level, --up" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "named"),
    [(["--sigma", "inf"], "--sigma"), (["--object-size", "nan"], "--object-size")],
)
def test_numbers_that_are_not_finite_are_named_before_the_work(tmp_path, capsys, more, named):
    np.savetxt(tmp_path / "a.xyz", np.random.default_rng(0).uniform(0, 1, (500, 3)))
    assert cli.main(["scan", str(tmp_path / "a.xyz"), *more, "--out", str(tmp_path / "o")]) == 2
    assert f"{named}: expected a finite number" in capsys.readouterr().err


@pytest.mark.parametrize("prompt", [" ", "\udcff cube"])
def test_a_prompt_that_says_nothing_is_refused(tmp_path, capsys, prompt):
    np.savetxt(tmp_path / "a.xyz", np.random.default_rng(0).uniform(0, 1, (500, 3)))
    words = ["scan", str(tmp_path / "a.xyz"), "--prompt", prompt, "--out", str(tmp_path / "o")]
    assert cli.main(words) == 2
    assert "--prompt: expected" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["--cluster-radius", "--plane-thickness"])
@pytest.mark.parametrize("value", ["0", "-1"])
def test_lengths_in_spacings_are_positive(tmp_path, capsys, name, value):
    np.savetxt(tmp_path / "a.xyz", np.random.default_rng(0).uniform(0, 1, (500, 3)))
    words = ["scan", str(tmp_path / "a.xyz"), f"{name}={value}", "--out", str(tmp_path / "o")]
    assert cli.main(words) == 2
    assert f"{name}: expected a positive number, found {value}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "looks_for"),
    [
        (["--cluster-radius=3"], "clusters"),
        (["--cluster-radius=3", "--clusters=1", "--seed-point=.5,.5,.5"], "clusters"),
        (["--cluster-radius=3", "--clusters=1", "--propose"], "clusters"),
        (["--plane-thickness=3"], "planes"),
        (["--plane-thickness=3", "--planes=0", "--propose"], "planes"),
        (["--plane-thickness=3", "--planes=1", "--pick=boxes.txt"], "planes"),
    ],
)
def test_lengths_that_nothing_uses_are_refused(tmp_path, capsys, monkeypatch, more, looks_for):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("splatcomplete_data.cli.pick.run_page", lambda *_: 0)
    np.savetxt("a.xyz", np.random.default_rng(0).uniform(0, 1, (500, 3)))
    assert cli.main(["scan", "a.xyz", "--out", "o", *more]) == 2
    name = more[0].replace("=", " ")
    told = f"{name}: has no effect where nothing looks for {looks_for}"
    assert told in capsys.readouterr().err


def test_lengths_are_taken_where_something_uses_them(tmp_path):
    np.savetxt(tmp_path / "a.xyz", np.random.default_rng(0).uniform(0, 1, (500, 3)))
    words = ["scan", str(tmp_path / "a.xyz"), "--planes=1", "--plane-thickness=3", "--clusters=1"]
    assert cli.main([*words, "--cluster-radius=20", "--out", str(tmp_path / "o")]) == 0


@pytest.mark.parametrize("name", ["", "a/b", ".hidden", "a\nb"])
def test_an_id_that_is_no_plain_name_is_refused_before_the_work(tmp_path, capsys, name):
    words = ["scan", str(tmp_path / "none.xyz"), "--id", name, "--out", str(tmp_path / "o")]
    assert cli.main(words) == 2
    assert f"--id: expected a plain file name, found {name!r}" in capsys.readouterr().err


def test_the_current_folder_is_no_folder_to_create(tmp_path, capsys, monkeypatch):
    np.savetxt(tmp_path / "a.xyz", np.random.default_rng(0).uniform(0, 1, (500, 3)))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert cli.main(["scan", "../a.xyz", "--out", ".", "--id", "a"]) == 2
    assert "the current one" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.xyz", "here"]


def test_a_given_view_is_the_only_one_told(tmp_path):
    np.savetxt(tmp_path / "a.xyz", np.random.default_rng(0).uniform(0, 1, (500, 3)))
    out = tmp_path / "out"
    words = ["scan", str(tmp_path / "a.xyz"), "--no-outliers", "--out", str(out)]
    assert cli.main([*words, "--view", "10,20"]) == 0
    notes = json.loads((out / "object.json").read_text())["notes"]
    assert not any("input view" in note for note in notes)
    assert any("centre and size" in note or "grows" in note for note in notes)


@pytest.mark.parametrize(
    ("words", "given", "side"),
    [
        ("0 0 5 1 0 0 0", [], -1),
        ("0 0 5 1 0 0 0", ["--viewpoint=0,0,-5"], 1),
        ("0 0 0 1 0 0 0", [], 1),
        ("0 0 nan 1 0 0 0", [], 1),
        ("0 0 5", [], 1),
    ],
)
def test_a_pcd_says_where_the_scanner_stood(tmp_path, words, given, side):
    rng = np.random.default_rng(0)
    plane = np.concatenate([rng.uniform(-1, 1, (900, 2)), np.zeros((900, 1))], axis=1)
    below = rng.uniform(-0.3, 0.3, (600, 3)) - [0, 0, 0.8]  # without a viewpoint taken for above
    points = np.concatenate([plane, below])
    header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    header += f"WIDTH 1500\nHEIGHT 1\nVIEWPOINT {words}\nPOINTS 1500\nDATA ascii"
    np.savetxt(tmp_path / "a.pcd", points, header=header, comments="")
    arguments = ["scan", str(tmp_path / "a.pcd"), "--level", "--no-outliers", *given]
    assert cli.main([*arguments, "--out", str(tmp_path / "out")]) == 0
    means = read_splats(tmp_path / "out/partial.ply").splats.means
    assert float(means[:, 2].mean()) * side > 0.5
    notes = json.loads((tmp_path / "out/object.json").read_text())["notes"]
    told = "the scanner stood at 0,0,5, as the file's VIEWPOINT says"
    assert (told in notes) == (words == "0 0 5 1 0 0 0" and not given)


def test_proposed_clusters_lead_to_their_objects(tmp_path, capsys):
    from tests.builders.table_top import EYE, box, table_top

    scene = table_top([box((-0.2, 0), (0.15, 0.15, 0.2)), box((0.25, 0), (0.1, 0.1, 0.12))])
    np.savetxt(tmp_path / "a.xyz", scene.points)
    eye = "--viewpoint=" + ",".join(map(str, EYE))
    words = ["scan", str(tmp_path / "a.xyz"), eye]
    assert cli.main([*words, "--propose", "--json", "--out", str(tmp_path / "p")]) == 0
    told = capsys.readouterr()
    found = json.loads(told.out)["clusters"]
    assert [path.name for path in (tmp_path / "p").iterdir()] == ["clusters.png"]
    assert len(found) == 2
    (tmp_path / "p/clusters.png").write_text("mine")
    assert cli.main([*words, "--propose", "--out", str(tmp_path / "p")]) == 2
    assert "clusters.png: would be replaced" in capsys.readouterr().err
    assert "2: " in told.err
    for cluster, place, side in zip(found, (-0.2, 0.25), (0.15, 0.1), strict=True):
        # on the box; of its sides only the near ones are seen
        assert cluster["seed"][0] == pytest.approx(place, abs=side / 2)
        seed = "--seed-point=" + ",".join(map(str, cluster["seed"]))
        out = tmp_path / "p"  # what --propose left there gives way, and the object before
        assert cli.main([*words, seed, "--level", "--overwrite", "--out", str(out)]) == 0
        splats = read_splats(out / "partial.ply").splats
        assert len(splats) == cluster["count"]
        assert float(splats.means[:, 0].median()) == pytest.approx(place, abs=side / 2)
        record = json.loads((out / "object.json").read_text())
        assert any("planes" in step["reasons"] for step in record["steps"])
