import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.shape.symmetry import (
    SOURCES,
    mirror,
    plane_of,
    second_symmetry,
)
from gscomplete.shape.voxels import CELLS
from gscomplete.views import ViewDistribution
from tests.shape.shapes import half, likeliest_inputs, mirrors, sphere

VIEWS = ViewDistribution(0.0, 10.0)


def test_the_companion_shows_something_else():
    points = half(sphere()).means.numpy()
    across, along, turn = mirrors()
    nearly = dataclasses.replace(across, shift=np.array([0.02, 0, 0], np.float32))
    assert second_symmetry([across, nearly, along, turn], 0, points) is along
    assert second_symmetry([across, nearly, along], 1, points) is along
    assert second_symmetry([along, across, turn], 0, points) is across
    assert second_symmetry([across, nearly], 0, points) is nearly  # there is nothing else


def test_what_is_shown_is_two_maps_and_one_after_the_other():
    points = half(sphere()).means.numpy()
    first, second, both = likeliest_inputs(half(sphere()), VIEWS).symmetries
    np.testing.assert_allclose(both.apply(points), second.apply(first.apply(points)), atol=1e-5)


def test_maps_are_rigid_and_undone():
    seen = likeliest_inputs(half(sphere()), VIEWS)
    points = np.random.default_rng(0).normal(size=(20, 3)).astype(np.float32)
    for symmetry in seen.symmetries:
        there = symmetry.apply(points)
        np.testing.assert_allclose(symmetry.undo(there), points, atol=1e-5)
        np.testing.assert_allclose(
            np.linalg.norm(there[1:] - there[:-1], axis=1),
            np.linalg.norm(points[1:] - points[:-1], axis=1),
            atol=1e-5,
        )
    assert seen.volumes.shape == (SOURCES, 4, CELLS, CELLS, CELLS)


@given(st.floats(-10.0, 10.0), st.floats(-1.0, 1.0))
def test_a_mirror_images_plane_is_known(angle, offset):
    symmetry = mirror(angle, offset, 0.5)
    found = mirror(*plane_of(symmetry), 0.5)
    # the matrix holds cosines of twice the angle in float32
    np.testing.assert_allclose(found.matrix, symmetry.matrix, atol=1e-6)
    np.testing.assert_allclose(found.shift, symmetry.shift, atol=1e-6)


def test_planes_are_told_in_the_frame_of_views():
    angle, offset = plane_of(mirror(math.radians(60.0), 0.1, 0.5))
    assert math.degrees(angle) == pytest.approx(60.0, abs=1e-4)
    assert offset == pytest.approx(0.1, abs=1e-6)
