import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.render import render
from gscomplete.shape.ask import mean_answer
from gscomplete.shape.mirror_plane import MirrorPlane
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.placements import (
    brought_back,
    mean_over_placements,
    placements,
    plane_in,
    symmetry_in,
    views_in,
)
from gscomplete.shape.symmetry import mirror
from gscomplete.shape.voxels import CELL_SIDE, CELLS, HALF_SIDE, cell_centers
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half
from tests.builders.shape_network import likeliest_inputs, tiny_network

VIEWS = ViewDistribution(20.0, 10.0)
PROMPTS = torch.tensor([2, 3]), torch.tensor([1, 0])


def frame(scale, x, y, z):
    """Return a frame of the same axes."""
    move = torch.tensor([x, y, z], dtype=torch.float64)
    return Similarity(scale, torch.eye(3, dtype=torch.float64), move)


MOVES = st.floats(-1.0, 1.0)
FRAMES = st.builds(frame, st.floats(0.2, 4.0), MOVES, MOVES, MOVES)


@pytest.fixture(scope="module")
def model():
    return tiny_network()


def centers():
    """Return the places of all cells, [C^3, 3]."""
    return torch.from_numpy(cell_centers(CELLS).reshape(-1, 3)).double()


@given(FRAMES, st.floats(-360.0, 360.0), st.floats(-1.0, 1.0))
def test_a_plane_goes_with_its_frame(there, azimuth_deg, offset):
    plane = MirrorPlane(azimuth_deg, offset)
    found = plane_in(plane, there)
    assert plane_in("none", there) == "none"
    expected = symmetry_in(mirror(math.radians(azimuth_deg), offset, 1.0), there)
    if found == "guess":
        assert np.abs(expected.shift).max() > 1  # twice the offset, along x or y
    else:
        same = mirror(math.radians(found.azimuth_deg), found.offset, 1.0)
        # float32 shifts of up to 20
        np.testing.assert_allclose(same.shift, expected.shift, rtol=0, atol=2e-5)


@given(FRAMES)
def test_a_linear_field_is_brought_back_exactly(there):
    slopes = torch.tensor([1.0, -2.0, 3.0], dtype=torch.float64)
    back = there.inverse()
    in_placement = (back.apply(centers()) @ slopes).float().reshape(1, *(CELLS,) * 3)
    elsewhere = torch.full_like(in_placement, 77.0)
    found = brought_back(in_placement, there, elsewhere).flatten()
    expected = (centers() @ slopes).float()
    between_centers = (there.apply(centers()).abs() <= HALF_SIDE - CELL_SIDE / 2).all(dim=1)
    assert torch.equal(found == 77.0, ~between_centers)
    # float32 values up to 40, interpolated between eight of them
    assert torch.allclose(found[between_centers], expected[between_centers], atol=1e-4)


def test_the_answer_is_the_mean_over_the_object_frame_and_placements(model):
    partial = half(ball())
    seen = likeliest_inputs(partial, VIEWS)
    answer = mean_answer(model, seen, PROMPTS)
    found = mean_over_placements(model, answer, seen, partial, VIEWS, PROMPTS)
    assert found.colors is answer.colors
    logits = [answer.occupancy.double()]
    for there in placements():
        voxels = voxelize_partial(transform_splats(partial, there), views_in(VIEWS, there))
        copies = tuple(symmetry_in(symmetry, there) for symmetry in seen.symmetries)
        moved = mean_answer(model, voxels.with_copies(copies), PROMPTS).occupancy
        logits.append(brought_back(moved, there, answer.occupancy).double())
    expected = torch.stack(logits).mean(dim=0)
    assert not torch.allclose(expected, logits[0], atol=1e-2)
    # float32 sums of three logits below 10
    assert torch.allclose(found.occupancy.double(), expected, atol=1e-5)


def test_placements_are_larger_and_smaller_and_lie_differently_in_the_cells():
    scales = [there.scale for there in placements()]
    assert min(scales) < 1 < max(scales)
    for there in placements():
        moved = there.apply(torch.zeros(3, dtype=torch.float64)) / CELL_SIDE
        assert torch.allclose(moved, torch.full((3,), 0.5, dtype=torch.float64))


@given(FRAMES)
def test_planes_are_carried_there_and_back(there):
    plane = mirror(np.deg2rad(40.0), 0.1, 0.5)
    points = np.random.default_rng(1).normal(size=(20, 3)).astype(np.float32)

    def moved(places):
        return there.apply(torch.from_numpy(places).double()).numpy()

    carried = symmetry_in(plane, there)
    # float32 places of up to 20 object sizes
    assert np.allclose(carried.apply(moved(points)), moved(plane.apply(points)), atol=1e-4)
    back = symmetry_in(carried, there.inverse())
    assert np.allclose(back.apply(points), plane.apply(points), atol=1e-4)
    assert back.score == plane.score


@pytest.mark.parametrize("there", [frame(0.3, 0.2, -0.1, 0.4), frame(1.7, 0.0, 0.3, -0.2)])
def test_pictures_are_the_same_in_another_frame_of_the_same_axes(there):
    splats = ball(2000)
    pairs = (splats, VIEWS), (transform_splats(splats, there), views_in(VIEWS, there))
    ours, theirs = (render(s, v.input_camera(64)) for s, v in pairs)
    # float32 positions: an edge may move by a thousandth of a pixel
    assert torch.allclose(ours.color, theirs.color, atol=2e-3)
    assert torch.allclose(ours.depth * there.scale, theirs.depth, atol=2e-3)
