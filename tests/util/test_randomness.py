"""Random numbers are functions of seed, step and purpose, and distributed as promised."""

import hashlib

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest

from gscomplete.util.randomness import generator_for, sphere_points, uniform

KNOWN = [0.53451246, 0.26162302, 0.13907456, 0.16113627]
SEEDS, PURPOSES = st.integers(-(10**6), 10**6), st.text(max_size=9)


def first(seed: int, step: int, purpose: str) -> int:
    """Return the seed of the generator, which decides all that it draws."""
    return generator_for(seed, step, purpose).initial_seed()


@given(SEEDS, SEEDS, PURPOSES.filter(lambda text: text.isprintable()))
def test_a_generator_is_seeded_with_the_digest_of_its_arguments(seed, step, purpose):
    text = f"{seed}/{step}/{purpose}".encode()
    digest = hashlib.blake2b(text, digest_size=8).digest()
    number = sum(byte << 8 * place for place, byte in enumerate(digest))
    assert first(seed, step, purpose) == number // 2


def test_every_argument_changes_what_is_drawn():
    arguments = [(s, k, p) for s in (0, 1, 11) for k in (0, 1, 11) for p in ("", "1", "view")]
    assert len({first(*each) for each in arguments}) == len(arguments)
    assert first(1, 11, "") != first(11, 1, "")


def test_nothing_else_changes_what_is_drawn():
    torch.manual_seed(1)
    one = torch.rand(4, generator=generator_for(3, 5, "view"))
    torch.manual_seed(2)
    before = torch.get_rng_state()
    two = torch.rand(4, generator=generator_for(3, 5, "view"))
    assert torch.equal(one, two)
    assert torch.equal(torch.get_rng_state(), before)
    assert one.tolist() == pytest.approx(KNOWN, abs=1e-7)  # as on other machines


def test_numbers_are_uniform_from_the_low_end_to_below_the_high_end():
    generator = generator_for(0, 0, "test")
    values = [uniform(generator, -2.0, 3.0) for _ in range(2000)]
    assert -2.0 <= min(values) < max(values) < 3.0
    assert kstest(values, "uniform", (-2.0, 5.0)).pvalue > 0.01  # always the same draws


@given(st.floats(-1e6, 1e6), st.floats(0, 1e6))
def test_a_number_lies_between_its_ends_and_is_one_draw(low, width):
    one, other = generator_for(1, 2, "one"), generator_for(1, 2, "one")
    share = float(torch.rand((), generator=other, dtype=torch.float64))
    value = uniform(one, low, low + width)
    assert low <= value <= low + width
    assert value == pytest.approx(low + share * width, rel=1e-9, abs=1e-9)
    assert torch.equal(one.get_state(), other.get_state())


def test_points_fill_the_ball_evenly():
    points = sphere_points(3000, generator_for(0, 0, "ball"))
    assert (points.shape, points.dtype) == ((3000, 3), np.float64)
    radius = np.linalg.norm(points, axis=1)
    # the share of the volume within a radius, and of the sphere below a height, are uniform
    assert radius.max() <= 1
    assert kstest(radius**3, "uniform").pvalue > 0.01
    for axis in range(3):
        assert kstest(points[:, axis] / radius, "uniform", (-1, 2)).pvalue > 0.01
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    assert kstest(azimuth, "uniform", (-np.pi, 2 * np.pi)).pvalue > 0.01
    # direction and distance know nothing of each other: 4 deviations of 1 / root of 3000
    assert abs(np.corrcoef(radius, points[:, 2] / radius)[0, 1]) < 0.073


def test_points_come_from_the_generator_alone():
    one, two = (sphere_points(5, generator_for(7, 1, "ball")) for _ in range(2))
    assert np.array_equal(one, two)
    assert sphere_points(0, generator_for(7, 1, "ball")).shape == (0, 3)
