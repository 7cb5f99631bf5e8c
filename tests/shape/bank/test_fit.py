import math

import numpy as np
import pytest

from gscomplete.shape.bank.fit import Pose, fit_known_shapes
from gscomplete.shape.bank.store import BANK_FILE, ShapeName, read_bank, write_bank
from tests.builders.known_shapes import box_cells, cell_points, chair_cells

FRONT = np.array([math.cos(0.3), 0.0, math.sin(0.3)])


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    path = tmp_path_factory.mktemp("bank") / BANK_FILE
    names = [
        ShapeName("a/chair", "chair", "a chair"),
        ShapeName("b/cube", "chair", "no chair at all"),
        ShapeName("c/plank", "plank", "a plank"),
    ]
    cells = [chair_cells(), box_cells((48, 48, 48)), box_cells((48, 8, 3), at=(0, 20, 22))]
    write_bank(path, names, cells)
    return read_bank(path)


def turned(points, yaw_rad):
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])


def test_a_pose_is_undone():
    pose = Pose(0.7, np.array([1.1, 0.9, 1.3]), np.array([0.1, -0.2, 0.3]))
    points = np.random.default_rng(0).normal(size=(50, 3))
    assert np.allclose(pose.to_object(pose.to_shape(points)), points, atol=1e-12)


@pytest.mark.parametrize("yaw_deg", [0.0, 35.0, 200.0])
def test_seat_and_back_find_the_chair_and_its_legs(bank, yaw_deg):
    whole = cell_points(chair_cells())
    part = whole[whole[:, 2] > 0.0]
    place = np.array([0.3, -0.1, 0.2])
    yaw = math.radians(yaw_deg)
    toward_c = turned(FRONT[None], yaw)[0]
    found = fit_known_shapes(bank, "a wooden chair", turned(part, yaw) * 0.8 + place, toward_c, 3)
    assert found[0].name.id == "a/chair"
    assert found[0].residual < 0.02  # a cell is 0.021 of the shape's side
    wanted = turned(whole, yaw) * 0.8 + place
    apart = np.linalg.norm(wanted[:, None] - found[0].points[None, ::3], axis=2).min(axis=1)
    assert np.quantile(apart, 0.9) < 0.08


def test_only_shapes_of_the_noun_that_suit_are_returned(bank):
    chair = cell_points(chair_cells())
    assert fit_known_shapes(bank, "a sofa", chair, FRONT, 3) == []
    assert [s.name.id for s in fit_known_shapes(bank, "a chair", chair, FRONT, 3)] == ["a/chair"]
    tall = cell_points(box_cells((4, 4, 48)))
    assert fit_known_shapes(bank, "a plank", tall, FRONT, 3) == []


def test_a_fit_moves_and_grows_with_p(bank):
    whole = cell_points(chair_cells())
    part = whole[whole[:, 2] > 0.0]
    (one, *_), (other, *_) = (
        fit_known_shapes(bank, "chair", scale * part + shift, FRONT, 1)
        for scale, shift in ((1.0, 0.0), (4.0, 7.0))
    )
    assert np.allclose(4.0 * one.points + 7.0, other.points, atol=1e-6)
    assert other.cost == pytest.approx(one.cost, abs=1e-6)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_next_to_nothing_is_no_reason_to_fail(bank, count):
    points = np.zeros((count, 3)) + np.arange(count)[:, None] * 1e-3
    for toward_c in (FRONT, np.array([0.0, 0.0, 1.0])):
        for shape in fit_known_shapes(bank, "chair", points, toward_c, 2):
            assert np.isfinite(shape.points).all()


def test_a_face_tells_nothing_of_the_depth_behind_it(tmp_path):
    names = [ShapeName(f"{pack}/cube", "cube", "a cube") for pack in ("a", "b")]
    write_bank(tmp_path / BANK_FILE, names, [box_cells((48, 48, 48))] * 2)
    cubes = read_bank(tmp_path / BANK_FILE)
    whole = cell_points(box_cells((48, 48, 48)))
    toward_c = np.array([1.0, 0.0, 0.0])
    deep, face = whole[whole[:, 0] > 0.0], whole[whole[:, 0] > 0.4]
    assert len(fit_known_shapes(cubes, "a cube", deep, toward_c, 3)) == 2
    assert fit_known_shapes(cubes, "a cube", face, toward_c, 3) == []
