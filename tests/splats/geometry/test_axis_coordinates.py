"""Points about an axis keep their radius and height, and a handle is no part of the body."""

import numpy as np
import pytest

from gscomplete.splats.geometry.axis_coordinates import Axis, Turning, turned
from gscomplete.splats.geometry.revolution import find_revolution
from tests.builders.objects import ball
from tests.builders.vases import handle, vase

UP = np.array([0.0, 0.0, 1.0])


def test_a_handle_is_no_part_of_the_body():
    body, rod = vase(azimuths_deg=(0.0, 180.0)), handle(90.0)
    points = np.concatenate([body, rod])
    found = find_revolution(points)
    assert found is not None
    normals = np.concatenate([_outward(body), _outward(rod - [0.0, 0.42, 0.0])])
    mine, sectors = Turning.about(found.axis, points, normals).body()
    assert mine[: len(body)].mean() > 0.95
    assert mine[len(body) :].mean() < 0.05
    # 18 of the 36 sectors are kept
    assert np.median(sectors[: len(body)]) == pytest.approx(18, abs=1)


def _outward(points):
    """Horizontal unit normals about the z axis."""
    flat = points * np.array([1.0, 1.0, 0.0])
    return flat / np.linalg.norm(flat, axis=1, keepdims=True)


def test_axis_coordinates_are_undone_and_keep_distances():
    axis = Axis.through(np.array([1.0, 2.0, 3.0]), np.array([0.1, -0.05, 1.0]))
    points = ball().means.double().numpy()
    there = axis.to_axis(points)
    np.testing.assert_allclose(axis.from_axis(there), points, atol=1e-12)
    np.testing.assert_allclose(axis.rotation @ axis.direction, UP, atol=1e-12)
    np.testing.assert_allclose(
        np.linalg.norm(there, axis=1), np.linalg.norm(points - axis.point, axis=1)
    )


def test_turning_keeps_radius_and_height():
    points = ball().means.double().numpy()
    angle = np.linspace(-7.0, 7.0, len(points))
    found = turned(points, angle)
    np.testing.assert_allclose(found[:, 2], points[:, 2])
    np.testing.assert_allclose(np.hypot(*found[:, :2].T), np.hypot(*points[:, :2].T))
    np.testing.assert_allclose(turned(found, -angle), points, atol=1e-12)
