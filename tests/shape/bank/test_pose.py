import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from gscomplete.shape.bank.pose import MARGIN, Pose, distance_field
from gscomplete.shape.bank.store import BANK_CELLS
from tests.builders.known_shapes import box_cells


def test_a_pose_is_undone():
    pose = Pose(0.7, np.array([1.1, 0.9, 1.3]), np.array([0.1, -0.2, 0.3]))
    points = np.random.default_rng(0).normal(size=(50, 3))
    assert np.allclose(pose.to_object(pose.to_shape(points)), points, atol=1e-12)


def test_a_field_holds_distances_on_the_cells_and_round_them():
    field = distance_field(box_cells((2, 2, 2), at=(20, 20, 20)))
    rim = round(MARGIN * BANK_CELLS)
    assert field.shape == (BANK_CELLS + 2 * rim,) * 3
    assert field[rim + 20, rim + 21, rim + 20] == 0
    assert field[rim + 25, rim + 21, rim + 20] * BANK_CELLS == 4


@pytest.mark.parametrize("count", [6, 12, 48, 66])
def test_a_field_is_scipys_distance_transform(count: int):
    cells = np.random.default_rng(count).random((count, count, count)) < 0.01
    cells[1, 2, 3] = True
    marked = np.pad(cells, round(MARGIN * count))
    expected = distance_transform_edt(~marked, sampling=1.0 / count)
    # Both are roots of whole numbers, rounded once or twice.
    assert np.allclose(distance_field(cells), expected, rtol=0, atol=1e-15)
