import dataclasses

import numpy as np
import pytest
import torch

from gscomplete.priors import load_prior
from gscomplete.priors.embedded.elongated import Shortening, shortening_of
from gscomplete.shape.mirror_plane import MirrorPlane
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, cylinder, half

VIEWS = ViewDistribution(30.0, 20.0)


def found(points: np.ndarray, *, ends_in_plane: bool = False) -> Shortening | None:
    return shortening_of(points, ends_in_plane=ends_in_plane)


def pole(axis: str = "z") -> Splats:
    """Cover a pole of radius .06 and length .9 along an axis."""
    stretched = cylinder()
    means = stretched.means / stretched.means.abs().amax(dim=0) * torch.tensor([0.06, 0.06, 0.45])
    order = {"z": [0, 1, 2], "x": [2, 0, 1]}[axis]
    turned = means[:, order]
    small = stretched.scales.clamp_max(0.02)
    return dataclasses.replace(stretched, means=turned, scales=small)


def test_only_what_is_long_is_shortened():
    assert found(np.random.default_rng(0).uniform(-0.5, 0.5, (500, 3))) is None
    assert found(np.zeros((1, 3))) is None
    assert found(np.zeros((5, 3))) is None
    points = pole().means.double().numpy()
    long = found(points)
    assert long is not None
    extents = np.ptp(points @ long.matrix.T, axis=0)
    # of 3000 random heights the last ends up to a few spacings inside the end
    assert extents.max() == pytest.approx(1.0, abs=3 / 3000)
    assert extents[2] == extents.max()
    assert long.factor == pytest.approx(0.25)  # which is as short as anything becomes
    beside = points + np.array([0.2, 0, 0])  # what lacks its other half is wider than it seems
    assert found(beside) is None


def test_the_long_axis_may_lie_in_any_direction():
    points = pole("x").means.double().numpy()
    angle = np.radians(30)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    long = found(points @ turn.T)
    assert long is not None
    assert abs(long.axis @ turn[:, 0]) == pytest.approx(1.0, abs=1e-3)
    there = points @ turn.T @ long.matrix.T
    # random samples turn the axis found by .007, and the pole is .53 wide there
    assert np.ptp(there @ turn[:, 0]) == pytest.approx(1.0, abs=0.007 * 0.53)


def test_splats_come_back_and_views_are_carried():
    long = found(pole().means.double().numpy())
    assert long is not None
    there = long.splats(pole())
    assert torch.allclose(long.splats_back(there).means, pole().means, atol=1e-6)
    carried = long.views(VIEWS)
    seen = long.matrix @ VIEWS.direction()
    assert carried.direction() == pytest.approx(seen / np.linalg.norm(seen))
    assert carried.azimuth_deg == pytest.approx(30.0)
    assert carried.radius == VIEWS.radius


def test_upright_planes_are_carried_both_ways_if_the_axis_is_upright():
    upright, level = (found(pole(axis).means.double().numpy()) for axis in ("z", "x"))
    assert upright is not None
    assert level is not None
    plane = MirrorPlane(40.0, 0.1)
    there = upright.mirror(plane)
    assert isinstance(there, MirrorPlane)
    assert upright.plane_back(there) == plane
    assert found(pole("x").means.double().numpy(), ends_in_plane=True) is None
    assert found(pole("z").means.double().numpy(), ends_in_plane=True) is not None
    assert level.mirror(plane) is None  # no reflection there is one here
    assert upright.mirror(MirrorPlane(40.0, 0.9)) is None  # off the grid
    assert level.mirror("guess") == upright.mirror("guess") == "guess"
    along = level.plane_back(MirrorPlane(0.0, 0.5))  # across the axis
    assert along.offset == pytest.approx(0.5 / level.matrix[0, 0], abs=1e-3)


def test_a_long_thing_is_as_thick_as_it_should_be():
    """Half a pole is completed on its true surface; unless shortened, it is six cells wide."""
    whole = pole()
    part = whole.select(whole.means[:, 0] > 0.01)
    prior = load_prior("embedded")
    guess = prior.first_guess(
        part, VIEWS, prior.condition("a pole"), torch.Generator().manual_seed(0), 2000
    )
    assert any("P is long" in note for note in guess.notes)
    new = guess.splats.means[guess.splats.means[:, 2].abs() < 0.4]
    assert (new[:, 0] < 0).float().mean() > 0.5
    off = (new[:, :2].norm(dim=1) - 0.06).abs()
    # half a cell is .0125; in the shortened frame it is .0035 of the pole's width
    assert float(off.median()) < 0.006


@pytest.mark.parametrize("captured", [False, True])
def test_whether_p_was_captured_is_told_in_both_frames(monkeypatch, captured):
    asked_about = []

    def guess(asked, *about, **options):
        asked_about.append(asked.captured)
        raise StopIteration

    monkeypatch.setattr("gscomplete.priors.embedded.prior.guess_complete", guess)
    prior = load_prior("embedded")
    conditioning, seed = prior.condition("a thing"), torch.Generator()
    for part in (half(ball()), pole().select(pole().means[:, 0] > 0.01)):
        with pytest.raises(StopIteration):
            prior.first_guess(part, VIEWS, conditioning, seed, 10, captured=captured)
    assert asked_about == [captured, captured]
