import numpy as np
import torch

from gscomplete.render import render
from gscomplete.shape.bank.fit import FittedShape
from gscomplete.shape.bank.pose import Pose
from gscomplete.shape.bank.store import ShapeName
from gscomplete.shape.bank.wider import (
    shape_in,
    symmetry_in,
    views_in,
    wider_from_object,
)
from gscomplete.shape.symmetry import mirror
from gscomplete.splats.transform import transform_splats
from gscomplete.views import ViewDistribution
from tests.builders.known_shapes import cell_points, chair_cells
from tests.builders.objects import ball


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


def test_pictures_are_the_same_in_the_wider_frame():
    frame = wider_from_object(SEAT, [known(SEAT * 3 + 1)])
    assert frame is not None
    views, splats = ViewDistribution(20.0, 10.0), ball(2000)
    moved, there = transform_splats(splats, frame), views_in(views, frame)
    ours, theirs = (render(s, v.input_camera(64)) for s, v in ((splats, views), (moved, there)))
    # float32 positions: an edge may move by a thousandth of a pixel
    assert torch.allclose(ours.color, theirs.color, atol=2e-3)
    assert torch.allclose(ours.depth * frame.scale, theirs.depth, atol=2e-3)


def test_planes_are_carried_there_and_back():
    frame = wider_from_object(SEAT, [known(SEAT * 3 + 1)])
    assert frame is not None
    plane = mirror(np.deg2rad(40.0), 0.1, 0.5)
    there = symmetry_in(plane, frame)
    points = np.random.default_rng(1).normal(size=(20, 3)).astype(np.float32)

    def moved(places):
        return frame.apply(torch.from_numpy(places).double()).numpy()

    assert np.allclose(there.apply(moved(points)), moved(plane.apply(points)), atol=1e-5)
    back = symmetry_in(there, frame.inverse())
    assert np.allclose(back.apply(points), plane.apply(points), atol=1e-5)
    assert back.score == plane.score
