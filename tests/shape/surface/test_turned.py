import numpy as np
import pytest
import torch

from gscomplete.shape.evidence import gather_evidence
from gscomplete.shape.surface.turned import _DRAWN, _TIMES, _against_others, turned_surface
from gscomplete.splats.geometry.axis_coordinates import Axis, Turning
from gscomplete.splats.geometry.revolution import find_revolution
from gscomplete.views import ViewDistribution
from tests.builders.objects import round_splats
from tests.builders.vases import HEIGHT, foot, handle, vase, vase_radius

VIEWS = ViewDistribution(90.0, 15.0)
"""Half a vase has its outside there."""
DOWN = np.array([0.0, 0.0, HEIGHT / 2])
SPACING = 0.01


def turn(points, seed=0):
    """Turn a part of the vase about its axis, in the object frame."""
    placed = points - DOWN
    splats = round_splats(torch.from_numpy(placed).float(), scale=SPACING)
    revolution = find_revolution(placed)
    assert revolution is not None
    generator = torch.Generator().manual_seed(seed)
    return turned_surface(placed, revolution, gather_evidence(splats, VIEWS), generator)


def half(azimuths_deg=(0.0, 180.0)):
    return vase(azimuths_deg=azimuths_deg)


def at(radius, azimuth_deg, height):
    """A place about the axis of the vase, object frame."""
    angle = np.deg2rad(azimuth_deg)
    place = np.array([radius * np.cos(angle), radius * np.sin(angle), height]) - DOWN
    return torch.from_numpy(place).float()[None]


def test_what_half_a_vase_lacks_is_the_other_half():
    found = turn(half())
    assert found is not None
    assert len(found.points) / (_TIMES * _DRAWN) == pytest.approx(0.5, abs=0.03)
    points = found.points.numpy() + DOWN
    off = np.abs(np.hypot(points[:, 0], points[:, 1]) - vase_radius(points[:, 2]))
    # the axis is off by .002, the mean of twelve neighbours cuts the waves of the wall by as much
    assert np.quantile(off, 0.99) < 0.008
    assert (points[:, 1] > 2 * SPACING).mean() < 0.01
    # all of the other half: in each of 8 x 8 patches
    angle = np.rad2deg(np.arctan2(points[:, 1], points[:, 0])) % 360
    patches, _, _ = np.histogram2d(angle, points[:, 2], bins=8, range=[[180, 360], [0, HEIGHT]])
    assert patches.min() > 100
    outward = (found.normals.numpy()[:, :2] * points[:, :2]).sum(axis=1)
    assert (outward > 0).mean() > 0.99


def test_noise_is_averaged_out():
    points = half()
    noisy = points + 0.005 * np.random.default_rng(2).standard_normal(points.shape)
    found = turn(noisy)
    assert found is not None
    places = found.points.numpy() + DOWN
    off = np.hypot(places[:, 0], places[:, 1]) - vase_radius(places[:, 2])
    # Twelve neighbours leave .0014 of the noise; the rest is the axis, off by up to .004, and waves
    # that the mean cuts. Measured: .0040.
    assert off.std() < 0.0045


def test_a_whole_vase_lacks_nothing():
    assert turn(vase()) is None


def test_what_would_hide_p_on_its_own_side_is_contradicted():
    found = turn(half())
    assert found is not None
    assert not found.against_body(found.points, found.normals).contradicts.float().mean() > 0.01
    out = at(1.0, 270.0, HEIGHT / 2)
    assert bool(found.against_body(at(0.45, 270.0, HEIGHT / 2), out).contradicts)
    inner = found.against_body(at(0.1, 270.0, HEIGHT / 2), out)  # within the wall
    assert not bool(inner.contradicts)


def test_a_handle_stays_the_only_one():
    found = turn(np.concatenate([half(), handle(10.0)]))
    assert found is not None
    out = at(1.0, 270.0, HEIGHT / 2)
    assert bool(found.against_body(at(0.42, 270.0, HEIGHT / 2), out).contradicts)
    # the back of the handle itself
    assert not bool(found.against_body(at(0.44, 10.0, HEIGHT / 2), out).contradicts)
    # no handle is turned
    assert float(found.points[:, :2].norm(dim=1).max()) < 0.35


def test_the_foot_of_a_handle_in_the_wall_is_not_turned():
    found = turn(np.concatenate([half(), foot(60.0, 0.3), foot(60.0, 0.6)]))
    assert found is not None
    places = found.points.numpy() + DOWN
    off = np.hypot(places[:, 0], places[:, 1]) - vase_radius(places[:, 2])
    assert (np.abs(off) > 0.02).mean() < 0.0005  # measured: none; if the foot is turned .0021


def test_only_what_is_beside_a_feature_may_lie_on_the_body():
    found = turn(np.concatenate([half(), handle(10.0)]))
    assert found is not None
    on_body = float(vase_radius(np.array([HEIGHT / 2]))[0]) + 0.005
    out = at(1.0, 200.0, HEIGHT / 2)
    sideways = at(1.0, 290.0, HEIGHT / 2)
    assert bool(found.against_body(at(on_body, 200.0, HEIGHT / 2), out).repeats)
    assert bool(found.against_body(at(on_body, 200.0, HEIGHT / 2), sideways).repeats)
    behind = found.against_body(at(on_body, 200.0, HEIGHT / 2), -out)  # of a thin wall
    assert not bool(behind.repeats)
    assert not bool(found.against_body(at(on_body + 0.1, 200.0, HEIGHT / 2), out).repeats)
    features = half(), foot(60.0, 0.3)
    found = turn(np.concatenate(features))
    assert found is not None
    assert not bool(found.against_body(at(on_body, 60.0, 0.3), at(1.0, 60.0, HEIGHT / 2)).repeats)


def test_colors_come_from_splats_away_from_features():
    points = np.concatenate([half(), handle(10.0)]) - DOWN
    found, splats = turn(points + DOWN), round_splats(torch.from_numpy(points).float())
    assert found is not None
    used = found.colored_by(splats).means.numpy()
    assert len(used) > 0.9 * len(half())
    assert np.hypot(used[:, 0], used[:, 1]).max() < 0.35  # the handle is farther out
    plain = turn(half())
    assert plain is not None
    without = plain.colored_by(splats)
    assert len(without) >= 0.9 * len(splats)


def test_signs_that_oppose_those_at_the_same_profile_are_reversed():
    random = np.random.default_rng(4)
    points = vase(azimuths_deg=(0.0, 180.0))
    outward = points * [1.0, 1.0, 0.0] / np.hypot(points[:, 0], points[:, 1])[:, None]
    axis = Axis.through(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    wall = np.hypot(points[:, 0], points[:, 1]) > 0.1  # the base faces down
    turning = Turning.about(axis, points[wall], outward[wall])
    sign = np.where(random.random(int(wall.sum())) < 0.1, -1.0, 1.0)
    corrected = sign * _against_others(turning, sign)
    # of twelve with a tenth wrong, six are in 5 of 10,000 places
    assert (corrected > 0).mean() > 0.998
    assert (_against_others(turning, -np.ones(len(sign))) > 0).all()  # all inward stays so


def test_places_are_a_function_of_the_seed():
    one, other, third = (turn(half(), seed=seed) for seed in (0, 0, 1))
    assert one is not None
    assert other is not None
    assert third is not None
    assert torch.equal(one.points, other.points)
    assert not torch.equal(one.points[:100], third.points[:100])
