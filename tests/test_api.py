"""The public names of both packages: light to import, and doing what their commands do."""

import doctest
import importlib
import inspect
import subprocess
import sys

import pytest
import torch

import gscomplete
import splatcomplete_data as data
from gscomplete.errors import UserError
from gscomplete.splats import read_splats, write_splats
from tests.builders.commands import SAMPLE
from tests.builders.objects import BALL


@pytest.mark.parametrize("package", [gscomplete, data])
def test_every_public_name_is_there(package):
    for name in package.__all__:
        assert getattr(package, name) is not None
        assert name in dir(package)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        package.nothing  # noqa: B018


@pytest.mark.parametrize(
    "modules",
    ["gscomplete, splatcomplete_data", "gscomplete.cli.program, splatcomplete_data.cli.program"],
)
def test_importing_packages_and_commands_loads_nothing_heavy(modules):
    """What ``--help`` needs is read in a quarter of a second; PyTorch alone takes several."""
    code = (
        f"import sys, {modules}; "
        "print(sorted({'torch', 'numpy', 'numba', 'scipy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_example_of_the_package_runs(tmp_path, monkeypatch):
    """The docstring's five lines, on the sample of ``make demo``."""
    (tmp_path / "recipes").symlink_to(SAMPLE.parents[1])
    monkeypatch.chdir(tmp_path)
    failed, tried = doctest.testmod(gscomplete)
    assert (failed, tried) == (0, 5)
    saved, given = read_splats(tmp_path / "completed.ply"), read_splats(SAMPLE)
    assert saved.n_rows > given.n_rows
    old = bytes(given.payload.records)
    assert bytes(saved.payload.records)[: len(old)] == old


def test_a_mesh_becomes_splats_and_a_part(tmp_path):
    path = tmp_path / "square.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n")
    square = data.mesh_to_splats(path, 400)
    # the search for a spacing stops within 1 %
    assert len(square) == pytest.approx(400, rel=0.01)
    # Azimuth 0 looks from +x: the half with x above the middle is taken away.
    half = data.cut(square, ["plane:0"])
    assert float(half.means[:, 0].max()) <= 0.5 + 1e-6
    assert 0.4 < len(half) / len(square) < 0.6
    with pytest.raises(UserError, match="--cut: expected"):
        data.cut(square, ["slice:3"])


def test_boxes_keep_and_remove():
    assert len(data.crop(BALL, ["0,0,0,9,9,9"])) == len(BALL)
    kept = data.crop(BALL, ["0,0,0,9,9,9", "remove:9,0,0,9,9,9"])
    assert torch.equal(kept.means, BALL.means[BALL.means[:, 0] < 0])
    with pytest.raises(UserError, match="crop: expected splats inside"):
        data.crop(BALL, ["50,0,0,1,1,1"])


def test_a_scan_becomes_splats(tmp_path):
    path = tmp_path / "scan.xyz"
    rows = torch.cartesian_prod(torch.arange(5.0), torch.arange(5.0), torch.zeros(1)).tolist()
    path.write_text("".join(f"{x} {y} {z}\n" for x, y, z in rows))
    splats = data.scan_to_splats(path)
    assert len(splats) == 25
    assert float(splats.scales.std()) == 0.0
    write_splats(tmp_path / "scan.ply", splats)
    assert len(gscomplete.read_splats(tmp_path / "scan.ply").splats) == 25


def test_a_photo_and_its_depth_become_splats(tmp_path):
    import numpy as np
    from PIL import Image

    Image.new("RGB", (16, 12), (200, 30, 30)).save(tmp_path / "photo.png")
    np.save(tmp_path / "depth.npy", np.full((12, 16), 2.0, np.float32))
    splats = data.depth_to_splats(tmp_path / "photo.png", tmp_path / "depth.npy", fov_deg=60.0)
    assert len(splats) == 16 * 12
    assert torch.allclose(splats.means[:, 2], torch.tensor(2.0))


ROOMS = (
    "gscomplete",
    "splatcomplete_data",
    *(f"gscomplete.{room}" for room in ("splats", "views", "render", "priors", "folders")),
    "gscomplete.evaluate",
    "gscomplete.evaluate.align",
)


@pytest.mark.parametrize("room", ROOMS)
def test_public_functions_say_what_they_take_and_return(room):
    module = importlib.import_module(room)
    for name in module.__all__:
        function = getattr(module, name)
        if inspect.isfunction(function):
            text, signature = inspect.getdoc(function) or "", inspect.signature(function)
            assert "Args:" in text or not signature.parameters, name
            assert "Returns:" in text or signature.return_annotation == "None", name
