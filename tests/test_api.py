"""The public names of both packages: light to import, and doing what their commands do."""

import dataclasses
import doctest
import importlib
import inspect
import subprocess
import sys

import numpy as np
import pytest
import torch
from PIL import Image

import gscomplete
import splatcomplete_data as data
from gscomplete.errors import UserError
from gscomplete.splats import read_splats, write_splats
from gscomplete.views import ObjectFrame
from splatcomplete_data.scan.clean import CleanSettings
from splatcomplete_data.scan.cloud import PointCloud
from splatcomplete_data.scan.make import PartSettings, make_part
from tests.builders.commands import SAMPLE
from tests.builders.objects import BALL
from tests.builders.torch_states import STATES


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


@pytest.mark.parametrize("kind", ["gradients", "bfloat16"])
def test_splats_of_a_training_are_cut_and_cropped_as_they_are(kind):
    given = BALL.to(dtype=torch.bfloat16)
    plain = given.to(dtype=torch.float32)
    if kind == "gradients":
        given, plain = (dataclasses.replace(BALL, means=BALL.means.clone()) for _ in range(2))
        given.means.requires_grad_()
    for change in (
        lambda splats: data.crop(splats, ["0,0,0,.5,.5,.3"]),
        lambda splats: data.cut(splats, ["plane:90", "scan:0/20"]),
    ):
        found, expected = change(given), change(plain)
        assert found.means.requires_grad == given.means.requires_grad
        assert found.means.dtype == given.means.dtype
        assert torch.equal(found.means.detach().float(), expected.means)


@pytest.mark.parametrize(
    ("splats", "found"),
    [
        (BALL.select(torch.zeros(len(BALL), dtype=torch.bool)), "at least one splat, found none"),
        (None, "splats, found NoneType"),
        ("a.ply", "splats, found str"),
    ],
)
def test_there_are_splats_to_cut_or_crop(splats, found):
    for change in (data.crop, data.cut):
        with pytest.raises(UserError, match=f"splats: expected {found}"):
            change(splats, [])


def test_arguments_of_other_types_are_refused(tmp_path):
    for up in ((0, 0, 1), [0, 0, 1], None, 3, "Q"):
        with pytest.raises(UserError, match="up: expected"):
            data.cut(BALL, ["plane:0"], up=up)
        with pytest.raises(UserError, match="up: expected"):
            gscomplete.complete(BALL, "a ball", up=up)
    for texts in ("plane:0", None, [3]):
        with pytest.raises(UserError, match="cuts: expected a list of texts"):
            data.cut(BALL, texts)
        with pytest.raises(UserError, match="boxes: expected a list of texts"):
            data.crop(BALL, texts)
    for name in (None, "tpu", 3):
        with pytest.raises(UserError, match="--device: expected auto, cpu"):
            data.reconstruct(tmp_path, tmp_path / "out", device=name)
        with pytest.raises(UserError, match="--device: expected auto, cpu"):
            gscomplete.complete(BALL, "a ball", device=name)
    with pytest.raises(UserError, match="steps: expected at least 1, found 0"):
        data.reconstruct(tmp_path, tmp_path / "out", steps=0)
    with pytest.raises(UserError, match="negative_prompt: expected a text, found 3"):
        gscomplete.complete(BALL, "a ball", negative_prompt=3)


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
    Image.new("RGB", (16, 12), (200, 30, 30)).save(tmp_path / "photo.png")
    np.save(tmp_path / "depth.npy", np.full((12, 16), 2.0, np.float32))
    splats = data.depth_to_splats(tmp_path / "photo.png", tmp_path / "depth.npy", fov_deg=60.0)
    assert len(splats) == 16 * 12
    assert torch.allclose(splats.means[:, 2], torch.tensor(2.0))


def made_of_everything(folder):
    """Return what the data side's functions make of small sources."""
    rng = np.random.default_rng(0)
    (folder / "square.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n")
    np.save(folder / "depth.npy", np.full((12, 16), 2.0, np.float32))
    Image.new("RGB", (16, 12), (200, 30, 30)).save(folder / "photo.png")
    np.savetxt(folder / "scan.xyz", rng.uniform(0, 1, (300, 3)))
    np.savetxt(folder / "far.xyz", np.array([5e5, 5e6, 300.0]) + rng.uniform(0, 1, (300, 3)))
    table = np.concatenate([rng.uniform(-1, 1, (2000, 2)), np.zeros((2000, 1))], axis=1)
    block = np.array([0, 0, 0.2]) + rng.uniform(-0.2, 0.2, (600, 3))
    scene = PointCloud(np.concatenate([table, block]), np.full((2600, 3), 0.5, np.float32))
    levelled = PartSettings(cleaning=CleanSettings(clusters=0), level="always")
    return [
        data.mesh_to_splats(folder / "square.obj", 200),
        data.depth_to_splats(folder / "photo.png", folder / "depth.npy", fov_deg=60.0),
        data.scan_to_splats(folder / "scan.xyz", spacing=0.2),
        data.scan_to_splats(folder / "far.xyz"),
        make_part(scene, levelled, "scene").splats,
        data.crop(BALL, ["0,0,0,.3,.3,.3"]),
        data.cut(BALL, ["plane:90", "scan:0/20"], up="Y"),
        data.cut(BALL, ["box:-1,-1,-1,0,1,1"], up="0,1,.1"),
    ]


@pytest.mark.parametrize("name", STATES)
def test_the_data_side_keeps_to_pytorch_as_it_comes(tmp_path, name):
    plain = made_of_everything(tmp_path)
    with STATES[name]():
        found = made_of_everything(tmp_path)
        frame = ObjectFrame.about(BALL, "Y").to_json()
    for expected, splats in zip(plain, found, strict=True):
        for (field, before), (_, after) in zip(expected.fields(), splats.fields(), strict=True):
            assert (after.dtype, after.device) == (before.dtype, before.device), field
            assert torch.equal(after, before), field
    assert frame == ObjectFrame.about(BALL, "Y").to_json()


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


def test_what_cannot_be_completed_is_refused_before_the_work(tmp_path):
    bad = dataclasses.replace(BALL, opacities=BALL.opacities.clone())
    bad.opacities[3] = float("nan")
    for partial, prompt, message in (
        (bad, "a ball", "found 1 non finite opacity"),
        (tmp_path, "a ball", r"expected a splat file, found a folder; name the partial\.ply"),
        (BALL, None, "prompt: expected a text, found None"),
    ):
        with pytest.raises(gscomplete.UserError, match=message):
            gscomplete.complete(partial, prompt)
    with pytest.raises(TypeError, match=r"its \.splats are meant"):
        write_splats(tmp_path / "a.ply", read_splats(SAMPLE))
