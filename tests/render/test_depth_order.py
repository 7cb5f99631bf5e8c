"""The radix sort gives the order of a stable sort of the upper 44 bits, whatever the depths."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gscomplete.render.cpu.depth_order import depth_order

LOWER_BITS = np.uint64(20)


def expected(visible, depths):
    index = np.flatnonzero(visible)
    keys = depths.view(np.uint64)[index] >> LOWER_BITS
    order = np.argsort(keys, kind="stable")
    return index[order], keys[order]


@given(
    hnp.arrays(
        np.float64,
        st.integers(0, 60),
        elements=st.floats(5e-324, 1e38) | st.sampled_from([1.0, 2.0, np.nextafter(2.0, 0.0)]),
    ),
    st.randoms(use_true_random=False),
)
def test_order_and_keys_are_those_of_a_stable_sort(depths, random):
    visible = np.array([random.random() < 0.8 for _ in depths], np.uint8)
    index, keys = depth_order(visible, depths.view(np.uint64))
    wanted_index, wanted_keys = expected(visible, depths)
    np.testing.assert_array_equal(index, wanted_index)
    np.testing.assert_array_equal(keys, wanted_keys)


@pytest.mark.parametrize("factor", [1.0, 1 + 1e-9, 1.001, 2.0, 1e30])
def test_every_number_of_digits(factor):
    """From none, where all keys are the same, to all four."""
    depths = 1.5 * factor ** np.random.default_rng(0).random(5000)
    visible = np.ones(5000, np.uint8)
    found = depth_order(visible, depths.view(np.uint64))
    for one, other in zip(found, expected(visible, depths), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("share", [0.0, 0.001, 0.5])
def test_many_splats_at_nearly_the_same_depth(threads, share):
    """A wall and far floaters: bits of the wall lie below the two digits that are sorted first."""
    rng = np.random.default_rng(0)
    wall = 2.0 + 1e-9 * rng.random(40_000)
    depths = np.where(rng.random(40_000) < share, rng.uniform(1, 1e6, 40_000), wall)
    visible = (rng.random(40_000) < 0.9).astype(np.uint8)
    before = numba.get_num_threads()
    numba.set_num_threads(min(threads, before))
    try:
        found = depth_order(visible, depths.view(np.uint64))
    finally:
        numba.set_num_threads(before)
    for one, other in zip(found, expected(visible, depths), strict=True):
        np.testing.assert_array_equal(one, other)
