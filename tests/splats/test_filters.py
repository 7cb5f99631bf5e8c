"""Which splats can be drawn."""

import torch

from gscomplete.splats.filters import near_rows, usable_rows
from gscomplete.splats.record import Splats
from tests.builders.objects import random_splats


def test_each_reason_is_counted_once():
    splats = Splats(
        torch.zeros(7, 3), torch.ones(7, 4), torch.ones(7, 3), torch.ones(7), torch.zeros(7, 1, 3)
    )
    splats.means[1, 2] = float("nan")
    splats.sh[1] = float("nan")
    splats.quaternions[2] = float("nan")
    splats.scales[3, 0] = float("inf")
    splats.opacities[4] = float("nan")
    splats.means[5] = -1e30
    keep, counts = usable_rows(splats)
    assert keep.tolist() == [True, False, False, False, False, False, True]
    assert sum(counts.values()) == 5
    assert counts["non_finite_mean"] == counts["too_large"] == 1
    assert "non_finite_sh" not in counts


def test_one_axis_too_long_is_enough():
    splats = Splats(
        torch.zeros(2, 3), torch.ones(2, 4), torch.ones(2, 3), torch.ones(2), torch.zeros(2, 1, 3)
    )
    splats.scales[1, 2] = 1e19
    keep, counts = usable_rows(splats)
    assert keep.tolist() == [True, False]
    assert counts == {"too_large": 1}


def test_opacities_outside_0_to_1_are_of_no_use():
    opacities = torch.tensor([0.0, 1.0, 1.0 + 1e-6, 700.0, -0.1, float("inf")])
    splats = Splats(
        torch.zeros(6, 3), torch.ones(6, 4), torch.ones(6, 3), opacities, torch.zeros(6, 1, 3)
    )
    keep, counts = usable_rows(splats)
    assert keep.tolist() == [True, True, False, False, False, False]
    assert counts == {"non_finite_opacity": 1, "opacity_out_of_range": 3}


def test_no_splats():
    empty = Splats(*(torch.zeros(0, *s) for s in [(3,), (4,), (3,), (), (1, 3)]))
    keep, counts = usable_rows(empty)
    assert (len(keep), counts) == (0, {})


def test_what_is_far_outside_the_others_is_counted():
    splats = random_splats(200)
    assert near_rows(splats)[1] == {}
    splats.means[7, 1] = -1e3
    keep, counts = near_rows(splats)
    assert (~keep).nonzero().tolist() == [[7]]
    assert counts == {"far_away": 1}
    splats.means[:] = 0  # no extent: nothing is farther than another
    assert bool(near_rows(splats)[0].all())
