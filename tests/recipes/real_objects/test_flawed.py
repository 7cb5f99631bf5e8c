import numpy as np
import pytest
import torch

from recipes.real_objects.flawed import with_flaw
from tests.builders.objects import ball, half

COMPLETE = ball(6000)
PART = half(COMPLETE)


@pytest.mark.parametrize("flaw", ["flying", "haze", "table"])
def test_flaws_come_after_the_part_and_are_a_function_of_their_random_numbers(flaw):
    made, again = (with_flaw(PART, COMPLETE, flaw, np.random.default_rng(4)) for _ in range(2))
    assert torch.equal(made.means, again.means)
    assert torch.equal(made.means[: len(PART)], PART.means)
    assert len(PART) * 1.005 < len(made) < len(PART) * 1.2


def test_a_table_is_level_below_the_object_on_the_side_that_is_shown():
    made = with_flaw(PART, COMPLETE, "table", np.random.default_rng(4)).means[len(PART) :]
    assert float(made[:, 2].std()) < 0.003
    assert float((made[:, 2] - COMPLETE.means[:, 2].min()).abs().max()) < 0.01
    assert float((made[:, 0] > -0.02).float().mean()) > 0.9
    assert float(made[:, :2].abs().max()) > float(COMPLETE.means[:, :2].abs().max()) + 0.05


def test_without_a_flaw_the_part_is_as_it_was():
    assert with_flaw(PART, COMPLETE, "none", np.random.default_rng(4)) is PART
