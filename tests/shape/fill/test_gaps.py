"""Gaps of P: cover, distances and what is seen through them the slow way; verdicts by shape."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.shape.fill import gaps
from gscomplete.shape.fill.facing import (
    Around,
    cameras_around,
    look_around,
    outward_normals,
    pictures_of_normals,
)
from gscomplete.shape.fill.gaps import (
    Cover,
    FillSettings,
    Region,
    components,
    cover_of,
    distances,
    find_regions,
    is_hidden_or_recess,
)
from gscomplete.shape.fill.indicator import CELL_SIDE, solid_through
from gscomplete.splats import Splats
from gscomplete.splats.rotations import rotation_matrices
from tests.builders.objects import even_ball, random_splats

TOLERANCE, OBLIQUE, SIDE = 0.015, 0.2, 0.15


def slow_cover(splats: Splats):
    """Return points on the two longest axes' plane of every splat, in float64, with owners."""
    matrices = rotation_matrices(splats.quaternions).double().numpy()
    points, owners = [], []
    for number in range(len(splats)):
        scales = splats.scales[number].double().numpy()
        first, second = np.argsort(-scales)[:2]
        long, short = (1.2 * scales[k] * matrices[number][:, k] for k in (first, second))
        per_axis = min(max(math.ceil(2 * 1.2 * scales[first] / CELL_SIDE), 1), 9)
        steps = [2 * (k + 0.5) / per_axis - 1 for k in range(per_axis)]
        mean = splats.means[number].double().numpy()
        points += [mean + a * long + b * short for a in steps for b in steps]
        owners += [number] * per_axis**2
    return np.array(points), np.array(owners)


def in_order(points, owners):
    """Sort rows by owner and place, so that two lists of the same points agree."""
    rounded = np.round(points, 4)
    return np.lexsort([*rounded.T[::-1], owners])


def slow_views(points, normals, around: Around, facing, width: float):
    """Count what is seen at points of a region: backs, others, outside, hidden, fronts close by."""
    backs = others = outside = hidden = fronts = 0
    for view in range(len(around.cameras)):
        eye = around.cameras.positions[view].double().numpy()
        for number in range(len(points)):
            point = points[number].double().numpy()
            way = (eye - point) / np.linalg.norm(eye - point)
            row, column, far = (v[0] for v in around.pixels(points[number : number + 1], view))
            if normals[number].double().numpy() @ way <= OBLIQUE:
                continue
            outside += 1
            alpha, depth = float(around.alpha[view, row, column]), around.depth[view, row, column]
            toward = facing[view, row, column].double().numpy() @ way
            behind = alpha > 0.5 and float(depth) > float(far) + TOLERANCE
            backs += behind and toward < -SIDE
            others += (behind and toward > SIDE) + (alpha < 0.5)
            hidden += alpha > 0.5 and not behind
            fronts += behind and float(depth) < float(far) + width and toward > SIDE
    return backs, others, outside, hidden, fronts


def regions_of(
    splats: Splats, settings: FillSettings | None = None, spacing: float | None = None
) -> list[Region]:
    """Return the regions; ``spacing`` replaces that of the cover."""
    around = look_around(splats)
    normals = outward_normals(splats, around)
    cover = cover_of(splats, normals)
    solid = solid_through(cover.points, cover.normals, cover.areas())
    facing = pictures_of_normals(splats, normals, around)
    if spacing is not None:
        cover = dataclasses.replace(cover, spacing=torch.full_like(cover.spacing, spacing))
    return find_regions(solid, cover, around, facing, settings or FillSettings())


def without_cap(way: tuple[float, float, float], cosine: float) -> Splats:
    """Return a closed sphere without the cap about a direction."""
    whole = even_ball(6000, 0.4)
    return whole.select(whole.means @ torch.tensor(way) / 0.4 < cosine)


