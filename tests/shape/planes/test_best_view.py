import numpy as np
import pytest

from gscomplete.shape.planes.best_view import best_view_share


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
