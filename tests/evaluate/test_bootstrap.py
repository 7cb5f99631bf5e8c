"""Intervals of means: the slow way, known distributions, and what moves them."""

import math
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from gscomplete.evaluate.bootstrap import bootstrap_interval

NUMBERS = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=12)


def slow_interval(values: list[float], draws: int) -> tuple[float, float]:
    """Return the interval mean by mean, its ends interpolated between ranks by hand."""
    ordered = sorted(values)
    rows = np.random.default_rng(0).integers(len(ordered), size=(draws, len(ordered))).tolist()
    means = sorted(math.fsum(ordered[k] for k in row) / len(row) for row in rows)

    def at(share: float) -> float:
        place = share * (draws - 1)
        low = math.floor(place)
        high = min(low + 1, draws - 1)
        return means[low] + (place - low) * (means[high] - means[low])

    return at(0.025), at(0.975)


@given(NUMBERS, st.sampled_from([1, 2, 41, 300]))
def test_an_interval_is_the_one_of_means_taken_one_by_one(values, draws):
    # sums of 12 numbers up to 1e3 in another order differ by less than 1e-11
    assert bootstrap_interval(values, draws) == pytest.approx(
        slow_interval(values, draws), abs=1e-9
    )


@pytest.mark.parametrize("count", [5, 8, 10, 20])
def test_the_mean_of_one_success_among_many_is_binomial(count):
    """No rank of these is nearer to 0.975 than three deviations of 2000 draws, 0.0105."""
    low, high = bootstrap_interval([1.0] + [0.0] * (count - 1))
    assert low == 0.0
    assert high * count == pytest.approx(binom.ppf(0.975, count, 1 / count))


@given(NUMBERS, st.randoms(use_true_random=False))
def test_order_changes_no_bit_and_the_ends_lie_among_the_values(values, shuffler: random.Random):
    low, high = bootstrap_interval(values, 50)
    assert bootstrap_interval(shuffler.sample(values, len(values)), 50) == (low, high)
    # a mean of equal values may be rounded away from them
    assert min(values) - 1e-9 <= low <= high <= max(values) + 1e-9


@given(NUMBERS, st.floats(0.1, 10), st.floats(-100, 100))
def test_an_interval_moves_and_grows_with_its_values(values, factor, shift):
    low, high = bootstrap_interval(values, 50)
    moved = [factor * value + shift for value in values]
    # the largest number is 1.01e4, whose rounding in float64 is 2e-12
    expected = (factor * low + shift, factor * high + shift)
    assert bootstrap_interval(moved, 50) == pytest.approx(expected, abs=1e-9)


def test_intervals_hold_the_mean_of_unequal_values():
    low, high = bootstrap_interval([1.0, 2.0, 4.0, 8.0])
    assert low < 3.75 < high


def test_more_objects_of_the_same_kind_narrow_the_interval():
    """By half for four times as many, within a sixth: 2000 draws know an end no better."""
    widths = [np.ptp(bootstrap_interval([0.0, 1.0] * count)) for count in (8, 32)]
    assert widths[1] == pytest.approx(widths[0] / 2, rel=1 / 6)


def test_one_object_leaves_nothing_to_resample():
    assert bootstrap_interval([3.0]) == (3.0, 3.0)


def test_a_value_that_is_no_number_leaves_no_interval():
    assert np.isnan(bootstrap_interval([1.0, math.nan, 2.0])).all()
