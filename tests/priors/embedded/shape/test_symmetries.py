import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from gscomplete.priors.embedded.shape.evidence import FRONT_TOLERANCE, gather_evidence
from gscomplete.priors.embedded.shape.grid import CELL_SIDE, CELLS
from gscomplete.priors.embedded.shape.inputs import SOURCES
from gscomplete.priors.embedded.shape.plane_ranker import packaged_ranker
from gscomplete.priors.embedded.shape.symmetries import (
    candidate_planes,
    refined,
    shown_symmetries,
)
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.views import ViewDistribution
from tests.priors.embedded.shape.shapes import half, likeliest_inputs, moved, sphere
from tests.priors.embedded.shape.test_planes import sampled

VIEWS = ViewDistribution(0.0, 10.0)


def dumbbell() -> Splats:
    """Return two unlike balls along y: the planes of symmetry are x = 0 and no other."""
    large, small = sphere(radius=0.22), sphere(radius=0.12)
    return concatenate([moved(large, (0.0, -0.2, 0.0)), moved(small, (0.0, 0.3, 0.05))])


def test_views_tell_front_behind_and_beside():
    evidence = gather_evidence(half(sphere()), VIEWS)
    points = np.array([[0.45, 0, 0], [0.0, 0, 0], [-0.3, 0, 0], [0, 0.69, 0.5]], np.float32)
    shares = evidence.classify(points)
    assert shares.sum(axis=1) == pytest.approx(1.0, abs=1e-6)
    assert shares[0, 0] > 0.9  # between the camera and the half sphere
    assert shares[1, 1] == pytest.approx(1.0)  # behind its surface
    assert shares[2, 1] == pytest.approx(1.0)
    assert shares[3, 2] > 0.6  # beside it
    assert FRONT_TOLERANCE > 0


def test_part_of_a_sphere_is_mirrored_to_what_is_missing():
    """Every upright plane through the middle is right; the one chosen must show something new."""
    partial = half(sphere())
    points = partial.means.numpy()
    planes = candidate_planes(
        sampled(partial), gather_evidence(partial, VIEWS), packaged_ranker(), 4
    )
    first, second, both = shown_symmetries(planes[0], planes[1])
    copy = first.apply(points)
    missing = copy[copy[:, 0] < -0.05]
    assert len(missing) > 0.4 * len(copy)
    assert np.linalg.norm(missing, axis=1) == pytest.approx(0.4, abs=0.02)
    assert all(0 < plane.score <= 1 for plane in planes)
    np.testing.assert_allclose(both.apply(points), second.apply(copy), atol=1e-5)


@pytest.mark.parametrize("turn_deg", [0.0, 33.0, 90.0, 161.0])
def test_half_a_dumbbell_finds_its_one_plane(turn_deg):
    """The part beyond a cut at an angle to the plane of symmetry: the copy must still fit."""
    whole = dumbbell()
    partial = whole.select(whole.means @ torch.tensor([0.95, 0.2, 0.0]) > -0.03)
    angle = math.radians(turn_deg)
    turn = torch.tensor(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1.0]]
    ).double()
    placed = Similarity(1.0, turn, torch.zeros(3).double())
    partial, whole = transform_splats(partial, placed), transform_splats(whole, placed)
    views = dataclasses.replace(VIEWS, azimuth_deg=turn_deg)
    seen = likeliest_inputs(partial, views)
    copy = seen.symmetries[0].apply(partial.means.numpy())
    away, _ = cKDTree(whole.means.numpy()).query(copy)
    # Where P has no match for its copy the plane stays on its grid of 5 degrees and 0.025.
    assert np.quantile(away, 0.9) < 1.5 * CELL_SIDE


def test_a_slightly_wrong_plane_is_moved_to_the_right_one():
    part = sampled(dumbbell())
    tree = cKDTree(part.spread)
    angle, offset = refined(part, tree, math.radians(2.5), 0.012)
    assert math.degrees(angle) == pytest.approx(0.0, abs=0.7)
    assert offset == pytest.approx(0.0, abs=0.004)


def test_where_nothing_matches_a_plane_stays():
    part = sampled(half(sphere()))
    tree = cKDTree(part.spread)
    assert refined(part, tree, 0.0, -0.4) == (0.0, -0.4)


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


def test_maps_follow_points_to_another_frame():
    frame = Similarity(1.3, torch.eye(3).double(), torch.tensor([0.1, -0.2, 0.05]).double())
    points = np.random.default_rng(0).normal(size=(20, 3))
    there = 1.3 * points + frame.translation.numpy()
    for symmetry in likeliest_inputs(half(sphere()), VIEWS).symmetries:
        expected = 1.3 * symmetry.apply(points.astype(np.float32)) + frame.translation.numpy()
        found = symmetry.in_frame(frame).apply(there.astype(np.float32))
        np.testing.assert_allclose(found, expected, atol=1e-5)
