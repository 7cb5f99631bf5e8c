"""The plane that one half of an object ends at, whatever its rim is like."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.framing.cut_plane import CutPlane, find_cut
from gscomplete.framing.end_plane import find_end
from tests.builders.objects import angle_between, ball

BALL = ball().means.double().numpy()


def legs(count: int = 12_000) -> np.ndarray:  # [N, 3]
    """Four thin legs and a board over them: next to no rim is where it is cut."""
    rng = np.random.default_rng(0)
    board = rng.uniform([-0.4, -0.4, 0.3], [0.4, 0.4, 0.3], (count // 2, 3))
    board[:, 2] += 0.03 * rng.integers(2, size=len(board))
    angle = rng.uniform(0, 2 * np.pi, count // 2)
    corner = 0.3 * (2 * rng.integers(2, size=(count // 2, 2)) - 1)
    foot = corner + 0.03 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.concatenate([board, np.c_[foot, rng.uniform(-0.4, 0.3, count // 2)]])


@pytest.mark.parametrize("noise", [0.0, 0.004])
@settings(max_examples=12, deadline=None)
@given(azimuth_deg=st.floats(0.0, 360.0), offset=st.floats(-0.05, 0.05))
def test_half_a_ball_ends_where_it_was_cut(noise: float, azimuth_deg: float, offset: float) -> None:
    angle = np.radians(azimuth_deg)
    normal = np.array([np.cos(angle), np.sin(angle), 0.0])
    kept = BALL[BALL @ normal < offset]
    kept = kept + noise * np.random.default_rng(1).normal(size=kept.shape)
    found = find_end(1e3 * kept + [5.0, 3.0, 1e3], None)
    assert found is not None
    assert angle_between(found.azimuth_deg, azimuth_deg) <= 3.0
    # noise moves the end by its own size or two
    moved = 1e3 * offset + np.array([5.0, 3.0, 1e3]) @ normal
    assert abs(found.offset - moved) <= 12.0 + 2.5e3 * noise


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 180.0])
def test_half_a_table_ends_where_it_was_cut(azimuth_deg: float) -> None:
    angle = np.radians(azimuth_deg)
    points = legs()
    kept = points[points @ np.array([np.cos(angle), np.sin(angle), 0.0]) < 0]
    found = find_end(kept, find_cut(kept), azimuth_deg + 20.0)
    assert found is not None
    assert angle_between(found.azimuth_deg, azimuth_deg) <= 3.0
    assert abs(found.offset) < 0.02


def test_the_side_that_users_name_counts() -> None:
    """Of a bar without ends, one end is as good as the other."""
    points = legs()[6000:] * [0.1, 0.1, 1.0]
    bar = points[:, [2, 0, 1]]
    for toward_deg in (10.0, 170.0):
        found = find_end(bar, None, toward_deg)
        assert found is not None
        expected = 180.0 if toward_deg > 90.0 else 0.0
        assert angle_between(found.azimuth_deg, expected) <= 5.0  # as exact as its thin end


def test_the_plane_of_a_rim_counts_unless_users_name_another_side() -> None:
    kept = BALL[BALL[:, 0] < 0]
    rim = CutPlane(70.0, 0.003, 0.9, 0.9, 0.1)
    for toward_deg in (None, 50.0):
        assert find_end(kept, rim, toward_deg) is rim
    assert find_end(kept, rim, 0.0) == find_end(kept, None, 0.0)


def test_what_is_no_surface_ends_nowhere() -> None:
    assert find_end(BALL[:99], None) is None
    assert find_end(np.zeros((500, 3)), None) is None