def shells(depth: float, toward: float) -> tuple[Around, torch.Tensor]:
    """Return pictures of a surface so far behind the frame's middle, turned so to its view."""
    cameras = cameras_around()
    far = cameras.positions.float().norm(dim=1)[:, None, None].expand(48, 192, 192)
    ways = torch.nn.functional.normalize(cameras.positions.float(), dim=1)
    facing = (toward * ways)[:, None, None].expand(48, 192, 192, 3)
    return Around(cameras, torch.ones(48, 192, 192), far + depth), facing


@pytest.mark.parametrize("scale", [0.002, 0.02, 0.2])
def test_the_cover_is_a_grid_on_every_splat(scale):
    splats = random_splats(40, seed=2, scale=scale)
    ways = torch.nn.functional.normalize(splats.means, dim=1)
    cover = cover_of(splats, ways)
    points, owners = slow_cover(splats)
    assert len(cover.points) == len(points)
    found, wanted = cover.points.double().numpy(), in_order(points, owners)
    order = np.argsort(cover.owners.numpy(), kind="stable")
    assert np.array_equal(np.sort(owners), cover.owners.numpy()[order])
    for owner in range(40):  # rows of a splat may come in either order of its axes
        mine, theirs = found[cover.owners.numpy() == owner], points[wanted][owners[wanted] == owner]
        apart = np.linalg.norm(mine[:, None] - theirs[None], axis=2)
        assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-5  # float32 of 1
    assert torch.equal(cover.normals, ways[cover.owners])


def test_spacings_are_means_of_the_six_nearest():
    cover = cover_of(random_splats(30, seed=1, scale=0.02), torch.zeros(30, 3))
    points = cover.points.double().numpy()
    for number in range(0, len(points), 7):
        apart = np.sort(np.linalg.norm(points - points[number], axis=1))
        assert float(cover.spacing[number]) == pytest.approx(apart[1:7].mean(), abs=1e-6)
    assert torch.equal(cover.areas(), cover.spacing * cover.spacing)


def test_a_lone_small_splat_has_one_point_and_no_spacing():
    cover = cover_of(random_splats(1, scale=1e-4), torch.tensor([[0.0, 0.0, 1.0]]))
    assert (cover.points.shape, cover.owners.tolist()) == ((1, 3), [0])
    assert cover.spacing.tolist() == [0.0]
    away, in_spacings = distances(
        cover, cover.points + torch.tensor([[0.008, 0.0, 0.5]]), cover.normals
    )
    # distances along the surface leave out what is along its normal
    assert away.tolist() == pytest.approx([0.008], abs=1e-6)
    assert in_spacings.tolist() == pytest.approx([2.0], abs=1e-4)  # of the least gap, 0.004


def test_distances_are_along_the_surface_and_in_spacings_one_by_one():
    cover = cover_of(random_splats(60, seed=3, scale=0.02), torch.zeros(60, 3))
    draw = torch.Generator().manual_seed(0)
    points = torch.rand(40, 3, generator=draw) - 0.5
    normals = torch.nn.functional.normalize(torch.randn(40, 3, generator=draw), dim=1)
    away, in_spacings = distances(cover, points, normals)
    wide = cover.points.double().numpy()
    for number in range(40):
        offsets = wide - points[number].double().numpy()
        near = np.argsort(np.linalg.norm(offsets, axis=1))[:16]
        normal = normals[number].double().numpy()
        along = [np.linalg.norm(offsets[k] - offsets[k] @ normal * normal) for k in near]
        # PyTorch's median of an even number is the lower of the middle two
        spacing = max(np.sort(cover.spacing.double().numpy()[near])[7], 0.004)
        assert float(away[number]) == pytest.approx(min(along), abs=1e-6)
        assert float(in_spacings[number]) == pytest.approx(min(along) / spacing, rel=1e-4, abs=1e-4)


