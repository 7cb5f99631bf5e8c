import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from gscomplete.render import render
from gscomplete.shape.network import ShapeOutput
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.surface.cover import (
    SurfaceSettings,
    is_missing,
    median_spacing,
    new_surface,
    on_copies,
    surface_splats,
)
from gscomplete.shape.surface.turned import turned_surface
from gscomplete.shape.symmetry import SOURCES
from gscomplete.shape.voxels import (
    CELL_SIDE,
    CELLS,
    COARSE_CELLS,
    cell_centers,
    sample_volume,
)
from gscomplete.splats import concatenate
from gscomplete.splats.geometry.neighbourhood import one_sidedness
from gscomplete.splats.geometry.revolution import find_revolution
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half
from tests.builders.shape_network import likeliest_inputs, mirrors

VIEWS = ViewDistribution(0.0, 10.0)


def ball_output(radius=0.4):
    """Return what a network that believes in a ball would say."""
    distance = torch.from_numpy(np.linalg.norm(cell_centers(CELLS), axis=-1))
    coarse = torch.zeros(1, 3, COARSE_CELLS, COARSE_CELLS, COARSE_CELLS)
    sources = torch.zeros(1, SOURCES + 1, COARSE_CELLS, COARSE_CELLS, COARSE_CELLS)
    return ShapeOutput((40 * (radius - distance))[None], coarse, sources)


def guess(settings=None, output=None, partial=None):
    partial = half(ball()) if partial is None else partial
    generator = torch.Generator().manual_seed(0)
    return surface_splats(
        output or ball_output(),
        likeliest_inputs(partial, VIEWS),
        partial,
        settings or SurfaceSettings(),
        generator,
    )


def test_a_turned_surface_takes_the_place_of_a_wrong_prediction():
    partial = half(ball())
    points = partial.means.double().numpy()
    revolution = find_revolution(points)
    assert revolution is not None
    voxels = voxelize_partial(partial, VIEWS)
    draw = torch.Generator().manual_seed(0)
    turned = turned_surface(points, revolution, voxels.evidence, draw)
    assert turned is not None
    asked = ball_output(0.47), likeliest_inputs(partial, VIEWS), partial, SurfaceSettings(), draw
    wrong, right = surface_splats(*asked), surface_splats(*asked, turned=turned)
    # the ball's radius is .4
    for splats, is_right in ((wrong, False), (right, True)):
        radius = splats.means.norm(dim=1)
        assert (float((radius - 0.4).abs().quantile(0.95)) < 0.02) == is_right
    assert float(right.scales[:, :2].max()) < float(wrong.scales[:, :2].max())


def test_interpolation_reads_cell_centres():
    volume = torch.rand(2, CELLS, CELLS, CELLS)
    centers = torch.from_numpy(cell_centers(CELLS))
    places = torch.tensor([[3, 5, 7], [20, 0, 47], [10, 11, 12]])
    points = centers[places[:, 0], places[:, 1], places[:, 2]]
    expected = volume[:, places[:, 0], places[:, 1], places[:, 2]].T
    torch.testing.assert_close(sample_volume(volume, points), expected, atol=2e-5, rtol=0)


@pytest.mark.parametrize(("near_rim", "least"), [(0.01, 0.99), (SurfaceSettings().near_rim, 0.98)])
def test_discs_lie_on_the_surface_and_not_on_p(near_rim, least):
    splats = guess(SurfaceSettings(near_rim=near_rim))
    distance = splats.means.norm(dim=1)
    # The level lies 0.025 outside; about a cell (0.03) deeper, and smoothed.
    assert float((distance - 0.4).abs().max()) < 0.035
    # All but a few in the random gaps between P's own splats, which are up to .03 wide; more of
    # these gaps are wide enough the nearer splats may come.
    assert float((splats.means[:, 0] < 0.05).float().mean()) > least
    assert len(splats) > 1000


def test_the_completion_is_closed_and_of_the_right_size():
    partial = half(ball())
    complete = concatenate([partial, guess()])
    cameras = VIEWS.ring(8, 96)
    with torch.no_grad():
        ours = render(complete, cameras).alpha > 0.5
        truth = render(ball(), cameras).alpha > 0.5
    iou = (ours & truth).sum(dim=(1, 2)) / (ours | truth).sum(dim=(1, 2))
    assert float(iou.min()) > 0.93


def test_places_inside_a_thin_rod_hardly_pass_its_axis():
    away = torch.from_numpy(cell_centers(CELLS)) / CELL_SIDE
    output = ball_output()
    output.occupancy[0] = 1.0 - 2.0 * away[..., :2].norm(dim=-1)
    output.occupancy[0][away[..., 2].abs() > 12] = -8.0
    generator = torch.Generator().manual_seed(0)
    rod = new_surface(output, torch.full((1, 3), 9.0), SurfaceSettings(), generator)
    inside = rod.points - rod.insets[:, None] * rod.normals
    beside = inside[:, 2].abs() < 0.2  # of the rod's ends
    outside = (inside * rod.normals).sum(dim=1)[beside] / CELL_SIDE
    assert len(outside) > 100
    assert float(outside.min()) > -0.25  # one of the steps inward; all of them: -0.5
    assert float(outside.max()) < 0.05


