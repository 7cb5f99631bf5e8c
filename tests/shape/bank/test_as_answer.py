import numpy as np
import pytest
import torch

from gscomplete.shape.bank.as_answer import occupancy_of
from gscomplete.shape.bank.fit import FittedShape
from gscomplete.shape.bank.pose import Pose
from gscomplete.shape.bank.store import BANK_CELLS, ShapeName
from gscomplete.shape.voxels import CELL_SIDE, CELLS, cell_centers
from tests.builders.known_shapes import box_cells

HALF = 0.25
FAR_AWAY = np.full((1, 3), 9.0)


def cube(shift=(0.0, 0.0, 0.0)) -> FittedShape:
    """Return a cube of half side HALF about -shift."""
    cells = box_cells((24, 24, 24), at=(12, 12, 12))
    pose = Pose(0.0, np.ones(3), np.array(shift))
    points = pose.to_object((np.argwhere(cells) + 0.5) / BANK_CELLS - 0.5)
    return FittedShape(ShapeName("a", "b", "c"), cells, pose, points, 0.0, 0.0, 0.0, 0.0)


def filled(shape, part):
    return (occupancy_of(shape, part)[0] > 0).numpy()


def test_a_cube_fills_itself_and_a_cell_round_it():
    found = filled(cube(), FAR_AWAY)
    assert found.shape == (CELLS,) * 3
    beyond = np.linalg.norm(np.maximum(np.abs(cell_centers(CELLS)) - HALF, 0), axis=-1)
    assert found[beyond == 0].all()  # its own corners are half a diagonal from cells' centres
    assert not found[beyond > CELL_SIDE + 1 / BANK_CELLS].any()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_it_is_bent_to_the_part_near_it_and_nowhere_else(axis):
    """P is the face of the cube at low x (y, z), a tenth further in."""
    shift = np.zeros(3)
    face = np.random.default_rng(0).uniform(-HALF, HALF, (3000, 3))
    face[:, axis] = -HALF + 0.1
    found = filled(cube(shift), face)
    along = np.moveaxis(found, axis, 0)[:, CELLS // 2, CELLS // 2]
    inside = cell_centers(CELLS)[:, 0, 0, 0][along]
    assert inside.min() == pytest.approx(-HALF + 0.1 - CELL_SIDE, abs=1.5 * CELL_SIDE)
    assert inside.max() == pytest.approx(HALF + CELL_SIDE, abs=CELL_SIDE)


def test_logits_are_finite_wherever_the_shape_is():
    for shift in ((5.0, 0.0, 0.0), (0.0, -0.9, 0.4)):
        assert torch.isfinite(occupancy_of(cube(shift), np.zeros((1, 3)))).all()
