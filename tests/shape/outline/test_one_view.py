import numpy as np
import pytest

from gscomplete.shape.outline.one_view import beside_scan, best_view_share
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


def posts(azimuth_deg=0.0):
    """Return a fence of round posts: each has a rim of its own where it is cut or ends."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = 0.03 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rows = [
        np.column_stack([ring + np.array([x, y]), np.full(len(ring), z)])
        for x in np.linspace(-0.5, 0.5, 9)
        for y in (-0.2, 0.0, 0.2)
        for z in np.linspace(-0.3, 0.3, 25)
    ]
    turn = np.radians(azimuth_deg)
    c, s = np.cos(turn), np.sin(turn)
    return np.concatenate(rows) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])


def scanned(points, azimuth_deg):
    """Return what a view at the height of the points sees of them, pixel by pixel."""
    angle = np.radians(azimuth_deg)
    toward = np.array([np.cos(angle), np.sin(angle), 0.0])
    across = np.stack([points @ [-np.sin(angle), np.cos(angle), 0.0], points[:, 2]], axis=1)
    pixels = np.unique(np.round(across / 0.03), axis=0, return_inverse=True)[1].ravel()
    nearest = np.full(pixels.max() + 1, -np.inf)
    np.maximum.at(nearest, pixels, points @ toward)
    return points[points @ toward > nearest[pixels] - 0.03]


@pytest.mark.parametrize("azimuth_deg", [0.0, 50.0])
def test_a_scan_is_what_one_view_shows_and_a_part_seen_all_round_is_not(azimuth_deg):
    whole = 1e3 * posts(azimuth_deg) + [5.0, 3.0, 1e3]
    assert best_view_share(scanned(posts(azimuth_deg), azimuth_deg)) > 0.9
    assert best_view_share(whole) < 0.7


def test_next_to_nothing_is_all_seen():
    for count in (0, 1, 2):
        assert best_view_share(np.zeros((count, 3))) == 1.0