@given(st.lists(st.floats(0, 10, width=32), max_size=20))
def test_the_limit_of_gaps_follows_usual_distances_within_bounds(values):
    found = gaps._spacings_of_gaps(torch.tensor(values))
    usual = sorted(value for value in values if value < 3.0)
    expected = 1.0
    if usual:
        place = 0.8 * (len(usual) - 1)
        low, high = usual[math.floor(place)], usual[math.ceil(place)]
        typical = low + (place - math.floor(place)) * (high - low)
        expected = min(max(2.4 * typical, 1.0), 2.5)
    assert found == pytest.approx(expected, rel=1e-6)


@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9), st.integers(0, 2)), max_size=25),
    st.sampled_from([0.9, 1.1, 1.5]),
)
def test_components_are_those_of_a_flood(places, reach):
    if not places:
        return
    points = np.array(places, np.float64)
    expected = np.full(len(points), -1)
    for label, start in enumerate(range(len(points))):
        waiting = [start] if expected[start] < 0 else []
        while waiting:
            here = waiting.pop()
            expected[here] = label
            near = np.linalg.norm(points - points[here], axis=1) <= reach
            waiting += np.flatnonzero(near & (expected < 0)).tolist()
    found = components(points, reach)
    assert np.array_equal(found[:, None] == found, expected[:, None] == expected)
    assert found.dtype == np.int64


@pytest.mark.parametrize("way", [(0.0, 0.0, 1.0), (0.6, 0.0, -0.8)])
def test_what_is_seen_through_a_region_is_counted_one_by_one(way):
    splats = without_cap(way, 0.9)
    around = look_around(splats)
    facing = pictures_of_normals(splats, outward_normals(splats, around), around)
    tip = 0.4 * torch.tensor(way)
    points = tip + 0.08 * torch.randn(12, 3, generator=torch.Generator().manual_seed(0))
    normals = torch.tensor(way).repeat(12, 1)
    backs, others, outside, hidden, fronts = slow_views(points, normals, around, facing, 0.3)
    assert min(backs, others, outside, hidden) > 0
    found = gaps._share_of_backs(points, normals, around, facing)
    assert found == pytest.approx(backs / (backs + others), abs=1e-12)
    expected = 2 * hidden > outside or fronts > 0.4 * (outside - hidden)
    assert is_hidden_or_recess(points, normals, 0.3, around, facing) == expected


def test_regions_that_no_camera_sees_have_no_share():
    nothing = torch.zeros(48, 192, 192)
    around = Around(cameras_around(), nothing + 1, nothing)
    facing = torch.zeros(48, 192, 192, 3)
    inward = torch.zeros(4, 3)
    assert gaps._share_of_backs(torch.zeros(4, 3), inward, around, facing) is None


@pytest.mark.parametrize(
    ("depth", "toward", "width", "expected"),
    [
        (0.0, 1.0, 0.2, True),  # hidden by what is in front of it
        (0.1, 1.0, 0.2, True),  # a floor close behind
        (0.3, 1.0, 0.2, False),  # fronts deeper than it is wide
        (0.1, -1.0, 0.2, False),  # backs
        (0.1, 0.1, 0.2, False),  # oblique to the camera
        (0.014, -1.0, 0.2, True),  # too near behind it to be told apart
        (0.016, -1.0, 0.2, False),
    ],
)
def test_lids_are_left_out_where_hidden_or_over_a_shallow_floor(depth, toward, width, expected):
    around, facing = shells(depth, toward)
    lid, up = torch.zeros(3, 3), torch.tensor([[0.0, 0.0, 1.0]]).repeat(3, 1)
    assert is_hidden_or_recess(lid, up, width, around, facing) == expected


@pytest.mark.parametrize(
    ("depth", "toward", "share"),
    [(0.014, -1.0, None), (0.016, -1.0, 1.0), (0.016, 1.0, 0.0), (0.016, 0.1, None)],
)
def test_backs_and_fronts_count_from_beyond_the_tolerance(depth, toward, share):
    up = torch.tensor([[0.0, 0.0, 1.0]])
    assert gaps._share_of_backs(torch.zeros(1, 3), up, *shells(depth, toward)) == share


