import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares

from gscomplete.shape.bank.improve import FAR, improve_poses
from gscomplete.shape.bank.pose import MARGIN, Pose, distance_field
from gscomplete.shape.bank.store import BANK_CELLS
from tests.builders.known_shapes import cell_points, chair_cells


@pytest.fixture(scope="module")
def chair():
    return distance_field(chair_cells()), cell_points(chair_cells())[::7]


def beside(yaw=0.0, scale=1.0, shift=(0.0, 0.0, 0.0)):
    return Pose(yaw, np.full(3, scale), np.array(shift))


STARTS = [
    beside(0.2, 0.95, (0.03, -0.02, 0.01)),
    beside(-0.25, 1.0, (0.0, 0.04, 0.0)),
    beside(0.1, 1.06, (-0.03, 0.02, 0.02)),
]


def mean_distance(field, pose, points):
    place = (pose.to_shape(points) + 0.5 + MARGIN) * BANK_CELLS - 0.5
    found = map_coordinates(field, place.T, order=1, mode="nearest")
    return float(np.minimum(found, FAR).mean())


def test_a_displaced_shape_comes_back(chair):
    field, points = chair
    for away, pose in improve_poses([field], [(0, start) for start in STARTS], points):
        assert away < 0.004  # a fifth of a cell
        assert abs(pose.yaw_rad) < math.radians(2)
        assert np.abs(pose.scales - 1).max() < 0.05
        assert np.abs(pose.shift).max() < 0.02


def test_the_distance_told_is_that_of_the_pose(chair):
    field, points = chair
    for start in STARTS:
        ((away, pose),) = improve_poses([field], [(0, start)], points)
        scaled = mean_distance(field / start.scales[0], pose, points)
        assert away == pytest.approx(scaled, rel=1e-9)


def test_as_good_as_a_general_solver(chair):
    field, points = chair
    bounds = np.sqrt(len(points)) * 0.03 / np.array([0.5, 0.2, 0.2, 0.2])

    def total(change, start):
        scales = start.scales * np.exp(change[4:])
        pose = Pose(start.yaw_rad + change[0], scales, start.shift + change[1:4])
        place = (pose.to_shape(points) + 0.5 + MARGIN) * BANK_CELLS - 0.5
        found = map_coordinates(field, place.T, order=1, mode="nearest") / start.scales[0]
        return np.concatenate(
            [np.sqrt(0.3 * np.minimum(found, FAR)), bounds * change[[0, 4, 5, 6]]]
        )

    for start in STARTS:
        solved = least_squares(total, np.zeros(7), args=(start,), max_nfev=60, diff_step=1e-2).x
        ((_, pose),) = improve_poses([field], [(0, start)], points)
        ours = np.array(
            [
                pose.yaw_rad - start.yaw_rad,
                *(pose.shift - start.shift),
                *np.log(pose.scales / start.scales),
            ]
        )
        sums = [(total(change, start) ** 2).sum() for change in (np.zeros(7), solved, ours)]
        # both stop where distances bend from cell to cell: within a twentieth of what was to gain
        assert sums[2] <= sums[1] + 0.05 * (sums[0] - sums[1])


def test_poses_do_not_know_of_each_other(chair):
    field, points = chair
    other = distance_field(chair_cells()[::-1])
    fields, begun = [field, other], list(zip((0, 1, 0), STARTS, strict=True))
    together = improve_poses(fields, begun, points)
    for (away, pose), (index, start) in zip(together, begun, strict=True):
        ((alone_away, alone),) = improve_poses([fields[index]], [(0, start)], points)
        assert alone_away == pytest.approx(away, abs=1e-12)
        assert np.allclose(alone.scales, pose.scales, atol=1e-9)


def test_nothing_to_hold_on_to_is_no_reason_to_fail(chair):
    field, _ = chair
    far = np.full((4, 3), 5.0)
    ((away, pose),) = improve_poses([field], [(0, beside())], far)
    assert away == FAR
    assert np.isfinite([pose.yaw_rad, *pose.scales, *pose.shift]).all()
    assert improve_poses([], [], far) == []
