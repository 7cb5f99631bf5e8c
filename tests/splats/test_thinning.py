import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from gscomplete.render import render
from gscomplete.splats.thinning import every_nth, space_filling_order, thinned
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@hypothesis_settings(max_examples=40, deadline=None)
@given(st.integers(1, 400), st.integers(0, 400), st.integers(0, 9))
def test_each_is_chosen_once_in_order_and_grown_by_how_many_it_stands_for(count, limit, seed):
    splats = ball(count)
    chosen = thinned(splats, limit, generator(seed))
    assert len(chosen) == min(count, limit)
    rows = torch.cdist(chosen.means, splats.means).argmin(dim=1) if limit else torch.zeros(0)
    assert (rows.diff() > 0).all()
    if len(chosen):
        growth = float(chosen.scales[0, 0] / splats.scales[0, 0])
        assert growth == pytest.approx(max(1.0, count / max(limit, 1)) ** 0.5, rel=1e-5)


def test_it_is_a_function_of_splats_and_seed():
    splats = ball(2000)
    first, again, other = (thinned(splats, 300, generator(seed)) for seed in (1, 1, 2))
    assert torch.equal(first.means, again.means)
    assert not torch.equal(first.means, other.means)


@hypothesis_settings(max_examples=60, deadline=None)
@given(st.integers(0, 200), st.integers(1, 60))
def test_every_nth_row_is_kept_with_the_least_step_that_suffices(count, most):
    rows = np.arange(2 * count).reshape(count, 2)
    step = next(n for n in range(1, count + 2) if len(range(0, count, n)) <= most)
    assert every_nth(rows, most).tolist() == [rows[k].tolist() for k in range(0, count, step)]


def test_an_even_choice_shows_more_than_a_random_one():
    splats, cameras = ball(12_000), ViewDistribution(0.0, 10.0).ring(4, 96)
    rows = torch.randperm(len(splats), generator=generator())[:2000].sort().values
    random = splats.select(rows)
    random = type(splats)(**dict(random.fields()) | {"scales": random.scales * 6**0.5})
    with torch.no_grad():
        truth, even, uneven = (
            render(it, cameras).color for it in (splats, thinned(splats, 2000, generator()), random)
        )
    errors = [float((it - truth).square().mean()) for it in (even, uneven)]
    assert errors[0] < 0.8 * errors[1]


def test_neighbours_follow_each_other_along_the_curve():
    points = np.random.default_rng(0).random((4000, 3), np.float32)
    along = np.linalg.norm(np.diff(points[space_filling_order(points).numpy()], axis=0), axis=1)
    assert along.mean() < 0.2 * np.linalg.norm(np.diff(points, axis=0), axis=1).mean()


@pytest.mark.parametrize("scale", [0.0, 1e-30, 1e17])
def test_extreme_places_have_an_order(scale):
    points = (scale * np.random.default_rng(0).normal(size=(50, 3))).astype(np.float32)
    assert sorted(space_filling_order(points).tolist()) == list(range(50))
    assert len(space_filling_order(points[:0])) == 0
