import numpy as np
import pytest

from gscomplete.shape.silhouette import beside_scan
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball

VIEWS = ViewDistribution(0.0, 10.0)
BALL = ball(6000).means.numpy()  # radius 0.4


def seen_from_x(points, distance=2.2):
    """Keep what a scanner on the x axis sees of a ball about the origin."""
    return points[points[:, 0] > 0.4**2 / distance]


def places(*rows):
    return np.array(rows, np.float32)


def test_what_is_behind_a_scan_may_be_there_and_what_is_beside_it_may_not():
    asked = places((-0.3, 0, 0), (-0.1, 0.2, 0), (0, 0.6, 0), (0, 0, 0.7), (-0.3, 0, -0.6))
    found = beside_scan(seen_from_x(BALL), VIEWS, asked)
    assert found.tolist() == [False, False, True, True, True]


def test_gaps_of_a_silhouette_are_beside_it():
    seen = seen_from_x(BALL)
    halves = seen[np.abs(seen[:, 1]) > 0.12]
    asked = places((0.1, 0, 0), (0.3, 0, 0), (-0.1, 0.3, 0), (-0.1, -0.3, 0))
    assert beside_scan(halves, VIEWS, asked).tolist() == [True, True, False, False]


@pytest.mark.parametrize("kept", [BALL, BALL[BALL[:, 2] < 0.1], BALL[BALL[:, 0] > -0.2]])
def test_what_no_view_shows_was_not_scanned_from_one(kept):
    assert not beside_scan(kept, VIEWS, places((0, 0.6, 0), (0, 0, 0.7), (0.7, 0.2, 0))).any()


def test_what_is_seen_from_all_sides_was_scanned_from_none():
    y, z = np.meshgrid(np.linspace(-0.4, 0.4, 60), np.linspace(-0.4, 0.4, 60))
    sheet = np.stack([y.ravel(), z.ravel(), np.zeros(3600)], axis=1).astype(np.float32)
    for points in (sheet, places((0, 0, 0))):
        assert not beside_scan(points, VIEWS, places((0, 0.7, 0), (0, 0, 0.7))).any()


def test_part_of_a_plate_is_seen_from_above_and_no_scan():
    dish = BALL[BALL[:, 2] < -0.3]  # shallow: its inside shows from above alone
    assert not beside_scan(dish[dish[:, 0] < 0.1], VIEWS, places((0.4, 0, -0.3))).any()


def test_the_distance_and_the_target_of_the_views_count():
    asked = places((-0.3, 0, 0), (0, 0.6, 0))
    moved = ViewDistribution(0.0, 10.0, target=(0.1, -0.2, 0.3))
    shift = np.array(moved.target, np.float32)
    found = beside_scan(seen_from_x(BALL) + shift, moved, asked + shift)
    assert found.tolist() == [False, True]
