import numpy as np
import pytest
import torch
import torch.nn.functional as F

from gscomplete.shape.voxels import (
    CELL_SIDE,
    CELLS,
    HALF_SIDE,
    cell_centers,
    fill_colored,
    grown,
    shadows,
    splat_arrays,
)
from tests.builders.objects import ball


def test_cells_hold_the_splats_in_them_and_their_mean_colour():
    """The obvious way, in float64, cell by cell."""
    positions, tangents, opacities, colors = splat_arrays(ball(300))
    volume = fill_colored(positions, tangents, opacities, colors, CELLS)
    weight = np.zeros((CELLS,) * 3)
    color = np.zeros((3, *weight.shape))
    for n in range(len(positions)):
        steps = [np.zeros(3), *(s * tangents[n, a] for a in (0, 1) for s in (-1, 1))]
        for step in steps:
            cell = np.floor((positions[n].astype(np.float64) + step + HALF_SIDE) / CELL_SIDE)
            i, j, k = cell.astype(int)
            weight[i, j, k] += opacities[n]
            color[:, i, j, k] += opacities[n] * colors[n]
    filled = weight > 0
    # A point within a float32 rounding of a border may fall to either side: hardly any does.
    assert (filled != (volume[0] > 0)).sum() <= 2
    both = filled & (volume[0] > 0)
    wrong = np.abs(volume[1:, both] - color[:, both] / weight[both]).max(axis=0) > 1e-4
    assert wrong.mean() < 0.01
    assert volume[0].max() <= 1.0


def test_what_lies_outside_the_cube_or_is_transparent_is_left_out():
    positions, tangents, opacities, colors = splat_arrays(ball(200))
    far = positions + np.float32(10)
    assert fill_colored(far, tangents, opacities, colors, CELLS).sum() == 0
    nan = np.full_like(positions, np.nan)
    assert fill_colored(nan, tangents, opacities, colors, CELLS).sum() == 0
    assert fill_colored(positions, tangents, 0 * opacities, colors, CELLS).sum() == 0


def test_cell_centers_are_where_points_of_the_cell_fall():
    centers = cell_centers(CELLS)
    assert centers[0, 0, 0] == pytest.approx(np.full(3, -HALF_SIDE + CELL_SIDE / 2), abs=1e-6)
    found = np.floor((centers + HALF_SIDE) / CELL_SIDE).astype(int)
    assert np.array_equal(found[3, 5, 7], [3, 5, 7])


@pytest.mark.parametrize("shape", [(2, 5, 6, 7), (3, 1, 1, 1)])
def test_growing_axis_by_axis_is_the_pooling_of_all_neighbours(shape):
    """Largest values are exact, whatever the order."""
    values = torch.randn(shape, generator=torch.Generator().manual_seed(0))
    before = values.clone()
    assert torch.equal(grown(values), F.max_pool3d(values, 3, 1, 1))
    assert torch.equal(values, before)


def test_shadows_are_those_of_single_cells():
    cells = torch.zeros(1, 6, 6, 6, dtype=torch.bool)
    cells[0, 1, 2, 3] = True
    along = [shadow[0].nonzero().tolist() for shadow in shadows(cells)]
    assert along == [[[2, 3]], [[1, 3]], [[1, 2]], [[3, 3]], [[1, 3]]]
