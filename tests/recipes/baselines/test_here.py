"""Baselines that are made here come out in P's file frame, and enter the table."""

import shutil

import numpy as np
import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.folders import read_object_folder
from gscomplete.priors import load_prior
from gscomplete.splats import read_splats
from gscomplete.util.optional import import_open3d
from gscomplete.views import ObjectFrame, ViewDistribution
from recipes.baselines.bank import (
    Bank,
    make_bank,
    nearest,
    read_bank,
    write_bank,
)
from recipes.baselines.bank import (
    Options as BankOptions,
)
from recipes.baselines.here import METHODS, completed_here, read_part
from recipes.baselines.make import ALL, Options, main
from recipes.baselines.registry import SYSTEMS
from tests.builders.folders import write_object_folder
from tests.builders.mesh_pack import write_pack
from tests.builders.objects import round_splats


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Half a ball, y up, beside the origin, red in front."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(3000, 3))
    points /= 2 * np.linalg.norm(points, axis=1, keepdims=True)
    color = torch.from_numpy(np.where(points[:, :1] > 0, [[0.8, 0.2, 0.2]], [[0.2, 0.2, 0.8]]))
    ball = round_splats(points + np.array([5.0, 0, 0]), scale=0.02, color=color.float())
    half = ball.select(ball.means[:, 0] > 5.0)
    folder = tmp_path_factory.mktemp("open")
    write_object_folder(
        folder / "ball", half, ball, frame=ObjectFrame("Y", (5.0, 0.0, 0.0), 1.0),
        views=ViewDistribution(0.0, 10.0),
    )  # fmt: skip
    return folder


def test_the_registry_names_what_is_made_here():
    here = {name for name, system in SYSTEMS.items() if system.enters == ("made here",)}
    assert here == set(METHODS)


@pytest.mark.parametrize("method", ["partial", "likeliest_mirror", "best_mirror"])
def test_p_and_its_mirror_images_begin_with_p(dataset, method):
    known = read_object_folder(dataset / "ball")
    part = read_part(known, load_prior("embedded"), None)
    made = completed_here(method, part)
    given = read_splats(known.partial).splats
    assert float((made.means[: len(given)] - given.means).abs().max()) < 1e-4
    assert len(made) == len(given) * (1 if method == "partial" else 2)


def test_poisson_closes_half_a_ball(dataset):
    try:
        import_open3d("the test")
    except UserError as error:
        pytest.skip(str(error))
    known = read_object_folder(dataset / "ball")
    part = read_part(known, load_prior("embedded"), None)
    made = completed_here("poisson", part)
    new = made.means[len(part.partial) :].numpy()
    assert len(new) > 500
    assert (new[:, 0] < 5.05).mean() > 0.65  # where P has nothing; it flares at the rim
    assert np.linalg.norm(new - [5.0, 0, 0], axis=1).max() < 1.0


def test_the_nearest_object_of_a_bank_is_found_turned_and_moved_to_p(dataset, tmp_path):
    write_bank(
        make_bank(BankOptions(write_pack(tmp_path / "pack"), tmp_path, 5)), tmp_path / "b.npz"
    )
    boxes = read_bank(tmp_path / "b.npz")
    assert boxes.ids == ("a/red",)  # the train split's, with colours
    rng = np.random.default_rng(1)
    ball = rng.normal(size=(4096, 3)).astype(np.float32)
    ball /= 2 * np.linalg.norm(ball, axis=1, keepdims=True)
    paint = np.where(ball[:, :1] > 0, [[0.2, 0.2, 0.8]], [[0.8, 0.2, 0.2]]).astype(np.float32)
    bank = Bank(
        (*boxes.ids, "ball"),
        np.concatenate([boxes.points, ball[None]]),
        np.concatenate([boxes.colors, paint[None]]),
    )
    write_bank(bank, tmp_path / "b.npz")
    known = read_object_folder(dataset / "ball")
    part = read_part(known, load_prior("embedded"), read_bank(tmp_path / "b.npz"))
    made = completed_here("nearest_mesh", part)
    away = np.linalg.norm(made.means.numpy() - [5.0, 0, 0], axis=1)
    assert np.abs(away - 0.5).mean() < 0.02
    red = made.base_colors[:, 0] > 0.5
    assert float((made.means[red, 0] > 5.0).float().mean()) > 0.9  # half a turn
    assert nearest(boxes, *(x[0] for x in (boxes.points, boxes.colors))).distance < 0.15


def test_a_dataset_is_completed_by_all_methods_and_goes_on(dataset, tmp_path, capsys):
    assert set(ALL) == set(METHODS)
    known = read_object_folder(dataset / "ball")
    write_object_folder(
        tmp_path / "open/half", read_splats(known.partial).splats, frame=known.frame,
        views=known.views,
    )  # fmt: skip
    shutil.copytree(dataset / "ball", tmp_path / "open/ball")
    out = tmp_path / "out"
    options = Options(tmp_path / "open", out, ("partial", "best_mirror", "nearest_mesh"))
    assert main(options) == 0
    told = capsys.readouterr()
    assert "best_mirror: none of half: it chooses with the complete object" in told.out
    assert "nearest_mesh: left out: it needs --bank" in told.err
    made = sorted(path.relative_to(out).as_posix() for path in out.glob("*/*.ply"))
    assert made == ["best_mirror/ball.ply", "partial/ball.ply", "partial/half.ply"]
    (out / "partial/half.ply").unlink()
    before = (out / "partial/ball.ply").stat().st_mtime_ns
    (tmp_path / "open/half/partial.ply").write_bytes(b"damaged")
    assert main(options) == 1
    assert "none of half" in capsys.readouterr().out
    assert (out / "partial/ball.ply").stat().st_mtime_ns == before


def test_retrieval_needs_a_bank(dataset):
    part = read_part(read_object_folder(dataset / "ball"), load_prior("embedded"), None)
    with pytest.raises(UserError, match="nearest_mesh: --bank: expected the file of a bank"):
        completed_here("nearest_mesh", part)
