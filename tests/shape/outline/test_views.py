import numpy as np
import pytest

from gscomplete.shape.outline.views import (
    AZIMUTHS,
    ELEVATIONS_DEG,
    SIDE_PX,
    outline,
    views_at,
)
from tests.builders.objects import ball

BALL = ball(6000).means.numpy()  # radius 0.4
CELL = 2 * 0.9 / SIDE_PX


def places(*rows):
    return np.array(rows, np.float32)


def test_the_grid_goes_round_at_every_elevation():
    views = views_at(2.2)
    assert len(views) == len(ELEVATIONS_DEG) * AZIMUTHS
    toward = np.stack([view.toward for view in views])
    assert np.degrees(np.arcsin(toward[::AZIMUTHS, 2])) == pytest.approx(ELEVATIONS_DEG, abs=1e-4)
    azimuth = np.degrees(np.arctan2(toward[:AZIMUTHS, 1], toward[:AZIMUTHS, 0])) % 360
    assert azimuth == pytest.approx(np.arange(AZIMUTHS) * 360 / AZIMUTHS, abs=1e-3)
    for view in views:
        assert view.axes @ view.axes.T == pytest.approx(np.eye(3), abs=1e-6)
        assert np.linalg.det(view.axes) == pytest.approx(1.0, abs=1e-5)


def test_pixels_are_those_of_a_pinhole_whose_picture_goes_through_the_target():
    view = views_at(2.0)[0]  # from +x
    points = places((0, 0.3, -0.2), (0.5, 0.3, -0.2), (-0.5, 0.3, -0.2))
    pixel, depth = view.pixels(points)
    assert depth == pytest.approx([2.0, 1.5, 2.5])
    for n, stretch in enumerate((1.0, 2.0 / 1.5, 2.0 / 2.5)):
        row, column = divmod(int(pixel[n]), SIDE_PX)
        assert column == int((0.3 * stretch + 0.9) / CELL)
        assert row == int((-0.2 * stretch + 0.9) / CELL)


def test_what_is_far_off_is_at_the_border_of_the_picture():
    pixel, _ = views_at(2.0)[0].pixels(places((0, 9, 9), (0, -9, -9), (5, 0.1, 0.1)))
    assert pixel[0] == SIDE_PX**2 - 1
    assert pixel[1] == 0
    assert 0 <= pixel[2] < SIDE_PX**2


def test_an_outline_reaches_two_pixels_beyond_its_points():
    covered = outline(np.array([30 * SIDE_PX + 40]))
    rows, columns = covered.nonzero()
    assert (rows.min(), rows.max()) == (28, 32)
    assert (columns.min(), columns.max()) == (38, 42)


def test_beside_a_ball_is_what_its_disc_does_not_cover():
    asked = places(
        (0, 0.55, 0), (0, 0, 0.6), (-0.5, 0, 0), (0.5, 0, 0), (0, 0.3, 0), (-0.6, 0.3, 0)
    )
    found = views_at(2.2)[0].beside(BALL, asked, SIDE_PX, 7)
    assert found.tolist() == [True, True, False, False, False, False]
