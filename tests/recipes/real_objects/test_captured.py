import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from recipes.real_objects.captured import captured_part
from tests.builders.objects import ball

COMPLETE = ball(3000)
STEPS = 80


@pytest.fixture(scope="module")
def part():
    return captured_part(COMPLETE, np.random.default_rng(4), STEPS)


def test_a_capture_shows_one_side_of_the_object(part):
    points = part.means.double().numpy()
    away, nearest = cKDTree(COMPLETE.means.double().numpy()).query(points)
    assert np.median(away) < 0.04  # radius .5; a short training
    shown = COMPLETE.means[torch.from_numpy(np.unique(nearest[away < 0.02]))].mean(dim=0)
    assert float(shown[:2].norm()) > 0.05 * float(COMPLETE.means.abs().max())
    assert 300 < len(part) < 30_000


def test_its_box_is_about_the_object_and_above_the_table(part):
    low, high = (bound - part.means for bound in COMPLETE.bounds())
    assert float(low[:, :2].amax()) < 0.021
    assert float(high.amin()) > -0.021
    assert float(low[:, 2].amax()) < 0


def test_it_is_a_function_of_its_random_numbers():
    made, again = (captured_part(COMPLETE, np.random.default_rng(4), 2) for _ in range(2))
    assert torch.equal(made.means, again.means)
    assert torch.equal(made.sh, again.sh)
