import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.splats.geometry.n_fold import find_n_fold
from tests.builders.objects import ball, box
from tests.builders.vases import HEIGHT, faceted, handle, vase


@pytest.mark.parametrize("folds", [5, 6, 8])
@pytest.mark.parametrize("azimuths_deg", [(0.0, 360.0), (10.0, 190.0)])
def test_the_axis_and_the_number_of_sides_are_found(folds, azimuths_deg):
    found = find_n_fold(faceted(vase(azimuths_deg=azimuths_deg), folds))
    assert found is not None
    assert found.folds == folds
    assert np.abs(found.center).max() < 0.001  # a tenth of a spacing; measured: 3e-5
    assert found.is_body.mean() > 0.99


@settings(max_examples=10, deadline=None)
@given(st.floats(1e-4, 1e4), st.floats(0.0, 360.0), st.floats(-1e3, 1e3))
def test_units_place_and_azimuth_do_not_matter(scale, azimuth_deg, shift):
    angle = np.radians(azimuth_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    part = faceted(vase(6000, (0.0, 200.0)), 8)
    part[:, :2] = part[:, :2] @ turn.T + shift
    found = find_n_fold(scale * part)
    assert found is not None
    assert found.folds == 8
    assert np.abs(found.center - scale * shift).max() < 0.003 * scale  # spacings are .014


def test_what_turns_fill_is_the_whole_and_a_handle_is_no_body():
    cup = np.concatenate([faceted(vase(azimuths_deg=(0.0, 200.0)), 8), handle(100.0)])
    found = find_n_fold(cup)
    assert found is not None
    assert found.is_body[:12_000].mean() > 0.99
    # the handle's ends lie in the wall
    assert found.is_body[12_000:].mean() < 0.2
    whole = np.concatenate([faceted(vase(), 8), handle(100.0)])
    low, high = whole.min(axis=0), whole.max(axis=0)
    center, size = found.box(cup)
    np.testing.assert_allclose(center, (low + high) / 2, atol=0.01)
    assert size == pytest.approx(HEIGHT, abs=0.01)
    body = cup[found.is_body]
    there = found.turned(body, 3)
    np.testing.assert_allclose(np.hypot(*there[:, :2].T), np.hypot(*body[:, :2].T), atol=2e-3)


def test_boxes_sheets_and_thin_sticks_have_none():
    assert find_n_fold(box("Z").means.double().numpy()) is None
    sheet = np.random.default_rng(0).random((4000, 3)) * (1.0, 1.0, 0.01)
    assert find_n_fold(sheet) is None
    assert find_n_fold(faceted(vase(), 8) * (0.2, 0.2, 1.0)) is None
    assert find_n_fold(faceted(vase(), 8) * (1.0, 0.8, 1.0)) is None


def test_what_is_cut_along_its_axis_is_better_mirrored():
    part = faceted(vase(azimuths_deg=(-90.0, 90.0)), 8)
    assert find_n_fold(part, cut=(np.pi, 0.0)) is None
    beside = find_n_fold(part, cut=(np.pi, 0.02))  # the vase is .9 high, the limit .009
    assert beside is not None
    assert beside.folds == 8


def test_round_things_have_no_sides():
    for azimuths_deg in ((0.0, 360.0), (10.0, 190.0)):
        assert find_n_fold(vase(azimuths_deg=azimuths_deg)) is None


def test_too_little_has_none():
    assert find_n_fold(np.zeros((4, 3))) is None
    assert find_n_fold(np.zeros((1000, 3))) is None
    assert find_n_fold(ball(150).means.double().numpy()) is None
