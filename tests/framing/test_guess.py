"""Guesses of centre, size and input view on shapes of which the complete object is known."""

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from gscomplete.framing.guess import (
    FramingSettings,
    extended_box,
    guess_framing,
    normals_from_centroid,
    object_splats,
    score_views,
)
from gscomplete.splats import Similarity, concatenate, transform_splats
from tests.builders.objects import BALL, angle_between, cylinder, half_cylinder, round_splats
from tests.builders.vases import HEIGHT, faceted, handle, vase


@pytest.fixture
def without_axes(monkeypatch):
    """What no surface of revolution is found of has its box extended."""
    monkeypatch.setattr("gscomplete.framing.guess.find_revolution", lambda *_: None)


@pytest.mark.parametrize("azimuth_deg", [0.0, 75.0, 200.0])
@pytest.mark.parametrize("is_flat", [True, False])
def test_half_a_cylinder_is_seen_from_outside_and_completed(
    azimuth_deg: float, is_flat: bool, without_axes: None
) -> None:
    guess = guess_framing(half_cylinder(azimuth_deg, is_flat))
    assert angle_between(guess.view_azimuth_deg, azimuth_deg) <= 45
    assert np.linalg.norm(guess.center) < 0.05  # the box of P is off by 0.25
    assert guess.size == pytest.approx(1.0, abs=0.1)
    assert "extended" in guess.box_reason


@pytest.mark.parametrize("azimuth_deg", [0.0, 75.0, 200.0])
@pytest.mark.parametrize("is_flat", [True, False])
def test_half_a_cylinder_has_the_box_of_all_of_it(azimuth_deg: float, is_flat: bool) -> None:
    guess = guess_framing(half_cylinder(azimuth_deg, is_flat))
    assert angle_between(guess.view_azimuth_deg, azimuth_deg) <= 45
    assert np.linalg.norm(guess.center) < 0.002  # splats are about .03 apart; measured: .0002
    assert guess.size == pytest.approx(1.0, abs=0.002)
    assert "surface of revolution" in guess.box_reason


@pytest.mark.parametrize("offset", [-0.02, 0.02])
def test_what_is_cut_beside_its_axis_has_the_box_of_the_whole(offset: float) -> None:
    """The cut is nearly square, but P's image through it makes no ball."""
    guess = guess_framing(BALL.select(BALL.means[:, 0] < offset))
    assert "surface of revolution" in guess.box_reason
    assert np.linalg.norm(guess.center) < 0.003  # measured: .0009; the image's is off by .02
    assert guess.size == pytest.approx(1.0, abs=0.003)


def test_a_part_of_a_vase_has_the_box_of_the_whole_vase_and_its_handle() -> None:
    part = np.concatenate([vase(azimuths_deg=(20.0, 160.0)), handle(90.0)])
    guess = guess_framing(round_splats(torch.from_numpy(part).float(), scale=0.008))
    whole = np.concatenate([vase(), handle(90.0)])
    low, high = whole.min(axis=0), whole.max(axis=0)
    np.testing.assert_allclose(guess.center, (low + high) / 2, atol=0.02)  # two spacings
    assert guess.size == pytest.approx(HEIGHT, abs=0.02)
    assert "surface of revolution" in guess.box_reason


def test_a_part_of_a_vase_of_flat_sides_has_the_box_of_the_whole() -> None:
    part = faceted(vase(azimuths_deg=(-60.0, 140.0)), 8)
    guess = guess_framing(round_splats(torch.from_numpy(part).float(), scale=0.008))
    np.testing.assert_allclose(guess.center, (0.0, 0.0, HEIGHT / 2), atol=0.01)  # a spacing
    assert guess.size == pytest.approx(HEIGHT, abs=0.01)
    assert "turns of 1/8" in guess.box_reason


def test_a_complete_object_keeps_its_box() -> None:
    guess = guess_framing(cylinder())
    assert np.linalg.norm(guess.center) < 0.02
    # samples lie up to one spacing (rad) beside the ends of a diameter, where it hardly changes
    assert guess.size == pytest.approx(1.0, abs=(2 * np.pi / 3000) ** 2)


@given(st.integers(-5, 5), st.floats(-1e3, 1e3))
@settings(max_examples=5, deadline=None)
def test_place_and_size_carry_through(power: int, shift: float) -> None:
    part = half_cylinder(75.0)
    scale = 10.0**power
    moved = transform_splats(
        part, Similarity(scale, torch.eye(3), scale * torch.tensor([shift, 0.0, -shift]))
    )
    plain, found = guess_framing(part), guess_framing(moved)
    few = 4 * 2.0**-14  # steps of float32 below 1024
    assert found.size / scale == pytest.approx(plain.size, abs=few)
    expected = np.array(plain.center) + np.array([shift, 0.0, -shift])
    np.testing.assert_allclose(np.array(found.center) / scale, expected, rtol=0, atol=few)


