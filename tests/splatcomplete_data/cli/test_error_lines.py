"""Error lines of the commands name the file that is wrong, and no option that was not given."""

import numpy as np
import pytest
import torch
import trimesh

import gscomplete
from gscomplete.errors import UserError
from gscomplete.splats import write_splats
from splatcomplete_data import mesh_to_splats, scan_to_splats
from tests.builders.commands import run_here
from tests.builders.objects import BALL, round_splats


def told_of(*arguments: object) -> str:
    """Run a command that fails; return its error without the program's name."""
    told = run_here(*arguments, package="splatcomplete_data")
    assert told.returncode == 2, told
    return told.stderr.splitlines()[-1].removeprefix("splatcomplete-data: error: ")


@pytest.fixture
def point(tmp_path):
    path = tmp_path / "point.ply"
    write_splats(path, round_splats(torch.ones(100, 3)))
    return path


def test_a_box_that_cannot_be_proposed_names_the_command_s_own_option(tmp_path):
    path = tmp_path / "faint.ply"
    write_splats(path, round_splats(BALL.means, opacity=0.05))
    found = "expected splats to enclose, found 0 solid ones"
    picture = ("--picture", tmp_path / "p.png")
    assert told_of("clean", path, "--background", *picture) == f"{path}: --background: {found}"
    line = told_of("crop", path, "--box=auto", "--clean=0", "--out", tmp_path / "o")
    assert line == f"{path}: --box auto: {found}; give the box as numbers"


def test_nothing_left_of_a_file_names_it(tmp_path):
    path = tmp_path / "haze.ply"
    write_splats(path, round_splats(BALL.means, opacity=1e-4))
    line = told_of("clean", path, "--strength=1", "--picture", tmp_path / "p.png")
    assert line.startswith(f"{path}: clean: nothing is left of 4,000 splats")


def test_splats_at_one_place_name_their_file(tmp_path, point):
    found = "framing: all splats are at one place"
    box = ("--box=1,1,1,1,1,1", "--out", tmp_path / "o")
    assert told_of("crop", point, *box).startswith(f"{point}: {found}")
    with pytest.raises(UserError, match=f"^{point}: {found}"):
        gscomplete.complete(point, "a point")


def test_a_transparent_mesh_is_named(tmp_path):
    path, mesh = tmp_path / "clear.glb", trimesh.creation.box()
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[255, 0, 0, 0], alphaMode="BLEND"
    )
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    mesh.export(path)
    found = f"{path}: mesh: expected an opaque surface"
    assert told_of("mesh", path, "--count=300", "--out", tmp_path / "o").startswith(found)
    assert told_of("scan", path, "--out", tmp_path / "o").startswith(found)
    with pytest.raises(UserError, match=f"^{found}"):
        mesh_to_splats(path, 300)


def test_points_at_one_place_name_their_file(tmp_path):
    path = tmp_path / "one.xyz"
    np.savetxt(path, np.ones((5, 3)))
    found = f"{path}: points: expected at least 2 distinct points, found 1"
    assert told_of("scan", path, "--out", tmp_path / "o") == found
    with pytest.raises(UserError, match=f"^{found}"):
        scan_to_splats(path)
