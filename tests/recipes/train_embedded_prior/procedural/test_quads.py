import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recipes.train_embedded_prior.procedural.primitives import cylinder, ellipsoid
from recipes.train_embedded_prior.procedural.quads import SEAM_UNIT, Quads, join, turn_about
from recipes.train_embedded_prior.procedural.sweeps import rod


@settings(max_examples=30, deadline=None)
@given(st.sampled_from("xyz"), st.floats(-720, 720))
def test_turns_are_rotations(axis, angle):
    turn = turn_about(axis, angle).astype(np.float64)
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(turn) == pytest.approx(1.0, abs=1e-6)


def test_turns_follow_the_right_hand():
    assert np.allclose(turn_about("z", 90) @ [1, 0, 0], [0, 1, 0], atol=1e-6)
    assert np.allclose(turn_about("x", 90) @ [0, 1, 0], [0, 0, 1], atol=1e-6)
    assert np.allclose(turn_about("y", 90) @ [0, 0, 1], [1, 0, 0], atol=1e-6)


def test_patterns_close_around_sections():
    for radius in (0.03, 0.2, 0.51, 1.7):
        around = cylinder(radius, 1.0).uv[..., 0].max()
        assert around / SEAM_UNIT == pytest.approx(round(around / SEAM_UNIT), abs=1e-4)


def test_joined_parts_keep_the_thinnest_feature():
    thick, thin = ellipsoid((1, 1, 1)), rod((0, 0, 0), (0, 0, 1), 0.02)
    joined = join([thick, thin])
    assert len(joined.corners) == len(thick.corners) + len(thin.corners)
    assert joined.feature == thin.feature
    assert Quads(thick.corners, thick.uv).feature is None
