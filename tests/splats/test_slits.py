"""Slits between a scan's samples are closed on its surface; gaps that the camera sees stay."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from gscomplete.render import render
from gscomplete.splats import concatenate
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.splats.slits import slit_splats
from gscomplete.views import ViewDistribution
from tests.builders.objects import GREEN, PITCH, even_ball, leaning_board, round_splats

EYE = ViewDistribution(0.0, 0.0).eye()


def views(azimuth_deg: float = 0.0) -> ViewDistribution:
    return ViewDistribution(azimuth_deg, 0.0)


@pytest.mark.parametrize(("lean_deg", "depth_step"), [(65.0, 1e-4), (60.0, 0.024), (45.0, 0.02)])
def test_a_leaning_board_is_closed_from_the_side(lean_deg: float, depth_step: float) -> None:
    """Whether the slits come from the lean alone or from the steps of the depths."""
    board = leaning_board(lean_deg, depth_step, 0.24)
    slits = slit_splats(board, EYE)
    both = concatenate([board, slits])
    # from where the board is seen straight on, inside its outline
    cameras = views(-lean_deg).input_camera(512)
    open_before, open_after = (
        float((render(s, cameras).alpha[0, 236:276, 236:276] < 0.5).float().mean())
        for s in (board, both)
    )
    assert open_before > 0.15
    assert open_after < 0.03


@pytest.mark.parametrize(("lean_deg", "depth_step"), [(65.0, 1e-4), (60.0, 0.024)])
def test_new_samples_lie_on_the_board_in_its_colours(lean_deg: float, depth_step: float) -> None:
    slits = slit_splats(leaning_board(lean_deg, depth_step), EYE)
    lean = math.radians(lean_deg)
    away = slits.means @ torch.tensor([math.cos(lean), -math.sin(lean), 0.0])
    # as far as rounding takes samples from the board, and float32's own
    assert away.abs().max() <= depth_step / 2 * math.cos(lean) + 1e-3
    is_above = slits.means[:, 2] > 2 * PITCH
    assert (slits.base_colors[is_above] - torch.tensor(GREEN)).abs().max() < 1e-3
    assert torch.equal(slits.scales.amin(dim=1), slits.scales.amax(dim=1))


def test_a_board_that_faces_the_camera_has_no_slits() -> None:
    assert len(slit_splats(leaning_board(0.0, 1e-4), EYE)) == 0


def test_bars_that_the_camera_sees_through_stay_apart() -> None:
    """Gaps of four pixels are near enough to be bridged, were they not seen."""
    board = leaning_board(20.0, 1e-4)
    column = torch.round(board.means[:, 1] / PITCH).long() % 8
    bars = board.select(column < 4)
    slits = slit_splats(bars, EYE)
    gaps = torch.round(slits.means[:, 1] / PITCH).long() % 8
    assert not ((gaps > 4) & (gaps < 7)).any()


def test_what_lies_far_behind_is_not_connected() -> None:
    front, behind = leaning_board(0.0, 1e-4, 0.08), leaning_board(0.0, 1e-4)
    hidden = behind.means[:, 1:].abs().amax(dim=1) < 0.08
    behind = behind.select(~hidden)
    moved = behind.means - torch.tensor([6.0 * PITCH, 0.0, 0.0])
    both = concatenate([front, dataclasses.replace(behind, means=moved)])
    assert len(slit_splats(both, EYE)) == 0


def test_meshes_as_discs_and_trained_captures_are_left_alone() -> None:
    ball = even_ball(3000)
    flat = dataclasses.replace(ball, scales=ball.scales * torch.tensor([1.0, 1.0, 0.1]))
    assert len(slit_splats(flat, EYE)) == 0
    generator = torch.Generator().manual_seed(0)
    uneven = leaning_board(65.0, 1e-4)
    chosen = torch.rand(len(uneven), generator=generator) < 0.3
    strewn = uneven.means + 0.01 * torch.randn(len(uneven), 3, generator=generator)
    uneven = dataclasses.replace(uneven, means=strewn).select(chosen)
    assert len(slit_splats(uneven, EYE)) == 0


@pytest.mark.parametrize("count", [0, 1, 40, 99])
def test_a_few_splats_have_no_slits(count: int) -> None:
    few = leaning_board(65.0, 1e-4).select(torch.arange(count))
    slits = slit_splats(few, EYE)
    assert len(slits) == 0
    assert slits.sh_degree == 0


@pytest.mark.parametrize("eye", [EYE, np.zeros(3)])
def test_a_row_of_samples_has_no_slits(eye: np.ndarray) -> None:
    """Seen from the side, or from where one of them is."""
    row = torch.zeros(200, 3)
    row[:, 1] = torch.arange(200) * PITCH
    assert len(slit_splats(round_splats(row, scale=PITCH / 2), eye)) == 0


def test_samples_at_one_place_have_no_slits() -> None:
    board = leaning_board(65.0, 1e-4)
    assert len(slit_splats(dataclasses.replace(board, means=board.means * 0), EYE)) == 0


@settings(max_examples=8, deadline=None)
@given(azimuth_deg=st.floats(-180.0, 180.0))
def test_it_does_not_matter_where_the_camera_stands(azimuth_deg: float) -> None:
    """Turned with the board, it finds the same slits, but for which place of a grid cell it is."""
    board = leaning_board(65.0, 1e-4)
    angle = math.radians(azimuth_deg)
    turn = rotation_matrices(torch.tensor([[math.cos(angle / 2), 0, 0, math.sin(angle / 2)]]))[0]
    turned = dataclasses.replace(board, means=board.means @ turn.T)
    here, there = slit_splats(board, EYE), slit_splats(turned, views(azimuth_deg).eye())
    apart, _ = cKDTree((here.means @ turn.T).numpy()).query(there.means.numpy())
    assert apart.max() < 2 * PITCH
    assert abs(len(there) - len(here)) < 0.1 * len(here)
