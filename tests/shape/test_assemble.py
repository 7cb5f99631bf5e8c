import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from gscomplete.render import render
from gscomplete.shape.assemble import (
    AssembleSettings,
    assemble_splats,
    contradicted_by,
    image_of_half,
    in_holes,
    is_mirrored_by_splats,
    select_consistent,
    stands_off,
    surface_settings,
)
from gscomplete.shape.bank.fit import FittedShape
from gscomplete.shape.bank.pose import Pose
from gscomplete.shape.bank.store import ShapeName
from gscomplete.shape.mirror_plane import MirrorPlane
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.predict import Prediction
from gscomplete.shape.surface import cover
from gscomplete.shape.surface.cover import SurfaceSettings, surface_splats
from gscomplete.shape.surface.solid import solid_views
from gscomplete.shape.symmetry import mirror_image, no_symmetries
from gscomplete.shape.voxels import CELLS
from gscomplete.splats import concatenate
from gscomplete.views import ViewDistribution
from tests.builders.known_shapes import box_cells, cell_points
from tests.builders.lattices import PICKETS
from tests.builders.objects import ball, half, round_splats
from tests.builders.shape_network import mirrors, predicted

VIEWS = ViewDistribution(0.0, 10.0)


def put_together(prediction: Prediction, **changes: object):
    settings = dataclasses.replace(AssembleSettings(count=8000), **changes)
    return assemble_splats(
        prediction, half(ball()), settings, torch.Generator().manual_seed(0)
    ).splats


def test_a_consistent_mirror_image_enters_as_ps_own_splats():
    partial, new = half(ball()), put_together(predicted(0.9))
    image = partial.means * torch.tensor([-1.0, 1.0, 1.0])
    away, index = cKDTree(image.numpy()).query(new.means.numpy())
    mirrored = away < 1e-6
    # The others close the gaps that randomly placed splats leave.
    assert mirrored.mean() > 0.7
    torch.testing.assert_close(
        new.base_colors[torch.from_numpy(mirrored)],
        partial.base_colors[torch.from_numpy(index[mirrored])],
        atol=1e-6,
        rtol=0,
    )


def test_without_a_consistent_image_the_networks_surface_is_all():
    prediction, partial = predicted(0.1), half(ball())
    generator = torch.Generator().manual_seed(0)
    settings = SurfaceSettings(8000, filled_logit=-0.3)
    asked = prediction.output, prediction.inputs, partial, settings, generator
    alone = surface_splats(*asked, solid=solid_views(partial))
    found = put_together(prediction, occupancy_threshold_high=-0.3, occupancy_threshold_low=-0.3)
    assert torch.equal(found.means, alone.means)


@pytest.mark.parametrize(
    ("symmetry_score", "shares", "is_sure"),
    [
        (0.5, (0.0, 0.1), False),  # a copy adds something, and half the ball is missing
        (0.0, (0.0, 0.1), True),  # no copy adds anything
        (0.5, (0.9, 0.95), True),  # less than nine tenths are missing
    ],
)
def test_where_little_is_missing_the_network_has_to_be_surer(symmetry_score, shares, is_sure):
    prediction = predicted(symmetry_score, confidence=40.0)
    found = put_together(
        prediction,
        threshold_missing_shares=shares,
        occupancy_threshold_high=2.0,
        occupancy_threshold_low=-2.0,
    )
    level = 2.0 if is_sure else -2.0
    same = put_together(prediction, occupancy_threshold_high=level, occupancy_threshold_low=level)
    assert torch.equal(found.means, same.means)
    if is_sure:  # whoever asks for no mirror image says nothing about what is missing
        none = prediction.voxels.with_copies(no_symmetries())
        alone = dataclasses.replace(prediction, inputs=none)
        asked = put_together(
            alone,
            threshold_missing_shares=(0.0, 0.1),
            occupancy_threshold_high=2.0,
            occupancy_threshold_low=-2.0,
        )
        unsure = put_together(alone, occupancy_threshold_high=-2.0, occupancy_threshold_low=-2.0)
        assert torch.equal(asked.means, unsure.means)
    other = put_together(
        prediction, occupancy_threshold_high=-level, occupancy_threshold_low=-level
    )
    farthest = found.means.norm(dim=1).max()
    assert bool(other.means.norm(dim=1).max() > farthest) is is_sure


