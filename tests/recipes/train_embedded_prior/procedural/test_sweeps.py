import math

import numpy as np
import pytest

from recipes.train_embedded_prior.procedural.sweeps import (
    arc,
    loft,
    revolve,
    rod,
    shell_profile,
    smooth_profile,
    torus,
    tube,
)
from tests.recipes.train_embedded_prior.procedural.volume import volume

SOLIDS = {
    "torus": (lambda: torus(1, 0.25, segments=100, sides=60), 2 * math.pi**2 * 0.25**2),
    "rod": (lambda: rod((0, 0, 0), (1, 2, 2), 0.1, sides=64), 3 * math.pi * 0.01),
    "ring": (
        lambda: tube(arc(0, 360, 1, 129), 0.1, sides=48, closed=True),
        2 * math.pi**2 * 0.01,
    ),
    "shell": (
        lambda: revolve(shell_profile([(1, 0), (1, 1)], 0.1), 200),
        math.pi * (1 - 0.81 * 0.9),
    ),
    "arch": (
        lambda: tube(arc(10, 170, 1, 41, plane="yz"), 0.1, sides=32),
        160 / 180 * math.pi**2 * 0.01,
    ),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_closed_shapes_enclose_their_volume_with_normals_outward(name):
    make, expected = SOLIDS[name]
    # A polygon of n sides lacks 2 pi^2 / (3 n^2) of its circle: 0.64 % for 32, the fewest here.
    assert volume(make()) == pytest.approx(expected, rel=0.01)


def test_a_loft_through_squares_is_a_box():
    square = np.array([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)], np.float32)
    sections = np.stack([np.add(square, (x, 0, 0)) for x in (0, 1, 3)]).astype(np.float32)
    assert volume(loft(sections)) == pytest.approx(12.0)


def test_smooth_profiles_pass_through_their_ends():
    knots = np.array([(0.1, 0), (0.5, 0.4), (0.2, 1.0)])
    line = smooth_profile(knots, 11)
    assert np.allclose(line[[0, 5, 10]], knots, atol=1e-6)
