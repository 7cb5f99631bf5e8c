import numpy as np
import torch

from gscomplete.shape.bank.fit import FittedShape
from gscomplete.shape.bank.pose import Pose
from gscomplete.shape.bank.store import ShapeName
from gscomplete.shape.bank.wider import shape_in, wider_from_object
from tests.builders.known_shapes import cell_points, chair_cells


def known(points):
    pose = Pose(0.0, np.ones(3), np.zeros(3))
    return FittedShape(ShapeName("a", "b", "c"), chair_cells(), pose, points, 0.0, 0.0, 0.0, 0.0)


SEAT = np.random.default_rng(0).uniform(-0.5, 0.5, (400, 3))


def test_only_shapes_that_find_no_room_ask_for_a_wider_frame():
    chair = cell_points(chair_cells())
    assert wider_from_object(SEAT, ()) is None
    assert wider_from_object(SEAT, [known(chair)]) is None
    frame = wider_from_object(SEAT, [known(chair * [1, 1, 2] - [0, 0, 0.5])])
    assert frame is not None
    both = np.concatenate([SEAT, chair * [1, 1, 2] - [0, 0, 0.5]])
    placed = frame.apply(torch.from_numpy(both)).numpy()
    assert np.allclose(placed.max(axis=0) + placed.min(axis=0), 0, atol=1e-9)
    assert np.isclose(np.ptp(placed, axis=0).max(), 1)
    moved = shape_in(known(both), frame)
    assert np.allclose(moved.points, placed)
    assert np.allclose(moved.pose.to_shape(placed), both)
