import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.render import render
from gscomplete.shape.symmetry import (
    SOURCES,
    mirror,
    mirror_image,
    plane_of,
    second_symmetry,
    with_composition,
)
from gscomplete.shape.voxels import CELLS
from gscomplete.splats import Splats
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half, random_splats
from tests.builders.shape_network import likeliest_inputs, mirrors

VIEWS = ViewDistribution(0.0, 10.0)


def test_the_second_symmetry_differs_from_the_first():
    points = half(ball()).means.numpy()
    across, along, turn = mirrors()
    nearly = dataclasses.replace(across, shift=np.array([0.02, 0, 0], np.float32))
    assert second_symmetry([across, nearly, along, turn], 0, points) is along
    assert second_symmetry([across, nearly, along], 1, points) is along
    assert second_symmetry([along, across, turn], 0, points) is across
    assert second_symmetry([across, nearly], 0, points) is nearly  # there is nothing else


def test_inputs_are_two_maps_and_their_composition():
    points = half(ball()).means.numpy()
    first, second, both = likeliest_inputs(half(ball()), VIEWS).symmetries
    np.testing.assert_allclose(both.apply(points), second.apply(first.apply(points)), atol=1e-5)


def test_maps_are_rigid_and_undone():
    seen = likeliest_inputs(half(ball()), VIEWS)
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


def covariances(splats: Splats) -> torch.Tensor:
    axes = rotation_matrices(splats.quaternions) * splats.scales[:, None]
    return axes @ axes.transpose(1, 2)


@settings(max_examples=30, deadline=None)
@given(st.floats(-math.pi, math.pi), st.floats(-0.4, 0.4), st.booleans())
def test_ellipsoids_are_mirrored(angle, offset, twice):
    one = mirror(angle, offset, 0.5)
    symmetry = with_composition(one, mirror(angle + 1.0, 0.1, 0.5))[2] if twice else one
    splats = random_splats(30, 1)
    image = mirror_image(splats, symmetry)
    matrix = torch.from_numpy(symmetry.matrix)
    # float32 products of numbers below 0.02
    torch.testing.assert_close(
        covariances(image), matrix @ covariances(splats) @ matrix.T, atol=1e-7, rtol=1e-4
    )
    assert np.allclose(image.means.numpy(), symmetry.apply(splats.means.numpy()))
    assert torch.equal(image.opacities, splats.opacities)
    assert image.sh.shape[1] == 1


def test_the_picture_of_the_image_is_the_mirrored_picture():
    """Seen along y, the mirror image through x = 0 is the picture turned left to right."""
    splats = random_splats(30)
    cameras = ViewDistribution(90.0, 0.0).cameras((np.zeros(1) + 90.0, np.zeros(1)), 48)
    pictures = [render(s, cameras).color[0] for s in (splats, mirror_image(splats, mirrors()[0]))]
    # float32 rendering of mirrored pixel centres
    torch.testing.assert_close(pictures[1], pictures[0].flip(1), atol=2e-4, rtol=0)


@pytest.mark.parametrize("count", [0, 1])
def test_few_splats_are_mirrored_too(count):
    splats = random_splats(30).select(torch.arange(30) < count)
    assert len(mirror_image(splats, mirrors()[0])) == count
