import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recipes.train_embedded_prior.procedural import primitives as p

SIZES = st.floats(0.01, 3.0)


def volume(quads: p.Quads) -> float:
    """Signed volume enclosed by quads (split into triangles), in float64."""
    corners = quads.corners.astype(np.float64)
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    return float(np.linalg.det(triangles).sum() / 6)


SOLIDS = {
    "box": (lambda: p.box((1, 2, 3)), 6.0),
    "taper": (lambda: p.box((2, 2, 3), taper=(0.0, 0.0)), 4.0),
    "shear": (lambda: p.box((1, 1, 1), shear=(0.7, 0.2)), 1.0),
    "cylinder": (lambda: p.cylinder(1, 2, segments=200), 2 * math.pi),
    "cone": (lambda: p.cylinder(1, 3, 0.0, segments=200), math.pi),
    "ellipsoid": (lambda: p.ellipsoid((1, 2, 0.5), rows=80, segments=80), 4 / 3 * math.pi),
    "torus": (lambda: p.torus(1, 0.25, segments=100, sides=60), 2 * math.pi**2 * 0.25**2),
    "prism": (lambda: p.prism([(0, 0), (2, 0), (2, 1), (0, 1)], 3), 6.0),
    "pyramid": (lambda: p.prism([(0, 0), (2, 0), (2, 1), (0, 1)], 3, top_scale=0.0), 2.0),
    "rod": (lambda: p.rod((0, 0, 0), (1, 2, 2), 0.1, sides=64), 3 * math.pi * 0.01),
    "ring": (
        lambda: p.tube(p.arc(0, 360, 1, 129), 0.1, sides=48, closed=True),
        2 * math.pi**2 * 0.01,
    ),
    "tray": (lambda: p.tray((1, 2, 1), 0.1), 2 - 0.8 * 1.8 * 0.9),
    "shell": (
        lambda: p.revolve(p.shell_profile([(1, 0), (1, 1)], 0.1), 200),
        math.pi * (1 - 0.81 * 0.9),
    ),
    "arch": (
        lambda: p.tube(p.arc(10, 170, 1, 41, plane="yz"), 0.1, sides=32),
        160 / 180 * math.pi**2 * 0.01,
    ),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_closed_shapes_enclose_their_volume_with_normals_outward(name):
    make, expected = SOLIDS[name]
    assert volume(make()) == pytest.approx(expected, rel=0.03)


def test_a_loft_through_squares_is_a_box():
    square = np.array([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)], np.float32)
    sections = np.stack([np.add(square, (x, 0, 0)) for x in (0, 1, 3)]).astype(np.float32)
    assert volume(p.loft(sections)) == pytest.approx(12.0)


@settings(max_examples=40, deadline=None)
@given(SIZES, SIZES, SIZES, st.floats(0.1, 2.0), st.floats(0.1, 2.0))
def test_ellipsoids_fill_their_box(x, y, z, vertical, horizontal):
    part = p.ellipsoid((x, y, z), roundness=(vertical, horizontal), rows=12, segments=24)
    assert np.isfinite(part.corners).all()
    assert np.allclose(np.abs(part.corners).max(axis=(0, 1)), (x, y, z), rtol=1e-4)


@settings(max_examples=30, deadline=None)
@given(st.sampled_from("xyz"), st.floats(-720, 720))
def test_turns_are_rotations(axis, angle):
    turn = p.turn_about(axis, angle).astype(np.float64)
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(turn) == pytest.approx(1.0, abs=1e-6)


def test_turns_follow_the_right_hand():
    assert np.allclose(p.turn_about("z", 90) @ [1, 0, 0], [0, 1, 0], atol=1e-6)
    assert np.allclose(p.turn_about("x", 90) @ [0, 1, 0], [0, 0, 1], atol=1e-6)
    assert np.allclose(p.turn_about("y", 90) @ [0, 0, 1], [1, 0, 0], atol=1e-6)


def test_patterns_close_around_sections():
    for radius in (0.03, 0.2, 0.51, 1.7):
        around = p.cylinder(radius, 1.0).uv[..., 0].max()
        assert around / p.SEAM_UNIT == pytest.approx(round(around / p.SEAM_UNIT), abs=1e-4)


def test_smooth_profiles_pass_through_their_ends():
    knots = np.array([(0.1, 0), (0.5, 0.4), (0.2, 1.0)])
    line = p.smooth_profile(knots, 11)
    assert np.allclose(line[[0, 5, 10]], knots, atol=1e-6)


def test_joined_parts_keep_the_thinnest_feature():
    thick, thin = p.ellipsoid((1, 1, 1)), p.rod((0, 0, 0), (0, 0, 1), 0.02)
    joined = p.join([thick, thin])
    assert len(joined.corners) == len(thick.corners) + len(thin.corners)
    assert joined.feature == thin.feature
    assert p.Quads(thick.corners, thick.uv).feature is None
