"""Holes of lattices are told from all else."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from gscomplete.shape.outline import lattice
from gscomplete.shape.outline.lattice import off_lattice, seen_through
from tests.builders.lattices import PICKETS, bars, between_pickets

RUNGS = [(-0.2, 0.2, low, low + 0.04) for low in np.linspace(-0.45, 0.4, 6)]
LADDER = bars((-0.2, -0.16, -0.5, 0.5), (0.16, 0.2, -0.5, 0.5), *RUNGS)
BOARD = bars((-0.3, 0.3, -0.4, 0.4))
FRAME = bars((-0.3, 0.3, -0.4, -0.3), (-0.3, 0.3, 0.3, 0.4), (-0.3, -0.2, -0.4, 0.4),
             (0.2, 0.3, -0.4, 0.4))  # fmt: skip


def placement(
    angle_deg: float, scale: float
) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Return a rotation about z, and a map that also scales points and moves them."""
    turn = math.radians(angle_deg)
    rotation = np.array(
        [[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]]
    )
    return rotation, lambda points: scale * points @ rotation.T + np.array([3.0, -2.0, 1.0])


def places_between_rungs() -> np.ndarray:
    between = np.linspace(-0.45, 0.4, 6)[:-1] + 0.105
    return np.stack([np.zeros(5), np.zeros(5), between], axis=1)


@pytest.mark.parametrize("angle_deg", [0.0, 37.0, 90.0])
@pytest.mark.parametrize("scale", [1.0, 30.0])
def test_what_is_between_rungs_is_in_holes(angle_deg, scale):
    rotation, placed = placement(angle_deg, scale)
    toward_c = rotation @ np.array([0.6, 0.8, 0.0])
    before = places_between_rungs() + np.array([0, 0.05, 0])
    beside = np.array([[0.3, 0, 0], [0, 0, 0.6], [5.0, 0, 0]])
    for inside, expected in ((places_between_rungs(), True), (before, True), (beside, False)):
        found = off_lattice(placed(LADDER), toward_c, placed(inside), is_scan=False)
        assert (found == expected).all()
        assert off_lattice(placed(LADDER), toward_c, placed(inside), is_scan=True).all()
    for is_scan in (False, True):
        of_itself = placed(LADDER[::50])
        assert not off_lattice(placed(LADDER), toward_c, of_itself, is_scan=is_scan).any()


def test_a_ladder_that_lies_down_is_one_too():
    lying, from_above = LADDER[:, [0, 2, 1]], np.array([0.0, 0.6, 0.8])
    between = places_between_rungs()[:, [0, 2, 1]]
    assert off_lattice(lying, from_above, between, is_scan=False).all()


@pytest.mark.parametrize("height", [-1.0, 1.0])
def test_c_may_be_right_above_or_below(height):
    from_there = np.array([0.0, 0.0, height])
    between = places_between_rungs()
    assert not off_lattice(LADDER, from_there, between, is_scan=False).any()
    lying, between = LADDER[:, [0, 2, 1]], between[:, [0, 2, 1]]
    assert off_lattice(lying, from_there, between, is_scan=False).all()


@pytest.mark.parametrize("points", [BOARD, FRAME, np.zeros((0, 3)), np.zeros((5, 3))])
def test_boards_and_frames_are_no_lattices(points):
    """One hole may be what a scanner lost."""
    grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 12)] * 3), -1).reshape(-1, 3)
    for is_scan in (False, True):
        toward_c = np.array([0.0, 1.0, 0.0])
        assert not off_lattice(points, toward_c, grid, is_scan=is_scan).any()


@pytest.mark.parametrize("angle_deg", [0.0, 100.0])
@pytest.mark.parametrize("scale", [0.01, 30.0])
def test_narrow_gaps_are_seen_through(angle_deg, scale):
    rotation, placed = placement(angle_deg, scale)
    toward_c = rotation @ np.array([0.0, 0.98, 0.199])
    beside = np.array([[0.6, 0, 0], [0, 0, 0.5], [5.0, 0, 0]])
    expected = ((between_pickets(), True), (PICKETS[::20], False), (beside, False))
    for places, is_through in expected:
        found = seen_through(placed(PICKETS), toward_c, placed(places))
        assert (found == is_through).all()


def test_what_only_few_views_see_through_is_kept():
    """Behind pickets, each view sees another part of a wall."""
    toward_c = np.array([0.0, 1.0, 0.0])
    wall = between_pickets() - np.array([0.0, 0.3, 0.0])
    assert not seen_through(PICKETS, toward_c, wall).any()


@pytest.mark.parametrize("points", [BOARD, FRAME, BOARD[::40], np.zeros((0, 3)), np.zeros((5, 3))])
def test_nothing_is_seen_through_without_many_holes(points):
    """Gaps between sparse samples are none."""
    grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 12)] * 3), -1).reshape(-1, 3)
    assert not seen_through(points, np.array([0.0, 1.0, 0.0]), grid).any()
    assert not seen_through(PICKETS, np.array([0.0, 1.0, 0.0]), grid[:0]).any()


def test_views_are_not_drawn_if_the_first_ones_show_no_holes(monkeypatch):
    drawn = []
    real = lattice._outline
    monkeypatch.setattr(lattice, "_outline", lambda *a: drawn.append(1) or real(*a))
    toward_c = np.array([0.0, 1.0, 0.0])
    assert not seen_through(BOARD, toward_c, between_pickets()).any()
    assert len(drawn) == lattice._FIRST_VIEWS
    assert seen_through(PICKETS, toward_c, between_pickets()).all()
    assert len(drawn) > 3 * lattice._FIRST_VIEWS
