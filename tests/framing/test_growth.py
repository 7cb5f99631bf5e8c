import numpy as np
import pytest
import torch
from gscomplete.framing.missing import MissingNetwork, guess_missing, oriented, partial_volume
from gscomplete.framing.missing import packaged_network as packaged
from recipes.train_embedded_prior.missing import missing_loss, missing_of

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
    model = MissingNetwork().eval()
    points, normals = points_and_normals()
    keep = points[:, 0] > 0.05
    volume = torch.from_numpy(partial_volume(points[keep], normals[keep]))[None]
    growth, share = model.averaged(volume)
    turned, expected = oriented(volume, growth, 3, True)
    found, found_share = model.averaged(turned)
    assert found.numpy() == pytest.approx(expected.numpy(), abs=1e-5)
    assert float(found_share) == pytest.approx(float(share), abs=1e-5)


def test_targets_are_how_far_the_object_reaches():
    complete = sphere()
    part = half(complete)
    target = missing_of(part, complete)
    # Half a ball of radius .4 is .8 wide; the other half reaches .4 further along x.
    assert target[:6] == pytest.approx([0.5, 0, 0, 0, 0, 0], abs=0.02)
    assert target[6] == pytest.approx(0.48, abs=0.03)
    exact = torch.from_numpy(target)[None]
    assert float(missing_loss((exact[:, :6], torch.logit(exact[:, 6])), exact)) < 0.7
    off = exact[:, :6] + 0.3
    assert float(missing_loss((off, torch.logit(exact[:, 6])), exact)) > 2.0


def test_the_packaged_network_sees_what_half_a_ball_lacks():
    assert packaged() is packaged()
    whole, part = sphere(), half(sphere())
    shares, growths = [], []
    for splats in (whole, part):
        points = splats.means.double().numpy()
        missing = guess_missing(points, points / np.linalg.norm(points, axis=1, keepdims=True))
        shares.append(missing.share)
        growths.append(missing.growth)
    assert shares[0] < 0.1 < 0.2 < shares[1]
    assert growths[0].max() < 0.05
    assert growths[1][0] > 0.2
    assert growths[1][1:].max() < 0.15
