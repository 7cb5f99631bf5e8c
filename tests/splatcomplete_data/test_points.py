"""Fixed-size splats follow the cloud's density."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from splatcomplete_data.points import PointSplatSettings, median_spacing, points_to_splats


def grid(side: int, spacing: float) -> np.ndarray:
    steps = spacing * np.arange(side)
    return np.stack(np.meshgrid(steps, steps, [0.0]), axis=-1).reshape(-1, 3)


@given(st.floats(-6, 6), st.integers(2, 40))
@settings(max_examples=20, deadline=None)
def test_spacing_of_a_grid_is_its_step(power: float, side: int) -> None:
    step = 10.0**power
    assert median_spacing(grid(side, step)) == pytest.approx(step, rel=1e-6)


def test_spacing_equals_its_slow_twin_and_ignores_duplicates() -> None:
    points = np.random.default_rng(0).random((200, 3))
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1)
    np.fill_diagonal(distances, np.inf)
    expected = np.median(distances.min(axis=1))
    assert median_spacing(points) == pytest.approx(expected)
    assert median_spacing(np.concatenate([points, points])) == pytest.approx(expected)


def test_splats_sit_on_the_points_with_one_size() -> None:
    points = grid(10, 0.1) + 5.0
    colors = np.random.default_rng(0).random((100, 3))
    splats = points_to_splats(points, colors, PointSplatSettings(sigma_per_spacing=0.5))
    np.testing.assert_allclose(splats.means.numpy(), points, rtol=1e-6)
    np.testing.assert_allclose(splats.base_colors.numpy(), colors, atol=1e-6)
    np.testing.assert_allclose(splats.scales.numpy(), 0.05, rtol=1e-5)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_too_few_distinct_points_are_a_user_error(count: int) -> None:
    points = np.ones((count, 3))
    with pytest.raises(UserError, match="at least 2 distinct points"):
        points_to_splats(points, points)
