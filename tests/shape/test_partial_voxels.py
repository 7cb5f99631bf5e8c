"""The network's inputs hold P, its mirror images and the views' evidence where they say."""

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.shape.evidence import gather_evidence
from gscomplete.shape.outline.one_view import best_view_share
from gscomplete.shape.partial_voxels import PartialVoxels, ShapeInputs, voxelize_partial
from gscomplete.shape.symmetry import (
    COPIES,
    SOURCES,
    SymmetryMap,
    mirror,
    no_symmetries,
    with_composition,
)
from gscomplete.shape.voxels import (
    CELL_SIDE,
    CELLS,
    COARSE_CELLS,
    HALF_SIDE,
    cell_centers,
    splat_arrays,
)
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution
from tests.builders.objects import RED, ball, half, round_splats
from tests.builders.shape_network import mirrors

VIEWS = ViewDistribution(0.0, 10.0)
PLACES = st.lists(
    st.tuples(*[st.floats(-HALF_SIDE, HALF_SIDE, exclude_max=True)] * 3), min_size=1, max_size=6
)


def voxels_of(partial: Splats) -> PartialVoxels:
    """Return P's voxels without evidence, which takes pictures."""
    arrays = splat_arrays(partial)
    nothing = np.zeros((4, CELLS, CELLS, CELLS), np.float32)
    shares = np.zeros((3, COARSE_CELLS, COARSE_CELLS, COARSE_CELLS), np.float32)
    return PartialVoxels(*arrays, nothing, None, shares)  # type: ignore[arg-type]


def slow_volume(positions, tangents, opacities, colors):
    """Return occupancy and mean colour in float64, sample by sample."""
    total, color = np.zeros((CELLS,) * 3), np.zeros((3, CELLS, CELLS, CELLS))
    for n in range(len(positions)):
        for step in (np.zeros(3), *(s * tangents[n, a] for a in (0, 1) for s in (-1, 1))):
            cell = np.floor((positions[n] + step + HALF_SIDE) / CELL_SIDE).astype(int)
            if (cell >= 0).all() and (cell < CELLS).all():
                total[tuple(cell)] += opacities[n]
                color[(slice(None), *cell)] += opacities[n] * colors[n]
    return np.concatenate([np.minimum(total, 1)[None], color / np.where(total > 0, total, 1)])


@pytest.fixture(scope="module")
def scan() -> PartialVoxels:
    return voxelize_partial(half(ball(1500)), VIEWS)


@pytest.fixture(scope="module")
def inputs(scan: PartialVoxels) -> ShapeInputs:
    return scan.with_copies(mirrors())


