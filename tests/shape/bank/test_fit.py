import math
import tracemalloc

import numpy as np
import pytest

from gscomplete.shape.bank.fit import FitLimits, FittedShape, fit_known_shapes
from gscomplete.shape.bank.pose import Pose
from gscomplete.shape.bank.store import BANK_FILE, ShapeName, read_bank, write_bank
from tests.builders.known_shapes import box_cells, cell_points, chair_cells

LIMITS = FitLimits()
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


@pytest.mark.parametrize("yaw_deg", [0.0, 35.0, 200.0])
def test_seat_and_back_find_the_chair_and_its_legs(bank, yaw_deg):
    whole = cell_points(chair_cells())
    part = whole[whole[:, 2] > 0.0]
    place = np.array([0.3, -0.1, 0.2])
    yaw = math.radians(yaw_deg)
    toward_c = turned(FRONT[None], yaw)[0]
    found = fit_known_shapes(
        bank, "a wooden chair", turned(part, yaw) * 0.8 + place, toward_c, 3, LIMITS
    )
    assert found[0].name.id == "a/chair"
    assert found[0].residual < 0.02  # a cell is 0.021 of the shape's side
    wanted = turned(whole, yaw) * 0.8 + place
    apart = np.linalg.norm(wanted[:, None] - found[0].points[None, ::3], axis=2).min(axis=1)
    assert np.quantile(apart, 0.9) < 0.08


def test_only_shapes_of_the_noun_that_suit_are_returned(bank):
    chair = cell_points(chair_cells())
    assert fit_known_shapes(bank, "a sofa", chair, FRONT, 3, LIMITS) == []
    assert [s.name.id for s in fit_known_shapes(bank, "a chair", chair, FRONT, 3, LIMITS)] == [
        "a/chair"
    ]
    tall = cell_points(box_cells((4, 4, 48)))
    assert fit_known_shapes(bank, "a plank", tall, FRONT, 3, LIMITS) == []


def test_a_fit_moves_and_grows_with_p(bank):
    whole = cell_points(chair_cells())
    part = whole[whole[:, 2] > 0.0]
    (one, *_), (other, *_) = (
        fit_known_shapes(bank, "chair", scale * part + shift, FRONT, 1, LIMITS)
        for scale, shift in ((1.0, 0.0), (4.0, 7.0))
    )
    assert np.allclose(4.0 * one.points + 7.0, other.points, atol=1e-6)
    assert other.cost == pytest.approx(one.cost, abs=1e-6)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_next_to_nothing_is_no_reason_to_fail(bank, count):
    points = np.zeros((count, 3)) + np.arange(count)[:, None] * 1e-3
    for toward_c in (FRONT, np.array([0.0, 0.0, 1.0])):
        for shape in fit_known_shapes(bank, "chair", points, toward_c, 2, LIMITS):
            assert np.isfinite(shape.points).all()


def test_a_rod_seen_along_its_axis_asks_for_no_large_picture(bank):
    rod = np.linspace(-0.5, 0.5, 200)[:, None] * [0.0, 0.0, 1.0]
    rod[1::2, 0] = 0.0005
    tracemalloc.start()
    limits = FitLimits(most_cost=math.inf, most_growth=math.inf)
    fit_known_shapes(bank, "a plank", rod, np.array([0.0, 0.0, 1.0]), 1, limits)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6


def test_a_face_tells_nothing_of_the_depth_behind_it(tmp_path):
    names = [ShapeName(f"{pack}/cube", "cube", "a cube") for pack in ("a", "b")]
    write_bank(tmp_path / BANK_FILE, names, [box_cells((48, 48, 48))] * 2)
    cubes = read_bank(tmp_path / BANK_FILE)
    whole = cell_points(box_cells((48, 48, 48)))
    toward_c = np.array([1.0, 0.0, 0.0])
    deep, face = whole[whole[:, 0] > 0.0], whole[whole[:, 0] > 0.4]
    assert len(fit_known_shapes(cubes, "a cube", deep, toward_c, 3, LIMITS)) == 2
    assert fit_known_shapes(cubes, "a cube", face, toward_c, 3, LIMITS) == []


def test_wider_limits_let_a_face_be_part_of_a_cube(tmp_path):
    write_bank(tmp_path / BANK_FILE, [ShapeName("a/cube", "cube", "")], [box_cells((48, 48, 48))])
    cubes = read_bank(tmp_path / BANK_FILE)
    whole = cell_points(box_cells((48, 48, 48)))
    face, toward_c = whole[whole[:, 0] > 0.4], np.array([1.0, 0.0, 0.0])
    limits = FitLimits(most_cost=0.2, most_growth=30.0)
    assert len(fit_known_shapes(cubes, "a cube", face, toward_c, 3, limits)) == 1


def test_a_pose_follows_what_is_moved():
    rng = np.random.default_rng(0)
    points, move = rng.normal(size=(50, 3)), rng.normal(size=3)
    pose = Pose(0.7, np.array([1.1, 0.9, 1.3]), np.array([0.1, -0.2, 0.3]))
    there = pose.of_moved(2.5, move).to_shape(2.5 * points + move)
    assert np.allclose(there, pose.to_shape(points), atol=1e-12)


def test_distances_are_those_from_a_closed_shape():
    """Of a box, whose inside is filled; cells are 1/48 of the side, distances to their centres."""
    pose = Pose(0.4, np.full(3, 0.5), np.array([0.1, 0.0, -0.1]))
    cells = box_cells((24, 24, 24), at=(12, 12, 12))  # a quarter to three quarters of the cube
    points = np.random.default_rng(0).uniform(-3, 3, (4000, 3))
    shape = FittedShape(ShapeName("a", "b", "c"), cells, pose, points, 0, 0, 0, 0)
    outside = np.maximum(np.abs(pose.to_shape(points)) - 0.25, 0)
    exact = np.linalg.norm(outside, axis=1) / 0.5
    found = shape.distances(points)
    within = np.abs(pose.to_shape(points)).max(axis=1) < 0.5
    assert within.sum() > 100
    assert np.abs(found - exact)[within].max() < 1.5 / 48 / 0.5
    # beyond the cube and its margin the way there is added: more than the straight one, never less
    assert (found - exact).min() > -1.5 / 48 / 0.5


def test_shapes_of_the_noun_itself_go_before_those_of_captions(tmp_path):
    names = [
        ShapeName("a/lamp_table", "table", "lamp table"),
        ShapeName("b/lantern", "lantern", "a lantern"),
    ]
    write_bank(tmp_path / BANK_FILE, names, [chair_cells(), box_cells((24, 24, 48))])
    bank = read_bank(tmp_path / BANK_FILE)
    assert [bank.naming(k, "an old lamp") for k in (0, 1)] == ["caption", "synonym"]
    assert bank.naming(0, "a table") == "noun"
    assert bank.naming(0, "a toy") == "caption"
    part = cell_points(chair_cells())
    firsts = [
        fit_known_shapes(
            bank, "a lamp", part, FRONT, 2, FitLimits(9.0, 99.0, other_noun_cost=cost)
        )[0]
        for cost in (0.0, 1.0)
    ]
    assert [shape.name.id for shape in firsts] == ["a/lamp_table", "b/lantern"]
