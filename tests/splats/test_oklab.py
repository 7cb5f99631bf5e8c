"""Oklab: there and back, known colours, and how far a part's colours are apart."""

import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from gscomplete.splats.oklab import color_spread, oklab_from_srgb, srgb_from_oklab
from tests.builders.objects import round_splats


@hypothesis_settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0, 1), min_size=3, max_size=3))
def test_oklab_and_back(color):
    srgb = torch.tensor([color], dtype=torch.float64)
    assert torch.allclose(srgb_from_oklab(oklab_from_srgb(srgb)), srgb, atol=1e-6)


def test_oklab_of_known_colours():
    white, red = oklab_from_srgb(torch.tensor([[1.0, 1.0, 1.0], [1.0, 0.0, 0.0]]))
    assert white.tolist() == pytest.approx([1.0, 0.0, 0.0], abs=1e-3)
    assert red.tolist() == pytest.approx([0.62796, 0.22486, 0.12585], abs=1e-3)


@hypothesis_settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(0, 1), min_size=3, max_size=3), st.integers(1, 50))
def test_one_colour_has_no_spread(color, count):
    splats = round_splats(torch.zeros(count, 3), scale=0.1, color=torch.tensor(color))
    assert color_spread(splats) < 1e-6


def test_black_and_white_are_half_their_distance_from_their_mean():
    colors = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    splats = round_splats(torch.zeros(2, 3), scale=0.1, color=colors)
    assert color_spread(splats) == pytest.approx(0.5, abs=1e-3)