def test_what_one_view_shows_lacks_a_side_however_little_it_seems(monkeypatch):
    whole = ball()
    partial = whole.select(whole.means[:, 0] > 0.1)  # all that a view along x shows
    voxels = voxelize_partial(partial, VIEWS)
    inputs = voxels.with_copies(mirrors())
    scan = dataclasses.replace(predicted(0.0, confidence=40.0), voxels=voxels, inputs=inputs)
    settings = AssembleSettings(
        count=4000, occupancy_threshold_high=2.0, occupancy_threshold_low=-2.0
    )

    def level_and_farthest(*, ends_in_plane: bool) -> tuple[float, float]:
        given = dataclasses.replace(scan, ends_in_plane=ends_in_plane)
        found = assemble_splats(given, partial, settings, torch.Generator().manual_seed(0))
        level = surface_settings(given, settings, None).filled_logit
        return level, float(found.splats.means.norm(dim=1).max())

    (low, farther), (high, nearer) = (
        level_and_farthest(ends_in_plane=end) for end in (False, True)
    )
    assert (low, high) == (-2.0, 2.0)
    assert farther > nearer  # learned depths make up for a part of the levels' distance
    monkeypatch.setattr(cover, "surface_depths", lambda *given: torch.zeros(len(given[3])))
    (_, farther), (_, nearer) = (level_and_farthest(ends_in_plane=end) for end in (False, True))
    assert farther > nearer + 0.05  # .1 where logits fall by 40 per object size


def test_what_no_view_shows_most_of_has_a_level_of_its_own():
    prediction = predicted(0.5, confidence=40.0)
    shown = prediction.voxels.shown_at_once
    sure = {"occupancy_threshold_high": 2.0, "occupancy_threshold_low": 2.0}
    unsure = {"occupancy_threshold_high": -2.0, "occupancy_threshold_low": -2.0}

    def found(shown_of_piece: float):
        return put_together(
            prediction, shown_of_piece=shown_of_piece, occupancy_threshold_piece=-2.0, **sure
        )

    assert torch.equal(found(shown + 0.01).means, put_together(prediction, **unsure).means)
    assert torch.equal(found(shown).means, put_together(prediction, **sure).means)


@pytest.mark.parametrize(("count", "is_sure"), [(60, False), (4000, True)])
def test_scattered_splats_are_no_closed_surface(count, is_sure):
    """All of a ball is there; of few splats, as far scanners see it, most of it is open."""
    partial = ball(count)
    voxels = voxelize_partial(partial, VIEWS)
    half_ball = predicted(0.5, confidence=40.0)
    prediction = dataclasses.replace(half_ball, voxels=voxels, inputs=voxels.with_copies(mirrors()))

    def found(sure: float, unsure: float):
        settings = AssembleSettings(
            count=4000,
            occupancy_threshold_high=sure,
            occupancy_threshold_low=unsure,
            shown_of_piece=0.0,
        )
        return assemble_splats(
            prediction, partial, settings, torch.Generator().manual_seed(0)
        ).splats

    level = 3.0 if is_sure else -3.0
    assert torch.equal(found(3.0, -3.0).means, found(level, level).means)
    assert not torch.equal(found(3.0, -3.0).means, found(-level, -level).means)


def test_the_mirrored_object_has_the_silhouette_of_the_truth():
    complete = concatenate([half(ball()), put_together(predicted(0.9))])
    cameras = VIEWS.ring(8, 96)
    with torch.no_grad():
        ours, truth = render(complete, cameras), render(ball(), cameras)
    iou = ((ours.alpha > 0.5) & (truth.alpha > 0.5)).sum() / (
        (ours.alpha > 0.5) | (truth.alpha > 0.5)
    ).sum()
    assert float(iou) > 0.98


def test_the_networks_surface_leaves_narrow_gaps_of_p_open():
    """Cells are wider than the gaps between pickets."""
    pickets = round_splats(torch.from_numpy(PICKETS).float(), scale=0.008)
    views = ViewDistribution(90.0, 10.0)
    voxels = voxelize_partial(pickets, views)
    none = voxels.with_copies(no_symmetries())
    prediction = dataclasses.replace(predicted(0.1), voxels=voxels, inputs=none)
    found = assemble_splats(
        prediction, pickets, AssembleSettings(), torch.Generator().manual_seed(0)
    ).splats
    at_gap = in_holes(found, voxels)
    everything = surface_splats(
        prediction.output,
        prediction.inputs,
        pickets,
        surface_settings(prediction, AssembleSettings(), None),
        torch.Generator().manual_seed(0),
        solid=solid_views(pickets),
    )
    assert not at_gap.any()
    assert int(in_holes(everything, voxels).sum()) > 50
    assert len(found) == int((~in_holes(everything, voxels)).sum())


