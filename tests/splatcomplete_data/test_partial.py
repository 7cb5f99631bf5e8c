import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.splats.record import Splats, colors_to_sh
from splatcomplete_data.mesh.discs import discs_at
from splatcomplete_data.partial import (
    CutSettings,
    FlawSettings,
    by_box,
    by_plane,
    by_visibility,
    corrupt,
    crop,
    random_partial,
)


def ball(count: int = 4000, radius: float = 0.5) -> Splats:
    """Return discs on a sphere (Fibonacci points)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle = np.pi * (1 + math.sqrt(5)) * k
    ring = np.sqrt(1 - z * z)
    normals = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1).astype(np.float32)
    spacing = math.sqrt(4 * math.pi * radius**2 / count)
    return discs_at(normals * np.float32(radius), normals, np.abs(normals), spacing)


BALL = ball()


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
    both = Splats(
        *(torch.cat([a, b]) for (_, a), (_, b) in zip(shell.fields(), core.fields(), strict=True))
    )
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


def test_random_partials_are_repeatable_and_within_their_bounds():
    kinds = set()
    chosen = CutSettings()
    for index in range(60):
        cut = random_partial(BALL, 3, index)
        again = random_partial(BALL, 3, index)
        assert torch.equal(cut.mask, again.mask)
        kept = cut.mask.float().mean().item()
        assert chosen.fewest_share - 1e-3 <= kept <= chosen.most_share + 1e-3
        kinds.add(cut.kind)
    assert {"plane", "box", "visibility"} <= kinds
    assert not torch.equal(random_partial(BALL, 3, 0).mask, random_partial(BALL, 4, 0).mask)


def test_random_partials_of_degenerate_objects():
    one = BALL.select(torch.tensor([0]))
    for index in range(20):
        assert random_partial(one, 0, index).mask.shape == (1,)
    with pytest.raises(ValueError, match="no splats"):
        random_partial(one.select(torch.zeros(1, dtype=torch.bool)), 0, 0)


def test_flaws_stay_small_and_repeatable():
    mask = random_partial(BALL, 1, 1).mask
    clean, touched = 0, 0
    for index in range(40):
        flawed = corrupt(BALL, mask, 2, index)
        again = corrupt(BALL, mask, 2, index)
        for (name, a), (_, b) in zip(flawed.fields(), again.fields(), strict=True):
            assert torch.equal(a, b), name
            assert torch.isfinite(a).all(), name
        assert 0.45 * int(mask.sum()) <= len(flawed) <= 1.01 * int(mask.sum()) + 1
        same = len(flawed) == int(mask.sum()) and torch.equal(flawed.means, BALL.means[mask])
        clean, touched = clean + same, touched + (not same)
    assert clean >= 5
    assert touched >= 15


def test_no_flaws_when_asked_for_none():
    mask = torch.ones(len(BALL), dtype=torch.bool)
    flawed = corrupt(BALL, mask, 0, 0, FlawSettings(clean_share=1.0))
    assert torch.equal(flawed.means, BALL.means)
    nothing = corrupt(BALL, ~mask, 0, 0)
    assert len(nothing) == 0


def test_higher_bands_of_color_are_left_alone():
    sh = torch.cat([colors_to_sh(torch.rand(len(BALL), 3)), torch.rand(len(BALL), 3, 3)], dim=1)
    splats = Splats(BALL.means, BALL.quaternions, BALL.scales, BALL.opacities, sh)
    mask = torch.ones(len(BALL), dtype=torch.bool)
    settings = FlawSettings(clean_share=0.0, most_holes=0, flying_share=0.0)
    assert torch.equal(corrupt(splats, mask, 0, 3, settings).sh[:, 1:], sh[:, 1:])