@pytest.mark.parametrize("distance", [1.0, 1e3, 1e12])
def test_floaters_are_ignored_and_counted(distance: float) -> None:
    part = half_cylinder(0.0)
    some = part.select(torch.arange(8))
    generator = torch.Generator().manual_seed(1)
    away = torch.nn.functional.normalize(torch.randn(8, 3, generator=generator)) * (distance + 1)
    kept, reasons = object_splats(concatenate([part, dataclasses.replace(some, means=away)]))
    assert len(kept) == len(part)
    assert reasons == ["8 floating splats ignored"]


def test_a_sparse_object_is_not_taken_for_floaters() -> None:
    kept, reasons = object_splats(cylinder(40))
    assert len(kept) == 40
    assert reasons == []


def test_non_finite_splats_are_ignored_and_counted() -> None:
    part = half_cylinder(0.0)
    means = part.means.clone()
    means[:3] = torch.tensor([[np.nan, 0, 0], [np.inf, 0, 0], [0, 0, -np.inf]])
    kept, reasons = object_splats(dataclasses.replace(part, means=means))
    assert len(kept) == len(part) - 3
    assert reasons == ["3 invisible or non-finite splats ignored"]


def test_degenerate_inputs_are_user_errors() -> None:
    part = cylinder(5)
    nowhere = dataclasses.replace(part, means=torch.full((5, 3), torch.nan))
    with pytest.raises(UserError, match="finite position"):
        guess_framing(nowhere)
    point = dataclasses.replace(part, means=torch.ones(5, 3))
    with pytest.raises(UserError, match="--object-size"):
        guess_framing(point)
    with pytest.raises(UserError, match="--object-size"):
        guess_framing(part.select(torch.arange(1)))


def test_extended_box_grows_at_most_to_width_and_twice_depth() -> None:
    generator = np.random.default_rng(0)
    points = generator.random((500, 3)) * [0.2, 1.0, 0.5]
    points = np.concatenate([points, [[0, 0, 0], [0.2, 1.0, 0.5]]])
    center, size, _ = extended_box(points, 0.0)
    np.testing.assert_allclose(center, [0.2, 0.5, 0.25])  # 0.2 deep: grows to 0.4
    assert size == pytest.approx(1.0)
    center, size, _ = extended_box(points, 270.0)  # deeper than wide: stays
    np.testing.assert_allclose(center, [0.1, 0.5, 0.25], atol=1e-12)


def test_outward_normals_point_away_from_the_centroid() -> None:
    complete = cylinder()
    radial = torch.nn.functional.normalize(complete.means * torch.tensor([1.0, 1.0, 0.0]), dim=1)
    assert float((normals_from_centroid(complete) * radial).sum(dim=1).min()) > 0.99


def test_fewer_splats_grow_to_cover_the_same_surface():
    complete = cylinder(4000)
    full = score_views(complete, FramingSettings())
    thinned = score_views(complete, FramingSettings(max_splats=500))
    ratio = thinned.area / full.area
    assert 0.85 < float(ratio.min()) <= float(ratio.max()) < 1.15


@pytest.mark.parametrize("azimuth", [0.0, 120.0, 250.0])
def test_the_complete_object_reaches_behind_what_one_scanner_saw(azimuth, without_axes):
    """A shallow part that is open to the side of the scanner's axis grows along that axis."""
    along = np.deg2rad(azimuth)
    away = -torch.tensor([np.cos(along), np.sin(along), 0.0])
    half = half_cylinder(azimuth + 60.0)
    flattened = half.means - 0.6 * (half.means @ away.float())[:, None] * away.float()
    part = dataclasses.replace(half, means=flattened)
    guess, free = guess_framing(part, seen_from_deg=azimuth), guess_framing(part)

    def growth(center: tuple[float, float, float]) -> float:
        depths = part.means.double() @ away
        return float(torch.tensor(center).double() @ away - (depths.min() + depths.max()) / 2)

    # It is less than half as deep as wide, so its box becomes twice as deep.
    assert growth(guess.center) == pytest.approx(
        0.5 * np.ptp((part.means @ away.float()).numpy()), rel=1e-3
    )
    assert growth(free.center) < 0.95 * growth(guess.center)
    assert free.view_azimuth_deg == guess.view_azimuth_deg
