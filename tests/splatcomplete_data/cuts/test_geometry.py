import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.splats import concatenate
from gscomplete.splats.record import Splats
from splatcomplete_data.cuts.geometry import by_box, by_plane, by_visibility, crop
from tests.builders.objects import BALL, ball, round_splats


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3),
    st.floats(-2, 2),
)
def test_a_plane_keeps_exactly_what_lies_beyond_it(normal, offset):
    length = math.sqrt(sum(v * v for v in normal))
    if length < 1e-6:
        return
    cut = by_plane(BALL, normal, offset)
    signed = BALL.means.double().numpy() @ (np.array(normal) / length) - offset
    clear = np.abs(signed) > 1e-5
    assert np.array_equal(cut.mask.numpy()[clear], (signed >= 0)[clear])
    assert f"kept {int(cut.mask.sum())} of {len(BALL)}" in cut.reason


@pytest.mark.parametrize("normal", [(0, 0, 0), (math.nan, 0, 1), (math.inf, 0, 0)])
def test_a_plane_needs_a_normal(normal):
    with pytest.raises(ValueError, match="normal"):
        by_plane(BALL, normal, 0.0)


def test_boxes_keep_inside_or_outside():
    inside = by_box(BALL, (0.5, 0, 0), (0.5, 1, 1))
    outside = by_box(BALL, (0.5, 0, 0), (0.5, 1, 1), keep="outside")
    assert torch.equal(inside.mask, ~outside.mask)
    assert torch.equal(
        inside.mask, (BALL.means[:, 0] >= 0.25) & (BALL.means[:, 1:].abs() <= 0.5).all(1)
    )
    same = crop(BALL, (0.25, -0.5, -0.5), (0.75, 0.5, 0.5))
    assert torch.equal(same.mask, inside.mask)


def test_a_turned_box_is_a_box_in_turned_coordinates():
    angle = 0.7
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    cut = by_box(BALL, (0.1, 0.2, 0), (0.3, 0.6, 0.5), turn=turn)
    local = (BALL.means.double().numpy() - [0.1, 0.2, 0]) @ turn
    expected = (np.abs(local) <= [0.15, 0.3, 0.25]).all(axis=1)
    assert (cut.mask.numpy() != expected).sum() <= 2


def test_one_view_of_a_ball_sees_the_cap_that_faces_it():
    eye = np.array([1.6, 0.3, 0.4])
    cut = by_visibility(BALL, eye, fov_deg=30)
    normals = BALL.means.double().numpy() / 0.5
    facing = np.einsum("ij,ij->i", normals, eye - BALL.means.double().numpy())
    facing /= np.linalg.norm(eye - BALL.means.double().numpy(), axis=1)
    mask = cut.mask.numpy()
    assert mask[facing > 0.3].mean() > 0.97
    assert mask[facing < -0.3].mean() < 0.01


def test_more_views_see_more_and_all_round_sees_all():
    single = by_visibility(BALL, [[1.6, 0, 0]])
    double = by_visibility(BALL, [[1.6, 0, 0], [-1.6, 0, 0]])
    assert (double.mask | ~single.mask).all()
    six = np.concatenate([1.6 * np.eye(3), -1.6 * np.eye(3)])
    assert by_visibility(BALL, six).mask.float().mean() > 0.99


def test_an_inner_wall_is_hidden_from_outside():
    shell, core = ball(6000, 0.5), ball(1000, 0.3)
    shell = dataclasses.replace(shell, scales=2 * shell.scales)  # randomly placed discs leave holes
    both = concatenate([shell, core])
    six = np.concatenate([2 * np.eye(3), -2 * np.eye(3)])
    mask = by_visibility(both, six).mask
    assert mask[:6000].float().mean() > 0.99
    assert mask[6000:].float().mean() < 0.01


def test_visibility_of_nothing_and_wrong_positions():
    empty = BALL.select(torch.zeros(len(BALL), dtype=torch.bool))
    assert len(by_visibility(empty, [[1, 0, 0]]).mask) == 0
    with pytest.raises(ValueError, match=r"\(V, 3\)"):
        by_visibility(BALL, [[1.0, 0.0]])
    far = Splats(
        *(value * 1e6 if name in ("means", "scales") else value for name, value in BALL.fields())
    )
    near = by_visibility(BALL, [[1.6, 0, 0]]).mask
    assert (by_visibility(far, [[1.6e6, 0, 0]]).mask == near).float().mean() > 0.999


def pair(opacity: float) -> Splats:
    """Two balls on the x axis, the one in front of the given opacity, seen from +x."""
    return concatenate(
        [
            round_splats([[0.5, 0.0, 0.0]], scale=0.2, opacity=opacity),
            round_splats([[-0.5, 0.0, 0.0]], scale=0.2),
        ]
    )


@pytest.mark.parametrize(("opacity", "hides"), [(0.9, True), (0.2, True), (0.19, False)])
def test_faint_splats_hide_nothing(opacity, hides):
    cut = by_visibility(pair(opacity), [[3.0, 0.0, 0.0]], tolerance=0.05)
    assert cut.mask.tolist() == [True, not hides]


@pytest.mark.parametrize(("tolerance", "seen"), [(0.9, False), (1.1, True)])
def test_what_lies_within_the_tolerance_is_of_one_surface(tolerance, seen):
    assert by_visibility(pair(0.9), [[3.0, 0, 0]], tolerance=tolerance).mask.tolist()[1] == seen
