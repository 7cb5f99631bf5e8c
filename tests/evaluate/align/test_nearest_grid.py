"""The look-up of nearest points, cell by cell."""

import numpy as np
import pytest

from gscomplete.evaluate.align.nearest_grid import CELLS, REACH, nearest_grid

SIDE = 2 * REACH / CELLS


def cells_of(points):
    """Return the cell of every point; places outside the cube belong to its outermost cells."""
    return np.clip(np.floor((points + REACH) / SIDE), 0, CELLS - 1).astype(int)


def test_points_are_the_means_of_cells_taken_one_by_one():
    rng = np.random.default_rng(0)
    cloud = rng.uniform(-0.5, 0.5, (300, 3)).round(1) + rng.uniform(0, 1e-3, (300, 3))
    cells = cells_of(cloud)
    members: dict[tuple[int, ...], list[np.ndarray]] = {}
    for cell, point in zip(cells.tolist(), cloud, strict=True):
        members.setdefault(tuple(cell), []).append(point)
    grid = nearest_grid(cloud)
    assert len(grid.points) == len(members) < len(cloud)
    for cell, points in members.items():
        found = grid.points[grid.index[cell]]
        assert found == pytest.approx(sum(points) / len(points), abs=1e-14)


def test_every_cell_refers_to_a_nearest_cell_that_holds_points():
    cloud = np.random.default_rng(1).uniform(-0.5, 0.5, (25, 3))
    grid = nearest_grid(cloud)
    held = cells_of(cloud)
    assert grid.index.shape == (CELLS,) * 3
    assert grid.index.dtype == np.int32
    rows = {int(grid.index[tuple(cell)]): cell for cell in held}
    for cell in np.random.default_rng(2).integers(0, CELLS, (2000, 3)):
        squared = ((held - cell) ** 2).sum(axis=1)
        found = rows[int(grid.index[tuple(cell)])]
        assert ((found - cell) ** 2).sum() == squared.min()  # whole numbers: exact


@pytest.mark.parametrize(
    ("points", "mean"),
    [
        ([[0.1, -0.2, 0.3]], [0.1, -0.2, 0.3]),
        ([[0.1, -0.2, 0.3], [0.1, -0.2, 0.301]], [0.1, -0.2, 0.3005]),
        ([[9.0, 9.0, 9.0]], [9.0, 9.0, 9.0]),
    ],
)
def test_one_place_is_nearest_to_every_cell(points, mean):
    grid = nearest_grid(np.array(points))
    assert not grid.index.any()
    assert grid.points == pytest.approx(np.array([mean]))


def test_places_outside_the_cube_belong_to_its_border():
    cloud = np.array([[5.0, 0.0, 0.0], [-5.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    grid = nearest_grid(cloud)
    middle = CELLS // 2
    found = [grid.points[grid.index[x, middle, middle]].tolist() for x in (CELLS - 1, 0, middle)]
    assert found == cloud.tolist()
    last = [REACH - 0.5 * SIDE, 0.0, 0.0]
    before = [REACH - 1.5 * SIDE, 0.0, 0.0]
    assert len(nearest_grid(np.array([[5.0, 0.0, 0.0], last, before])).points) == 2
    assert len(nearest_grid(-np.array([[5.0, 0.0, 0.0], last, before])).points) == 2


def test_the_order_of_points_changes_a_mean_by_rounding_alone():
    cloud = np.random.default_rng(3).uniform(-0.5, 0.5, (400, 3))
    one, two = nearest_grid(cloud), nearest_grid(cloud[::-1])
    assert np.array_equal(one.index, two.index)
    assert np.abs(one.points - two.points).max() < 1e-15
