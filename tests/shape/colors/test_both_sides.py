import dataclasses
import math

import pytest
import torch

from gscomplete.shape.colors.both_sides import shows_both_sides
from gscomplete.shape.symmetry import mirror, no_symmetries
from gscomplete.splats import Splats, colors_to_sh
from tests.builders.objects import ball, half, round_splats

ACROSS = mirror(0.5 * math.pi, 0.0, 0.5)
"""Through the middle of half a ball whose far side is missing."""
FRONT_TO_BACK = mirror(0.0, 0.0, 0.5)


def painted(splats: Splats, red: torch.Tensor) -> Splats:
    """Return splats that are red or white."""
    colors = torch.where(red[:, None], torch.tensor([0.8, 0.1, 0.1]), torch.ones(3))
    return dataclasses.replace(splats, sh=colors_to_sh(colors))


def rings(splats: Splats) -> Splats:
    return painted(splats, (splats.means[:, 2] / 0.1).floor() % 2 == 0)


def label_to_one_side(splats: Splats) -> Splats:
    label = (splats.means - torch.tensor([0.25, 0.3, 0.0])).norm(dim=1) < 0.2
    return painted(splats, label)


def test_rings_that_show_on_both_sides_are_the_same_behind():
    assert shows_both_sides(rings(half(ball())), ACROSS)


def test_a_label_on_one_side_is_not():
    """Both sides show, in other colours."""
    assert not shows_both_sides(label_to_one_side(half(ball())), ACROSS)


def test_of_a_front_alone_nothing_shows_the_back():
    """A face is not mirrored to the back of a head."""
    assert not shows_both_sides(rings(half(ball())), FRONT_TO_BACK)
    assert not shows_both_sides(rings(half(ball())), no_symmetries()[0])


def test_a_strip_of_the_other_side_is_too_little():
    complete = rings(ball())
    for beyond, expected in ((0.02, False), (0.39, True)):
        strip = complete.select(complete.means[:, 0] > -beyond)
        assert shows_both_sides(strip, FRONT_TO_BACK) == expected


@pytest.mark.parametrize("count", [1, 3, 29])
def test_a_few_splats_tell_nothing(count):
    places = 0.4 * torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
    assert not shows_both_sides(round_splats(places, scale=0.02), ACROSS)
