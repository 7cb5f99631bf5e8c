"""The projection's own logarithm, which is vector code, against libm's."""

import math

import numba
import numpy as np
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from gscomplete.render.cpu.screen import natural_log


@numba.njit
def logs(values):
    """Return the logarithms of an array."""
    found = np.empty_like(values)
    for k in range(len(values)):
        found[k] = natural_log(values[k])
    return found


@hypothesis_settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(1e-300, 1e300), min_size=1, max_size=20))
def test_logarithms_are_those_of_libm(values):
    found = logs(np.array(values))
    expected = [math.log(value) for value in values]
    # The series ends at t^15 / 15 with |t| < 0.172: 2e-14 where a logarithm is small.
    assert np.allclose(found, expected, rtol=1e-13, atol=1e-13)


def test_the_logarithm_of_one_is_zero():
    assert logs(np.ones(1))[0] == 0.0
