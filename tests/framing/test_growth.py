import numpy as np
import pytest
import torch

from gscomplete.framing.growth import (
    GrowthNetwork,
    guess_growth,
    oriented,
    packaged_network,
    partial_volume,
)
from recipes.train_embedded_prior.box_growth import growth_loss, growth_of
from recipes.train_embedded_prior.procedural.quads import turn_about
from tests.shape.shapes import half, sphere


def points_and_normals(count=4000):
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals * [0.5, 0.4, 0.3], normals


def test_turning_the_volume_is_turning_the_points():
    points, normals = points_and_normals()
    keep = points[:, 0] > 0.05  # no two turns look the same
    points, normals = points[keep], normals[keep]
    turn = turn_about("z", 90.0).astype(np.float64)
    volume = torch.from_numpy(partial_volume(points, normals))[None]
    expected = partial_volume(points @ turn.T, normals @ turn.T)
    found, growth = oriented(volume, torch.arange(6.0)[None], 1, False)
    # A point on the border of two cells may fall into the other one.
    assert np.abs(found[0].numpy() - expected).mean() < 1e-3
    # x- looks where y- was ... after a quarter turn: x+ -> y+, y+ -> x-.
    assert growth[0].tolist() == [3, 2, 0, 1, 4, 5]


def test_the_mean_over_orientations_turns_with_the_object():
    torch.manual_seed(0)
    model = GrowthNetwork().eval()
    points, normals = points_and_normals()
    keep = points[:, 0] > 0.05
    volume = torch.from_numpy(partial_volume(points[keep], normals[keep]))[None]
    growth = model.averaged(volume)
    turned, expected = oriented(volume, growth, 3, True)
    found = model.averaged(turned)
    assert found.numpy() == pytest.approx(expected.numpy(), abs=1e-5)


def test_targets_are_how_far_the_object_reaches():
    complete = sphere()
    target = growth_of(half(complete), complete)
    # Half a ball of radius .4 is .8 wide; the other half reaches .4 further along x.
    assert target == pytest.approx([0.5, 0, 0, 0, 0, 0], abs=0.02)
    exact = torch.from_numpy(target)[None]
    assert float(growth_loss(exact, exact)) == 0.0
    assert float(growth_loss(exact + 0.3, exact)) > 0.15


def test_the_packaged_network_grows_half_a_ball_to_its_open_side():
    assert packaged_network() is packaged_network()
    points = half(sphere()).means.double().numpy()
    growth = guess_growth(points, points / np.linalg.norm(points, axis=1, keepdims=True))
    assert growth[0] > 0.2
    assert growth[1:].max() < 0.15
