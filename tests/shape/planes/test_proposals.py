import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.planes.features import ANGLES, OFFSETS
from gscomplete.shape.planes.proposals import (
    APART_DEG,
    APART_OFFSET,
    candidate_planes,
    distinct_planes,
    refined,
)
from gscomplete.shape.symmetry_choice import CANDIDATES
from gscomplete.shape.voxels import CELL_SIDE
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half, moved
from tests.builders.shape_network import likeliest_inputs

VIEWS = ViewDistribution(0.0, 10.0)


def dumbbell() -> Splats:
    """Return two unlike balls along y: the planes of symmetry are x = 0 and no other."""
    large, small = ball(radius=0.22), ball(radius=0.12)
    return concatenate([moved(large, (0.0, -0.2, 0.0)), moved(small, (0.0, 0.3, 0.05))])


def test_part_of_a_sphere_is_mirrored_to_what_is_missing():
    """Every upright plane through the middle is right; the one chosen must show something new."""
    partial = half(ball())
    planes = candidate_planes(voxelize_partial(partial, VIEWS), CANDIDATES)
    copy = planes[0].apply(partial.means.numpy())
    missing = copy[copy[:, 0] < -0.05]
    assert len(missing) > 0.4 * len(copy)
    assert np.linalg.norm(missing, axis=1) == pytest.approx(0.4, abs=0.02)
    assert all(0 < plane.score <= 1 for plane in planes)
    assert len(planes) == CANDIDATES


@pytest.mark.parametrize("turn_deg", [0.0, 33.0, 90.0, 161.0])
def test_half_a_dumbbell_finds_its_one_plane(turn_deg):
    """The part beyond a cut at an angle to the plane of symmetry: the copy must still fit."""
    complete = dumbbell()
    partial = complete.select(complete.means @ torch.tensor([0.95, 0.2, 0.0]) > -0.03)
    angle = math.radians(turn_deg)
    turn = torch.tensor(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1.0]]
    ).double()
    placed = Similarity(1.0, turn, torch.zeros(3).double())
    partial, complete = transform_splats(partial, placed), transform_splats(complete, placed)
    views = dataclasses.replace(VIEWS, azimuth_deg=turn_deg)
    seen = likeliest_inputs(partial, views)
    copy = seen.symmetries[0].apply(partial.means.numpy())
    away, _ = cKDTree(complete.means.numpy()).query(copy)
    # Where P has no match for its copy the plane stays on its grid of 5 degrees and 0.025.
    assert np.quantile(away, 0.9) < 1.5 * CELL_SIDE


def test_a_slightly_wrong_plane_is_moved_to_the_right_one():
    part = voxelize_partial(dumbbell(), VIEWS).samples()
    tree = cKDTree(part.spread)
    angle, offset = refined(part, tree, math.radians(2.5), 0.012)
    assert math.degrees(angle) == pytest.approx(0.0, abs=0.05)  # measured: 0.002
    assert offset == pytest.approx(0.0, abs=0.004)


def test_where_nothing_matches_a_plane_stays():
    part = voxelize_partial(half(ball()), VIEWS).samples()
    tree = cKDTree(part.spread)
    assert refined(part, tree, 0.0, -0.4) == (0.0, -0.4)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_ranked_planes_differ_and_none_better_is_left_out(seed, count):
    symmetry_scores = (
        np.random.default_rng(seed).normal(size=(ANGLES, len(OFFSETS))).astype(np.float32)
    )
    planes = distinct_planes(symmetry_scores, count)
    assert len(planes) == count
    found = symmetry_scores[planes[:, 0], planes[:, 1]]
    assert (np.diff(found) <= 0).all()
    turn = np.abs(planes[:, None, 0] - planes[None, :, 0]) * (180 / ANGLES)
    offsets = np.array(OFFSETS)[planes[:, 1]]
    # Half a turn further the normal points the other way, and so the offset changes its sign.
    sign = np.where(turn > 90, -1, 1)
    apart = np.abs(sign * offsets[None, :] - offsets[:, None])
    unlike = (np.minimum(turn, 180 - turn) >= APART_DEG) | (apart >= APART_OFFSET - 1e-6)
    assert unlike[~np.eye(count, dtype=bool)].all()
    better = symmetry_scores > found[-1]
    for a, o in np.argwhere(better):
        turn = np.abs(planes[:, 0] - a) * (180 / ANGLES)
        sign = np.where(turn > 90, -1, 1)
        near = np.minimum(turn, 180 - turn) < APART_DEG
        assert (near & (np.abs(sign * OFFSETS[o] - offsets) < APART_OFFSET + 1e-6)).any()
