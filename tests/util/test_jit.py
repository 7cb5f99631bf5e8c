import numba
import numpy as np

from gscomplete.util.jit import HELPER, KERNEL, compilations_told
from gscomplete.util.stages import profiled


def _made():
    """Return a kernel that calls another one, neither compiled yet nor kept on the disk."""

    @numba.njit(**HELPER)
    def doubled(value):
        return 2 * value

    @numba.njit(**KERNEL | {"cache": False})
    def kernel(values):
        for i in range(len(values)):
            values[i] = doubled(values[i])

    return kernel


def test_compiling_is_told_once_and_counted_as_a_stage():
    told, values = [], np.ones(3)
    first, second = _made(), _made()
    with profiled() as profile, compilations_told(lambda: told.append("told")):
        first(values)
        first(values)
        second(values)
    assert (values == 8).all()
    assert told == ["told"]
    assert profile.costs["compile"].times == 2
    assert profile.costs["compile"].wall_s > 0
    _made()(values)
    assert told == ["told"]


def test_what_is_compiled_is_not_told_of():
    kernel, told = _made(), []
    kernel(np.ones(3))
    with compilations_told(lambda: told.append("told")):
        kernel(np.ones(3))
    assert told == []
