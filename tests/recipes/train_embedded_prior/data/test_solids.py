import numpy as np
import pytest

from gscomplete.shape.voxels import CELL_SIDE, CELLS, splat_arrays
from recipes.train_embedded_prior.data.solids import fill_inside, fill_shell, solid_cells
from tests.builders.objects import ball


def test_a_sphere_is_filled_and_a_cup_is_not():
    angle = np.random.default_rng(0).normal(size=(20000, 3))
    sphere = (0.4 * angle / np.linalg.norm(angle, axis=1, keepdims=True)).astype(np.float32)
    tangents = np.full((len(sphere), 2, 3), 1e-4, np.float32)
    ball = solid_cells(sphere, tangents)
    expected = 4 / 3 * np.pi * 0.4**3 / (1.44 / CELLS) ** 3
    # Cells that the surface touches are filled whole: as if it were 0.65 cells larger, 15 % more.
    assert ball.sum() == pytest.approx(expected, rel=0.2)
    cup = solid_cells(sphere[sphere[:, 2] < 0.1], tangents)
    assert cup[CELLS // 2, CELLS // 2, CELLS // 2] == 0
    assert ball[CELLS // 2, CELLS // 2, CELLS // 2] == 1


def test_a_closed_shell_is_filled_and_an_open_one_is_not():
    positions, tangents, *_ = splat_arrays(ball())
    shell = fill_shell(positions, tangents, CELLS, 1.5)
    middle = (CELLS // 2,) * 3
    assert fill_inside(shell)[middle] == 1
    shell[:, :, CELLS // 2 :] = 0
    assert fill_inside(shell)[middle] == 0
    assert np.array_equal(fill_inside(np.zeros_like(shell)), np.zeros_like(shell))
    assert fill_inside(np.ones_like(shell)).all()


def test_what_is_not_finite_fills_nothing():
    positions, tangents, *_ = splat_arrays(ball(200))
    assert fill_shell(np.full_like(positions, np.nan), tangents, CELLS, 1.2).sum() == 0


def test_a_narrow_gap_between_two_bodies_stays_empty():
    first = ball(20000)
    positions, _tangents, *_ = splat_arrays(first)
    radius = np.linalg.norm(positions, axis=1).max()
    small = (0.2 / radius) * positions
    gap = 2.5 * CELL_SIDE
    shift = np.array([0.2 + 0.5 * gap, 0, 0], np.float32)
    both = np.concatenate([small - shift, small + shift])
    tiny = np.full((len(both), 2, 3), 1e-4, np.float32)
    found = solid_cells(both, tiny)
    alone = [solid_cells(small + side * shift, tiny[: len(small)]) for side in (-1, 1)]
    assert np.array_equal(found, alone[0] | alone[1])
    middle = CELLS // 2
    assert found[middle, middle, middle] == 0
    assert found[middle - 6, middle, middle] == 1


def test_a_hole_in_a_thick_body_does_not_empty_it():
    positions, *_ = splat_arrays(ball(20000))
    radius = np.linalg.norm(positions, axis=1).max()
    body = (0.4 / radius) * positions
    axis = np.linalg.norm(body[:, :2], axis=1)
    holed = body[(axis > 1.5 * CELL_SIDE) | (body[:, 2] < 0)]
    found = solid_cells(holed, np.full((len(holed), 2, 3), 1e-4, np.float32))
    whole = solid_cells(body, np.full((len(body), 2, 3), 1e-4, np.float32))
    assert found[CELLS // 2, CELLS // 2, CELLS // 2] == 1
    assert (found != whole).sum() < 30