def test_a_closed_sphere_has_no_gap():
    assert regions_of(even_ball(6000, 0.4)) == []


@pytest.mark.parametrize(
    ("way", "cosine", "verdict"),
    [
        ((1.0, 0.0, 0.0), 0.96, "closed"),
        ((0.0, 0.0, 1.0), 0.93, "opening"),  # wider than 0.2 on top: a mouth
        ((0.0, 0.0, 1.0), 0.985, "closed"),
        ((1.0, 0.0, 0.0), 0.5, "too large"),
        ((0.0, 0.0, -1.0), 0.5, "closed"),  # what an object stands on may be larger
    ],
)
def test_verdicts_on_the_hole_of_a_sphere(way, cosine, verdict):
    (region,) = regions_of(without_cap(way, cosine))
    assert region.verdict == verdict
    # a cap's share of the sphere; the surface through a hole is flatter than the cap
    assert region.share == pytest.approx((1 - cosine) / 2, rel=0.45)
    assert region.is_below == (way[2] < -0.7)
    assert float((region.normals @ torch.tensor(way)).mean()) > 0.8
    assert region.backs is not None
    assert region.backs > 0.8


def test_what_is_nowhere_near_p_is_none_of_its_gaps():
    """With spacings of 0.1 the region begins so far from the rim; with those of 0.02 it is near."""
    splats = without_cap((1.0, 0.0, 0.0), 0.93)
    verdicts = [[region.verdict for region in regions_of(splats, None, s)] for s in (0.1, 0.02)]
    assert verdicts == [["away from P"], ["closed"]]


def test_regions_come_with_the_largest_first_and_settings_decide():
    holes = even_ball(6000, 0.4)
    ways = holes.means / 0.4
    holes = holes.select((ways[:, 0] < 0.93) & (ways[:, 1] < 0.97))
    large, small = regions_of(holes)
    assert large.share > small.share
    assert (large.verdict, small.verdict) == ("closed", "closed")
    between = (large.share + small.share) / 2
    verdicts = [region.verdict for region in regions_of(holes, FillSettings(most_share=between))]
    assert verdicts == ["too large", "closed"]


@pytest.mark.parametrize(
    ("width", "up", "backs", "expected"),
    [
        (0.21, 0.71, 1.0, True),
        (0.2, 0.71, 1.0, False),
        (0.21, 0.7, 1.0, False),
        (0.1, 0.0, 0.49, True),
        (0.1, 0.0, 0.5, False),
        (0.1, 0.0, None, True),
        (0.03, 0.0, 0.0, False),
        (0.03, 0.0, None, False),
    ],
)
def test_openings_are_mouths_and_wide_regions_without_backs(width, up, backs, expected):
    assert gaps._is_opening(width, up, backs) == expected


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"count": 0}, "count"),
        ({"most_share": 0.0}, "most_share"),
        ({"most_share": 1.01}, "most_share"),
        ({"most_share": math.nan}, "most_share"),
    ],
)
def test_settings_out_of_range_are_refused(change, field):
    with pytest.raises(ValueError, match=f"^{field}: expected"):
        dataclasses.replace(FillSettings(), **change)


def test_settings_at_the_ends_of_their_ranges_are_taken():
    assert FillSettings(count=1, most_share=1.0).most_share == 1.0


def test_one_surface_point_far_from_a_cover_of_two():
    """Fewer points than neighbours asked for are enough."""
    splats = random_splats(2, scale=1e-4)
    cover: Cover = cover_of(splats, torch.zeros(2, 3))
    away, _ = distances(cover, torch.tensor([[9.0, 0.0, 0.0]]), torch.tensor([[0.0, 0.0, 1.0]]))
    level = (splats.means - torch.tensor([9.0, 0.0, 0.0]))[:, :2].norm(dim=1)
    assert float(away) == pytest.approx(float(level.min()), rel=1e-6)
