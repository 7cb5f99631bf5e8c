import numpy as np
import pytest

from gscomplete.priors.embedded.shape.grid import CELLS, splat_arrays
from recipes.train_embedded_prior.solids import fill_inside, fill_shell, solid_cells
from tests.priors.embedded.shape.shapes import sphere


def test_a_sphere_is_filled_and_a_cup_is_not():
    angle = np.random.default_rng(0).normal(size=(20000, 3))
    sphere = (0.4 * angle / np.linalg.norm(angle, axis=1, keepdims=True)).astype(np.float32)
    tangents = np.full((len(sphere), 2, 3), 1e-4, np.float32)
    ball = solid_cells(sphere, tangents)
    expected = 4 / 3 * np.pi * 0.4**3 / (1.44 / CELLS) ** 3
    assert ball.sum() == pytest.approx(expected, rel=0.2)
    cup = solid_cells(sphere[sphere[:, 2] < 0.1], tangents)
    assert cup[CELLS // 2, CELLS // 2, CELLS // 2] == 0
    assert ball[CELLS // 2, CELLS // 2, CELLS // 2] == 1


def test_a_closed_shell_is_filled_and_an_open_one_is_not():
    positions, tangents, *_ = splat_arrays(sphere())
    shell = fill_shell(positions, tangents, CELLS, 1.5)
    middle = (CELLS // 2,) * 3
    assert fill_inside(shell)[middle] == 1
    shell[:, :, CELLS // 2 :] = 0
    assert fill_inside(shell)[middle] == 0
    assert np.array_equal(fill_inside(np.zeros_like(shell)), np.zeros_like(shell))
    assert fill_inside(np.ones_like(shell)).all()


def test_what_is_not_finite_fills_nothing():
    positions, tangents, *_ = splat_arrays(sphere(200))
    assert fill_shell(np.full_like(positions, np.nan), tangents, CELLS, 1.2).sum() == 0
