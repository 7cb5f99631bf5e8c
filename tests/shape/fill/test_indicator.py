"""The smooth solid through points: spread, solved and sampled as slow ways do."""

import numpy as np
import pytest
import torch

from gscomplete.shape.fill.indicator import (
    CELL_SIDE,
    GRID,
    HALF_SIDE,
    Solid,
    _spread,
    solid_through,
)
from tests.builders.objects import even_ball

RADIUS = 0.4
ALONG = (np.arange(GRID) + 0.5) * CELL_SIDE - HALF_SIDE


def slow_spread(points, values):
    """Add every value to the eight cells about its point, one by one, in float64."""
    grid = np.zeros((GRID,) * 3)
    for point, value in zip(points.astype(np.float64), values, strict=True):
        place = (point + HALF_SIDE) / CELL_SIDE - 0.5
        low = np.floor(place).astype(int)
        for step in np.ndindex(2, 2, 2):
            cell = low + step
            near = 1 - np.abs(place - cell)
            grid[tuple(np.clip(cell, 0, GRID - 1))] += near.prod() * value
    return grid


def slow_sample(field, point):
    """Interpolate between the eight cells about a point, in float64; the border goes on outside."""
    place = np.clip((point + HALF_SIDE) / CELL_SIDE - 0.5, 0, GRID - 1)
    low = np.minimum(np.floor(place).astype(int), GRID - 2)
    total = np.zeros(len(field))
    for step in np.ndindex(2, 2, 2):
        cell = low + step
        total += (1 - np.abs(place - cell)).prod() * field[(slice(None), *cell)]
    return total


def plane_solid(normal: tuple[float, float, float], level: float, slope: float = 1.0) -> Solid:
    """Return the half space below a plane: its value falls by ``slope`` along the normal."""
    x, y, z = np.meshgrid(ALONG, ALONG, ALONG, indexing="ij")
    value = slope * (level - (normal[0] * x + normal[1] * y + normal[2] * z))
    slopes = [np.full_like(value, -slope * part) for part in normal]
    return Solid(torch.from_numpy(np.stack([value, *slopes])).float())


@pytest.fixture(scope="module")
def sphere() -> tuple[Solid, torch.Tensor]:
    points = even_ball(4000, RADIUS).means
    areas = torch.full((4000,), 4 * np.pi * RADIUS**2 / 4000)
    return solid_through(points, points / RADIUS, areas), points


def around(count: int, radius: float) -> torch.Tensor:
    """Return points on a sphere about the origin that are none of the solid's."""
    ways = torch.randn(count, 3, generator=torch.Generator().manual_seed(3))
    return radius * ways / ways.norm(dim=1, keepdim=True)


@pytest.mark.parametrize(("count", "reach"), [(0, 1.0), (1, 0.5), (40, 0.6), (40, 1.0)])
def test_values_are_spread_as_one_by_one_and_none_is_lost(count, reach):
    """Half a cell about a border, and beyond the grid, all goes to the outermost cells."""
    rng = np.random.default_rng(count)
    points = rng.uniform(-reach, reach, (count, 3)).astype(np.float32)
    points[::7] = ALONG[rng.integers(GRID, size=(len(points[::7]), 3))]  # centres of cells
    values = rng.normal(size=count)
    apart = np.abs(_spread(points, values) - slow_spread(points, values)).max()
    lost = _spread(points, values).sum() - values.sum()
    assert (apart < 1e-13, abs(lost) < 1e-12) == (True, True)  # rounding of 320 products


