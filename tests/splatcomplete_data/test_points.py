"""Fixed-size splats follow the cloud's density."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from splatcomplete_data.points import (
    PointSplatSettings,
    median_spacing,
    offset_for_float32,
    offset_note,
    points_to_splats,
    thin_to_spacing,
    without_offset,
)


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


@pytest.mark.parametrize("span", [8.0, 2.0**20, 2.0**22, 2.0**40])
def test_thinning_keeps_one_point_a_cube_nearest_to_its_middle(span: float) -> None:
    """However many cubes there are from end to end: 64 bits can number those of 2^21 a side."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0, span - 1, (2000, 3))
    points = np.concatenate([points, points + rng.uniform(0, 0.3, points.shape)])
    points[:3] = [[0, 0, 0], [span / 4, 0, 0], [span - 0.5] * 3]  # 2^22: the first two coincided
    kept = thin_to_spacing(points, 1.0)
    local = points - points.min(axis=0)
    best: dict[tuple[float, ...], tuple[float, int]] = {}
    for number, place in enumerate(local):
        off_center = float(np.square(place - np.floor(place) - 0.5).sum())
        cube = tuple(np.floor(place).tolist())
        best[cube] = min(best.get(cube, (np.inf, -1)), (off_center, number))
    assert np.flatnonzero(kept).tolist() == sorted(number for _, number in best.values())


@pytest.mark.parametrize(
    ("center", "extent", "finest", "expected"),
    [
        ((0.0, 0.0, 0.0), 1.0, None, None),
        ((5.0, -3.0, 40.0), 1.0, None, None),
        ((500_000.4, 5_300_000.0, 300.2), 1.0, None, (500_000.0, 5_300_000.0, 300.0)),
        ((0.3, 5_300_000.0, -0.4), 1.0, None, (0.0, 5_300_000.0, 0.0)),
        ((11.567, 48.137, 0.5), 1e-4, None, (11.567, 48.137, 0.5)),
        ((9_000.0, 0.0, 0.0), 100.0, None, None),
        ((9_000.0, 0.0, 0.0), 100.0, 0.005, (9_000.0, 0.0, 0.0)),  # splats of 5 mm
        ((0.0, 0.0, 0.0), 4_000.0, 1e-6, None),  # nothing is gained about the origin
        ((500_000.0, 0.0, 0.0), 0.0, 0.1, (500_000.0, 0.0, 0.0)),
        ((1e300, 0.0, 0.0), 1.0, None, None),
    ],
)
def test_an_offset_is_taken_where_float32_is_too_coarse(
    center: tuple[float, float, float],
    extent: float,
    finest: float | None,
    expected: tuple[float, float, float] | None,
) -> None:
    low, high = np.array(center) - extent / 2, np.array(center) + extent / 2
    offset = offset_for_float32(low, high, finest)
    assert (offset is None) == (expected is None)
    if offset is not None and expected is not None:
        np.testing.assert_allclose(offset, expected, rtol=1e-12)
        assert not np.signbit(np.array(offset)[np.array(offset) == 0]).any()
        left = np.maximum(np.abs(low - offset), np.abs(high - offset)).max()
        assert left <= 1.01 * max(extent, 0.0)
        moved = without_offset(offset).apply(torch.tensor(center, dtype=torch.float64))
        np.testing.assert_allclose(moved.numpy(), np.array(center) - offset)
        assert "file_from_source" in offset_note(offset)