@pytest.mark.parametrize("count", [1, 2, 100, 3000])
def test_no_more_splats_of_the_networks_surface_than_asked_for(count):
    settings, partial = AssembleSettings(count=count), half(ball())
    for score in (0.1, 0.9):
        generator = torch.Generator().manual_seed(0)
        found = assemble_splats(predicted(score), partial, settings, generator)
        assert (found.mirrored > 0) == (score > 0.5)
        assert found.mirrored <= len(partial)
        assert 0 < len(found.splats) <= found.mirrored + count
        for _, value in found.splats.fields():
            assert torch.isfinite(value).all()


def test_mirrored_splats_are_as_many_and_as_wide_as_those_of_p():
    partial = half(ball(30_000))
    generator = torch.Generator().manual_seed(0)
    found = assemble_splats(predicted(0.9), partial, AssembleSettings(count=500), generator)
    assert found.mirrored > 0.97 * len(partial)
    copies = found.splats.select(torch.arange(found.mirrored))
    assert float(copies.scales.max()) <= float(partial.scales.max())


def test_beside_the_image_that_is_all_nothing_of_the_networks_surface_counts():
    prediction = predicted(1.0)
    both = put_together(prediction)
    copies = put_together(prediction, image_is_all=True)
    assert 0 < len(copies) < len(both)
    assert torch.equal(copies.means, both.means[: len(copies)])
    not_believed = dataclasses.replace(prediction, symmetry_score=0.1)
    alone = put_together(not_believed)
    assert torch.equal(put_together(not_believed, image_is_all=True).means, alone.means)


def test_one_half_and_its_image_are_the_whole():
    whole = ball(4000)
    part = whole.select(whole.means[:, 0] > 0)
    image = image_of_half(part, MirrorPlane(180.0, 0.0), VIEWS, torch.Generator().manual_seed(0))
    assert len(image) > 0.95 * len(part)
    missing = whole.means[whole.means[:, 0] < 0]
    away, _ = cKDTree(image.means.numpy()).query(missing.numpy())
    # splats lie 0.025 apart
    assert np.quantile(away, 0.99) < 0.03
    assert image.means[:, 0].max() < 0.02


def test_an_image_before_p_is_no_half_of_it():
    """Seen from the side that the image would lie on, it hides P."""
    part = half(ball(4000))
    behind = ViewDistribution(180.0, 10.0)
    image = image_of_half(part, MirrorPlane(180.0, 0.0), behind, torch.Generator().manual_seed(0))
    assert len(image) < 0.2 * len(part)


def test_copies_reach_to_the_seam():
    """No strip is left between P and its mirror image: it would show as a dark line."""
    partial = half(ball(30_000))
    generator = torch.Generator().manual_seed(0)
    found = assemble_splats(predicted(0.9), partial, AssembleSettings(count=500), generator)
    copies = found.splats.means[: found.mirrored]
    spacing = 0.4 * (4 * np.pi / 30_000) ** 0.5
    at_seam = copies[:, 0].abs() < 0.75 * spacing
    expected = partial.means[:, 0].abs() < 0.75 * spacing
    assert int(at_seam.sum()) > 0.5 * int(expected.sum()) > 50


@pytest.mark.parametrize("is_certain", [False, True])
def test_what_the_network_leaves_empty_is_mirrored_through_a_certain_plane_alone(is_certain):
    prediction = predicted(1.0 if is_certain else 0.9)
    empty = torch.full_like(prediction.output.occupancy, -8.0)
    empty[0, :4] = 8.0  # far from P, so that something is missing
    output = dataclasses.replace(prediction.output, occupancy=empty)
    given = dataclasses.replace(prediction, output=output)
    assert is_mirrored_by_splats(given)
    generator = torch.Generator().manual_seed(0)
    found = assemble_splats(given, half(ball()), AssembleSettings(count=100), generator)
    assert (found.mirrored > 0.9 * len(half(ball()))) == is_certain
    assert (found.mirrored == 0) == (not is_certain)


def test_where_no_mirrored_splat_is_left_the_networks_surface_is_all():
    prediction = predicted(0.9)
    across, along, turn = mirrors()
    far = dataclasses.replace(across, shift=np.array([5.0, 0.0, 0.0], np.float32))
    # A box away from the border, whose logits would be consistent with copies beyond it.
    occupancy = torch.full_like(prediction.output.occupancy, -8.0)
    occupancy[:, 16:32, 16:32, 16:32] = 8.0
    nowhere = dataclasses.replace(
        prediction,
        inputs=prediction.voxels.with_copies((far, along, turn)),
        output=dataclasses.replace(prediction.output, occupancy=occupancy),
    )
    level = {"occupancy_threshold_high": 0.0, "occupancy_threshold_low": 0.0}
    found = put_together(nowhere, **level)
    assert len(found) > 0
    not_believed = put_together(dataclasses.replace(nowhere, symmetry_score=0.0), **level)
    assert torch.equal(found.means, not_believed.means)


