"""Files are converted so that what is up in them stays up."""

import json

import pytest
import torch
import trimesh

from gscomplete.splats import read_splats
from gscomplete.splats.formats import glb, spz
from gscomplete.splats.formats.any_file import write_any_splats
from splatcomplete_data.cli import main
from tests.builders.folders import write_run_folder
from tests.builders.objects import BALL


@pytest.fixture(scope="module")
def tall(tmp_path_factory):
    """Make an object folder of a block from y 0 to 3, which is up."""
    folder = tmp_path_factory.mktemp("tall")
    block = trimesh.creation.box((1.0, 3.0, 0.5))
    block.apply_translation([0.0, 1.5, 0.0])
    block.export(folder / "block.glb")
    arguments = ["mesh", str(folder / "block.glb"), "--count", "500", "--cut", "plane:90"]
    assert main([*arguments, "--out", str(folder / "block")]) == 0
    return folder / "block"


def test_a_folders_up_is_a_glbs_y(tall, tmp_path, capsys):
    source, target = tall / "complete.ply", tmp_path / "a.glb"
    assert main(["convert", str(source), str(target)]) == 0
    assert "written y up: not turned (Y is up, by its object folder)" in capsys.readouterr().out
    found, _ = glb.read_glb_splats(target)
    torch.testing.assert_close(found.means, read_splats(source).splats.means)


def test_up_can_be_given_and_is_minus_y_otherwise(tmp_path, capsys):
    write_any_splats(tmp_path / "a.ply", BALL)
    write_any_splats(tmp_path / "plain.glb", read_splats(tmp_path / "a.ply").splats)
    ups = {"auto": [-1, -1, 1], "-Y": [-1, -1, 1], "Y": [1, 1, 1], "0,1,0": [1, 1, 1]}
    target = tmp_path / "b.glb"
    for up, signs in ups.items():
        given = ["convert", str(tmp_path / "a.ply"), str(target), "--overwrite", f"--up={up}"]
        assert main(given) == 0
        found, _ = glb.read_glb_splats(target)
        torch.testing.assert_close(found.means, BALL.means * torch.tensor(signs))
        said = capsys.readouterr().out
        assert ("(-Y is up, assumed; --up gives another)" in said) == (up == "auto")
        is_plain = target.read_bytes() == (tmp_path / "plain.glb").read_bytes()
        assert is_plain == (up in ("auto", "-Y"))
    assert main(["convert", str(tmp_path / "a.ply"), str(target), "--overwrite", "--up=Z"]) == 0
    found, _ = glb.read_glb_splats(target)
    torch.testing.assert_close(found.means[:, 1], BALL.means[:, 2])


def test_a_folders_up_is_up_in_spz(tall, tmp_path):
    gsply = pytest.importorskip("gsply")
    target = tmp_path / "a.spz"
    assert main(["convert", str(tall / "complete.ply"), str(target)]) == 0
    raw = torch.from_numpy(gsply.read_spz(target).means)
    # discs are sunk by half a pixel of 512 for the side of 3; SPZ's steps are 1 / 4096
    sunk, step = 0.5 * 3.0 / 512, 1 / 4096
    assert raw[:, 1].min() == pytest.approx(sunk, abs=step)
    assert raw[:, 1].max() == pytest.approx(3.0 - sunk, abs=step)
    assert spz.read_spz(target).means[:, 1].max() == pytest.approx(-sunk, abs=step)


@pytest.mark.parametrize(
    ("target", "flags"),
    [
        ("a.ply", ["--up=Y"]),
        ("a.splat", ["--spz-version", "4"]),
        ("a.glb", ["--most-splats", "300"]),
    ],
)
def test_options_that_have_no_effect_are_refused(tmp_path, capsys, target, flags):
    write_any_splats(tmp_path / "b.ply", BALL)
    assert main(["convert", str(tmp_path / "b.ply"), str(tmp_path / target), *flags]) == 2
    assert f"{flags[0].partition('=')[0]} " in capsys.readouterr().err
    assert not (tmp_path / target).exists()


def test_a_runs_result_has_the_up_axis_of_its_run(tall, tmp_path, capsys):
    run = write_run_folder(tmp_path / "run", tall, BALL)
    for source in (run, run / "completed.ply"):
        target = tmp_path / "a.glb"
        assert main(["convert", str(source), str(target), "--overwrite"]) == 0
        assert "written y up: not turned (Y is up, by its run)" in capsys.readouterr().out
    arguments = ["partial", str(run / "completed.ply"), "--cut", "plane:0", "--prompt", "a thing"]
    assert main([*arguments, "--out", str(tmp_path / "part")]) == 0
    assert json.loads((tmp_path / "part/object.json").read_text())["frame"]["up"] == "Y"