def test_the_field_solves_the_equation_of_a_sum_over_waves():
    """A grid of waves, each solved alone: the value at places is summed in float64."""
    points = torch.tensor([[0.1, -0.2, 0.05], [0.12, 0.1, -0.3]])
    normals = torch.tensor([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]])
    areas = torch.tensor([0.02, 0.05])
    solid = solid_through(points, normals, areas)
    vectors = -(normals * areas[:, None]).double().numpy()
    spectra = [np.fft.fftn(slow_spread(points.numpy(), column)) for column in vectors.T]
    waves = 2 * np.pi * np.fft.fftfreq(GRID, CELL_SIDE)
    wave = np.stack(np.meshgrid(waves, waves, waves, indexing="ij"))
    squared = (wave**2).sum(axis=0)
    squared[0, 0, 0] = 1
    blurred = np.exp(-0.5 * squared * (1.5 * CELL_SIDE) ** 2)
    # in the frequency domain a gradient is i k times the value, so the value is -i k . v / k^2
    spectrum = -1j * sum(w * s for w, s in zip(wave, spectra, strict=True)) / squared * blurred
    values = np.fft.ifftn(spectrum).real
    expected = np.array([slow_sample(values[None], p)[0] for p in points.double().numpy()])
    weight = areas.double().numpy()
    level = (expected * weight).sum() / weight.sum()
    largest = np.abs(values).max()
    found = solid.field[0].double().numpy()
    assert np.abs(found - (values - level)).max() < 1e-5 * largest  # float32 keeps 6e-8


def test_slopes_are_differences_of_the_values(sphere):
    value, *slopes = sphere[0].field.double().numpy()
    largest = max(np.abs(slope).max() for slope in slopes)
    for axis, slope in enumerate(slopes):
        middle = (np.roll(value, -1, axis) - np.roll(value, 1, axis)) / (2 * CELL_SIDE)
        inner = tuple(slice(1, -1) for _ in range(3))
        assert np.abs(slope - middle)[inner].max() < 1e-4 * largest  # float32 differences


def test_samples_are_those_between_eight_cells(sphere):
    solid, _ = sphere
    points = torch.rand(60, 3, generator=torch.Generator().manual_seed(1)) * 1.8 - 0.9
    expected = [slow_sample(solid.field.double().numpy(), p) for p in points.double().numpy()]
    largest = float(solid.field.abs().max())
    assert solid.sample(points).numpy() == pytest.approx(np.array(expected), abs=1e-4 * largest)


def test_a_sphere_is_positive_inside_and_its_surface_lies_at_the_points(sphere):
    solid, points = sphere
    inside, outside = solid.sample(around(200, 0.3))[:, 0], solid.sample(around(200, 0.5))[:, 0]
    assert bool((inside > 0).all())
    assert bool((outside < 0).all())
    # the blur of 1.5 cells moves a curved surface by (1.5 cells)^2 / radius at most, 0.0007
    assert float(solid.height(points).abs().max()) < 0.1 * CELL_SIDE


def test_heights_are_signed_distances_of_at_most_two_cells(sphere):
    solid, _ = sphere
    for away in (-CELL_SIDE, 0.5 * CELL_SIDE, CELL_SIDE):
        found = solid.height(around(100, RADIUS + away))
        # the slope changes over the blur's 1.5 cells
        assert float((found - away).abs().max()) < 0.35 * CELL_SIDE
    far = torch.cat([around(50, 0.05), around(50, 0.7)])
    assert float(solid.height(far).abs().max()) <= 2 * CELL_SIDE + 1e-7
    flat = plane_solid((0.6, 0.0, 0.8), 0.1, slope=3.0)
    spots = around(100, 0.2)
    exact = (spots @ torch.tensor([0.6, 0.0, 0.8]) - 0.1).clamp(-2 * CELL_SIDE, 2 * CELL_SIDE)
    assert torch.allclose(flat.height(spots), exact, atol=1e-5)


def test_points_are_moved_straight_to_a_plane_unless_it_is_far():
    normal = torch.tensor([0.6, 0.0, 0.8])
    flat = plane_solid((0.6, 0.0, 0.8), 0.1, slope=3.0)
    home = (
        torch.tensor([[0.1, 0.2, 0.05]]) + torch.linspace(-4, 4, 41)[:, None] * CELL_SIDE * normal
    )
    away = home @ normal - 0.1
    points, normals, arrived = flat.project(home)
    assert torch.allclose(normals, normal.expand(41, 3), atol=1e-5)
    assert torch.equal(arrived, away.abs() < 2.5 * CELL_SIDE)
    assert float((points[arrived] @ normal - 0.1).abs().max()) < 1e-5
    # a step longer than a cell along an axis is cut short along that axis
    straight = away.abs() < 1.2 * CELL_SIDE
    assert torch.allclose(points[straight], (home - away[:, None] * normal)[straight], atol=1e-5)