@pytest.mark.parametrize("count", [1, 50, 3000])
def test_no_more_splats_than_asked_for(count):
    splats = guess(SurfaceSettings(count=count))
    assert 0 < len(splats) <= count
    for _, value in splats.fields():
        assert torch.isfinite(value).all()


def test_nothing_believed_gives_nothing_and_everything_gives_something_finite():
    empty = ball_output(radius=-2.0)
    assert len(guess(output=empty)) == 0
    full = guess(output=ball_output(radius=5.0))
    assert torch.isfinite(full.means).all()


def test_the_same_seed_gives_the_same_splats():
    first, again = guess(), guess()
    for (_, a), (_, b) in zip(first.fields(), again.fields(), strict=True):
        assert torch.equal(a, b)


def test_the_surface_goes_on_from_ps_rim_without_a_gap():
    """Within P nothing is added, however near its splats are to each other; beyond its rim there
    are splats nearer than ``near_partial``, so that no seam shows."""
    partial = half(ball(20_000))
    new = guess(SurfaceSettings(count=20_000), partial=partial).means
    distance = torch.cdist(new, partial.means).amin(dim=1)
    beyond = new[:, 0] < 0.0
    assert int((distance[beyond] < 0.025).sum()) > 50
    inside = new[:, 0] > 0.02  # a few, in the random gaps between P's own splats
    assert int(inside.sum()) < 0.005 * len(new)
    apart = guess(SurfaceSettings(count=20_000, near_rim=0.03), partial=partial).means
    # Kept points then move onto a copy, if one is near: here by little, for it is the same ball.
    assert float(torch.cdist(apart, partial.means).min()) >= 0.03 - 0.1 * CELL_SIDE


def test_points_near_a_copy_move_onto_it_and_others_stay():
    partial = half(ball(12_000))
    inputs = voxelize_partial(partial, VIEWS).with_copies(mirrors())
    normals = torch.nn.functional.normalize(
        torch.from_numpy(inputs.symmetries[0].apply(partial.means.numpy()[::40])), dim=1
    )
    near = on_copies((0.4 + 0.7 * CELL_SIDE) * normals, normals, partial.means, inputs)
    # P's own splats lie on the sphere; the mean of four of them lies a little inside it.
    assert float((near.norm(dim=1) - 0.4).abs().max()) < 0.1 * CELL_SIDE
    apart = (0.4 + 2 * CELL_SIDE) * normals
    assert torch.equal(on_copies(apart, normals, partial.means, inputs), apart)


def test_gaps_are_told_from_surface_that_is_there():
    """Two sheets 0.01 apart in spacing, 0.04 from each other; points 0.02 above all that."""
    along = torch.arange(-0.3, 0.3, 0.01)
    x, y = torch.meshgrid(along, along, indexing="ij")
    sheet = torch.stack([x, y, torch.zeros_like(x)], dim=-1).reshape(-1, 3)
    there = sheet[sheet[:, 0].abs() > 0.02]
    points = torch.tensor([[0.0, 0.0, 0.02], [0.003, 0.1, 0.02], [0.1, 0.0, 0.02]])
    normals = torch.tensor([[0.0, 0.0, 1.0]]).expand(3, -1)
    left = SurfaceSettings(near_partial=0.045)
    assert is_missing(points, normals, there, left).tolist() == [False, False, False]
    closed = SurfaceSettings(near_partial=0.045, gap_spacings=1.5)
    assert is_missing(points, normals, there, closed).tolist() == [True, True, False]
    wide = SurfaceSettings(near_partial=0.045, gap_spacings=4.0)
    assert is_missing(points, normals, there, wide).tolist() == [False, False, False]


def _is_missing_asking_all(points, normals, others, settings):
    """``is_missing`` as its description reads: every point is asked everything."""
    distance, index = cKDTree(others.numpy()).query(points.numpy(), k=12)
    near = torch.from_numpy(distance[:, 0])
    ways = others[torch.from_numpy(index)] - points[:, None]
    ways = ways - (ways * normals[:, None]).sum(dim=2, keepdim=True) * normals[:, None]
    beyond = torch.from_numpy(one_sidedness(ways.numpy()) > 0.7) & (near > settings.near_rim)
    if settings.gap_spacings is not None:
        widest = max(settings.gap_spacings * median_spacing(others), 0.004)
        beyond |= ways.norm(dim=2).amin(dim=1) > widest
    return (near > settings.near_partial) | beyond


@pytest.mark.parametrize("spacings", [None, 0.5, 3.0])
@pytest.mark.parametrize("count", [40, 700, 6000])
def test_points_that_are_not_asked_everything_get_the_same_answer(spacings, count):
    draw = torch.Generator().manual_seed(count)
    normals = torch.nn.functional.normalize(torch.randn(8000, 3, generator=draw), dim=1)
    points = normals * (0.4 + 0.02 * torch.randn(8000, 1, generator=draw))
    others = torch.nn.functional.normalize(torch.randn(count, 3, generator=draw), dim=1) * 0.4
    others = others[others[:, 0] < 0.2]
    settings = SurfaceSettings(gap_spacings=spacings)
    found = is_missing(points, normals, others, settings)
    assert torch.equal(found, _is_missing_asking_all(points, normals, others, settings))
    assert 0 < int(found.sum()) < len(found)