def test_copies_that_network_or_views_contradict_are_left_out():
    partial = half(ball())
    voxels = voxelize_partial(partial, VIEWS)
    copies = mirror_image(partial, mirrors()[0])
    everywhere = torch.full((1, CELLS, CELLS, CELLS), 5.0)
    assert len(select_consistent(copies, everywhere, voxels.evidence)) == len(copies)
    left = everywhere.clone()
    left[:, :, : CELLS // 2] = -5.0
    kept = select_consistent(copies, left, voxels.evidence)
    assert 0.4 < len(kept) / len(copies) < 0.6
    assert float(kept.means[:, 1].min()) > -0.02
    # P faces the views: what lies above its surface was seen to be empty, but for the rim.
    above = dataclasses.replace(partial, means=1.2 * partial.means)
    facing = above.select(above.means[:, 0] > 0.42)
    assert len(select_consistent(facing, everywhere, voxels.evidence)) < 0.05 * len(facing)


def test_what_lacks_nothing_is_not_mirrored_beside_itself():
    complete = ball()
    voxels = voxelize_partial(complete, VIEWS)
    prediction = dataclasses.replace(
        predicted(0.9), voxels=voxels, inputs=voxels.with_copies(mirrors())
    )
    assert is_mirrored_by_splats(predicted(0.9))
    assert not is_mirrored_by_splats(prediction)


BODY = box_cells((24, 24, 24), at=(12, 12, 12))  # |x|, |y|, |z| <= 0.25
BLUE, RED = torch.tensor([0.1, 0.1, 0.8]), torch.tensor([0.8, 0.1, 0.1])


def all_of(copies):
    return torch.ones(len(copies), dtype=torch.bool)


def known(count):
    """Return known shapes that are the body alone."""
    pose = Pose(0.0, np.ones(3), np.zeros(3))
    name = ShapeName("a/mug", "mug", "a mug")
    return [FittedShape(name, BODY, pose, cell_points(BODY), 0.0, 0.0, 0.0, 0.0)] * count


def body_and_handle(handle_color=RED):
    """Return splats on the body, then those of a bar of .2 that stands on its face at high x."""
    face = torch.rand(2000, 3, generator=torch.Generator().manual_seed(0)) * 0.5 - 0.25
    face[:, 0] = 0.25
    along = torch.linspace(0.25, 0.45, 400)
    bar = torch.stack([along, torch.zeros(400), torch.zeros(400)], dim=1)
    blue, others = round_splats(face, color=BLUE), round_splats(bar, color=handle_color)
    return concatenate([blue, others]), len(face)


def test_known_shapes_contradict_a_second_handle_down_to_its_ends():
    copies, body = body_and_handle()
    marked = contradicted_by(known(2), copies, all_of(copies))
    assert marked[body:].all()
    assert not marked[:body].any()


def test_without_colours_ends_stay_where_they_are_no_longer_than_surfaces_are_coarse():
    copies, body = body_and_handle(BLUE)
    marked = contradicted_by(known(2), copies, all_of(copies))
    sticks_out = copies.means[:, 0] > 0.25 + 0.03 + 1 / 48
    assert marked[sticks_out].all()
    assert not marked[:body].any()


def test_one_shape_or_a_network_that_is_sure_is_not_contradicted():
    copies, _ = body_and_handle()
    assert not contradicted_by(known(1), copies, all_of(copies)).any()
    assert not contradicted_by((), copies, all_of(copies)).any()
    assert not contradicted_by(known(2), copies, all_of(copies) & False).any()


def test_known_shapes_that_have_the_handle_keep_it():
    copies, _ = body_and_handle()
    with_handle = BODY | box_cells((12, 3, 3), at=(36, 23, 23))
    (one,) = known(1)
    other = dataclasses.replace(one, cells=with_handle, points=cell_points(with_handle))
    assert not contradicted_by([one, other], copies, all_of(copies)).any()


def test_the_surface_keeps_no_stumps_of_a_contradicted_handle():
    copies, body = body_and_handle()
    handle = copies.select(torch.arange(len(copies)) >= body)
    marked = stands_off(known(1), copies, handle)
    assert not marked[:body].any()
    sticks_out = copies.means[:, 0] > 0.25 + 0.03 + 1 / 48
    assert marked[sticks_out].all()
    far = handle.select(handle.means[:, 0] > handle.means[:, 0].max() - 1e-3)
    moved = dataclasses.replace(far, means=far.means + torch.tensor([0.0, 0.0, 5.0]))
    assert not stands_off(known(1), copies, moved).any()