def test_points_that_stay_off_the_surface_do_not_arrive():
    """A value that stays at 0.3 cells however far one goes down its slope has no surface."""
    field = torch.zeros(4, GRID, GRID, GRID)
    field[0], field[1] = 0.3 * CELL_SIDE, 1.0
    solid = Solid(field)
    assert not solid.project(around(30, 0.3))[2].any()
    assert len(solid.crossed_cells()) == 0


def test_points_near_a_sphere_arrive_on_it_with_outward_normals(sphere):
    solid, _ = sphere
    home = torch.cat([around(200, RADIUS - CELL_SIDE), around(200, RADIUS + CELL_SIDE)])
    points, normals, arrived = solid.project(home)
    assert bool(arrived.all())
    assert float((points.norm(dim=1) - RADIUS).abs().max()) < 0.15 * CELL_SIDE
    assert float((normals * points).sum(dim=1).min()) > 0.99 * RADIUS
    assert not solid.project(around(100, 0.1))[2].any()


def test_crossed_cells_are_the_cells_about_the_plane():
    normal, level = np.array([0.6, 0.0, 0.8]), 0.1
    cells = plane_solid((0.6, 0.0, 0.8), level).crossed_cells().double().numpy()
    grid = np.stack(np.meshgrid(ALONG, ALONG, ALONG, indexing="ij"), -1).reshape(-1, 3)
    inner = np.abs(grid).max(axis=1) < HALF_SIDE - 3 * CELL_SIDE
    away = np.abs(grid @ normal - level)
    surely = {tuple(r) for r in np.round(grid[inner & (away < 0.599 * CELL_SIDE)], 4).tolist()}
    perhaps = {tuple(r) for r in np.round(grid[away < 0.601 * CELL_SIDE], 4).tolist()}
    found = {tuple(r) for r in np.round(cells, 4).tolist()}
    assert surely <= found <= perhaps
    assert len(found) == len(cells)


def test_crossed_cells_cover_the_sphere_and_nothing_else(sphere):
    cells = sphere[0].crossed_cells()
    assert float((cells.norm(dim=1) - RADIUS).abs().max()) < 0.75 * CELL_SIDE
    ways = cells / cells.norm(dim=1, keepdim=True)
    asked = around(300, 1.0)
    # a cell's diagonal, as an angle
    assert float((asked @ ways.T).amax(dim=1).arccos().max()) < 3**0.5 * CELL_SIDE / RADIUS


def test_size_of_areas_changes_no_place_and_unsure_normals_count_less(sphere):
    solid, points = sphere
    areas = torch.full((len(points),), 7.0)
    scaled = solid_through(points, points / RADIUS, areas)
    spots = around(100, RADIUS + 0.5 * CELL_SIDE)
    assert torch.allclose(scaled.height(spots), solid.height(spots), atol=1e-4 * RADIUS)
    unsure = torch.cat([points, around(500, 0.2)])
    normals = torch.cat([points / RADIUS, torch.zeros(500, 3)])
    same = solid_through(unsure, normals, torch.full((len(unsure),), 7.0))
    assert torch.equal(same.field, scaled.field)


def test_points_without_normals_have_no_surface():
    points = around(20, 0.3)
    solid = solid_through(points, torch.zeros(20, 3), torch.ones(20))
    assert not solid.field.any()
    assert len(solid.crossed_cells()) == 0


def test_no_points_have_no_surface():
    nothing = torch.zeros(0, 3)
    solid = solid_through(nothing, nothing, torch.zeros(0))
    assert not solid.field.any()
    assert len(solid.crossed_cells()) == 0