def test_shares_are_what_the_evidence_says_of_every_coarse_cell(scan):
    evidence = gather_evidence(half(ball(1500)), VIEWS)
    centers = cell_centers(COARSE_CELLS)
    for cell in np.ndindex(4, 4, 4):
        x, y, z = (6 * np.array(cell) + [1, 2, 3]).tolist()
        of_one = evidence.classify(np.ascontiguousarray(centers[x, y, z][None]))
        assert np.array_equal(scan.shares[:, x, y, z], of_one[0])
    # the views are out along x; the half ball reaches from x = 0 to 0.4
    in_front, behind = (scan.shares[:, x, COARSE_CELLS // 2, COARSE_CELLS // 2] for x in (19, 10))
    assert (in_front.tolist(), behind.tolist()) == ([1, 0, 0], [0, 1, 0])
    assert scan.shares.flags.c_contiguous


def test_the_volumes_are_p_and_its_images_sample_by_sample(scan):
    turning = with_composition(mirror(0.3, 0.05, 0.6), mirror(1.2, -0.02, 0.3))
    inputs = scan.with_copies(turning)
    assert inputs.volumes.shape == (SOURCES, 4, CELLS, CELLS, CELLS)
    assert (inputs.volumes.dtype, inputs.scores.dtype) == (np.float32, np.float32)
    p = [a.astype(np.float64) for a in (scan.positions, scan.tangents, scan.opacities, scan.colors)]
    for number in range(SOURCES):
        places, tangents = p[0], p[1]
        if number:
            matrix = turning[number - 1].matrix.astype(np.float64)
            places = np.array([matrix @ x + turning[number - 1].shift for x in places])
            tangents = np.array([[matrix @ t for t in pair] for pair in tangents])
        expected = slow_volume(places, tangents, *p[2:])
        wrong = (np.abs(inputs.volumes[number] - expected) > 1e-4).any(axis=0)
        # of 7,500 samples two at most lie within a float32 rounding of a border of their cell
        assert wrong.sum() <= 4


def test_copies_come_after_p_in_order_with_their_scores(scan, inputs):
    assert np.array_equal(inputs.volumes[0], scan.volume)
    assert inputs.scores.tolist() == pytest.approx([0.6, 0.2, 0.4])
    assert inputs.evidence is scan.shares
    swapped = scan.with_copies((mirrors()[2], mirrors()[0], mirrors()[1]))
    assert np.array_equal(swapped.volumes[[0, 2, 3, 1]], inputs.volumes)


@given(PLACES)
@settings(max_examples=30)
def test_images_through_the_middle_are_the_volume_turned_around(places):
    # a splat on the border between two cells belongs to the upper one, on either side
    off_border = [[(np.floor(v / CELL_SIDE) + 0.5) * CELL_SIDE for v in place] for place in places]
    volumes = voxels_of(round_splats(off_border, scale=1e-4)).with_copies(mirrors()).volumes
    identity = voxels_of(round_splats(off_border, scale=1e-4)).with_copies(no_symmetries()).volumes
    assert volumes[1, 0].sum() > 0
    for image, axes in ((1, (1,)), (2, (2,)), (3, (1, 2))):
        assert np.array_equal(volumes[image], np.flip(identity[1], axes))


def test_images_of_one_splat_are_where_the_map_takes_it():
    """A plane's image is as far behind it; what leaves the grid is left out."""
    plane, away = mirror(np.pi / 2, 0.1, 0.5), mirror(0.0, 0.72, 0.5)
    splat = voxels_of(round_splats([[0.31, -0.2, 0.4]], scale=1e-4, opacity=0.2, color=RED))
    volumes = splat.with_copies((plane, away, plane)).volumes
    cell = tuple(np.floor((np.array([0.31, 0.4, 0.4]) + HALF_SIDE) / CELL_SIDE).astype(int))
    assert np.argwhere(volumes[1, 0]).tolist() == [list(cell)]
    assert volumes[(1, slice(None), *cell)].tolist() == pytest.approx([1, *RED], abs=1e-6)
    assert not volumes[2].any()


def test_a_surface_takes_the_first_place_in_ps_nearest_colours(scan, inputs):
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (60, 3))
    shaped = scan.with_shape(inputs, points)
    apart = np.linalg.norm(points[:, None] - scan.positions[None].astype(np.float64), axis=2)
    colors = scan.colors[apart.argmin(axis=1)].astype(np.float64)
    tangents = np.tile([[0.008, 0, 0], [0, 0, 0.008]], (len(points), 1, 1))
    expected = slow_volume(points, tangents, np.ones(len(points)), colors)
    wrong = (np.abs(shaped.volumes[1] - expected) > 1e-4).any(axis=0)
    # one of 300 samples at most lies within a float32 rounding of a border of its cell
    assert wrong.sum() <= 2
    assert np.array_equal(shaped.volumes[[0, 2, 3]], inputs.volumes[[0, 1, 2]])
    assert shaped.evidence is inputs.evidence


def test_a_surface_pushes_out_the_last_image_and_stays_where_it_is(scan, inputs):
    shaped = scan.with_shape(inputs, np.array([[0.1, 0.2, 0.3]]))
    assert len(shaped.symmetries) == len(shaped.scores) == COPIES
    assert shaped.symmetries[1:] == inputs.symmetries[:-1]
    assert shaped.scores.tolist() == pytest.approx([0.5, 0.6, 0.2])
    same: SymmetryMap = shaped.symmetries[0]
    assert same.score == 0.5
    assert np.array_equal(same.apply(scan.positions), scan.positions)


def test_images_are_one_plane_a_differing_one_and_both_in_turn(scan):
    planes = [mirror(0.0, 0.0, 0.9), mirror(0.01, 0.0, 0.8), mirror(np.pi / 2, 0.0, 0.7)]
    one, other, both = scan.input_symmetries(planes, 0)
    assert (one is planes[0], other is planes[2]) == (True, True)
    assert both.apply(scan.positions) == pytest.approx(other.apply(one.apply(scan.positions)))
    assert both.score == pytest.approx(0.8)


def test_how_much_the_best_view_shows_is_reckoned_once(scan, monkeypatch):
    fresh = dataclasses.replace(scan)
    assert fresh.shown_at_once == best_view_share(scan.positions)
    monkeypatch.setattr("gscomplete.shape.partial_voxels.best_view_share", lambda _: -1.0)
    assert fresh.shown_at_once >= 0
    assert dataclasses.replace(scan).shown_at_once == -1


def test_samples_are_of_p(scan):
    samples = scan.samples()
    assert len(samples.points) <= len(scan.positions)
    known = {tuple(row) for row in scan.positions.tolist()}
    assert {tuple(row) for row in samples.points.tolist()} <= known


def test_one_splat_and_splats_far_away_make_inputs():
    lone = round_splats([[0.1, 0.0, 0.0]])
    far = dataclasses.replace(lone, means=torch.tensor([[50.0, 0.0, 0.0]]))
    assert voxelize_partial(lone, VIEWS).volume[0].any()
    assert not voxelize_partial(far, VIEWS).with_copies(mirrors()).volumes.any()
