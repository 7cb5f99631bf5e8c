import dataclasses

import numpy as np

from gscomplete.priors.embedded.shape.grid import CELLS
from gscomplete.priors.embedded.shape.symmetries import (
    SOURCES,
    companion,
)
from gscomplete.views import ViewDistribution
from tests.priors.embedded.shape.shapes import half, likeliest_inputs, mirrors, sphere

VIEWS = ViewDistribution(0.0, 10.0)


def test_the_companion_shows_something_else():
    points = half(sphere()).means.numpy()
    across, along, turn = mirrors()
    nearly = dataclasses.replace(across, shift=np.array([0.02, 0, 0], np.float32))
    assert companion([across, nearly, along, turn], 0, points) is along
    assert companion([across, nearly, along], 1, points) is along
    assert companion([along, across, turn], 0, points) is across
    assert companion([across, nearly], 0, points) is nearly  # there is nothing else


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
