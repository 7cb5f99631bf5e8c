import dataclasses

import pytest
import torch

from gscomplete.shape.colors import sources
from gscomplete.shape.colors.sources import nearest_colors, source_colors
from gscomplete.shape.network import ShapeOutput
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.symmetry import SOURCES, mirror, with_composition
from gscomplete.shape.voxels import CELLS, COARSE_CELLS
from gscomplete.splats import colors_to_sh, concatenate
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half, round_splats
from tests.builders.shape_network import mirrors

VIEWS = ViewDistribution(0.0, 10.0)
OWN = SOURCES


def pointing_at(*sources: int) -> ShapeOutput:
    """Return what a network that trusts some sources equally would say; its own colour is green."""
    n = COARSE_CELLS
    logits = torch.full((1, SOURCES + 1, n, n, n), -9.0)
    logits[:, list(sources)] = 9.0
    own = torch.zeros(1, 3, n, n, n)
    own[:, 1] = 1.0
    return ShapeOutput(torch.zeros(1, CELLS, CELLS, CELLS), own, logits)


def colors_at(points, output, partial=None):
    partial = half(ball()) if partial is None else partial
    inputs = voxelize_partial(partial, VIEWS).with_copies(mirrors())
    generator = torch.Generator().manual_seed(0)
    return source_colors(output, inputs, partial, points, generator)[0], inputs


def hidden_points(count=200):
    """Return points of the sphere where the half of it lacks splats."""
    points = ball().means
    return points[points[:, 0] < -0.2][:count]


def test_colours_come_from_the_source_that_is_trusted():
    points = hidden_points()
    taken, _ = colors_at(points, pointing_at(1))
    # P's colours run with its normals; those of its mirror image run the other way.
    expected = 0.5 - 0.4 * points[:, 0] / 0.4
    assert float((taken[:, 0] - expected).abs().mean()) < 0.05


def test_colours_are_sure_where_they_come_from_a_symmetry_of_which_both_sides_show():
    """Of half a ball, the plane through its middle mirrors what shows on itself."""
    partial = half(ball())
    stripes = (torch.floor(partial.means[:, 2:] / 0.1) % 2).expand(-1, 3)
    partial = dataclasses.replace(partial, sh=colors_to_sh(stripes))
    across = (mirror(0.0, 0.0, 0.5), mirror(0.5 * torch.pi, 0.0, 0.5))
    inputs = voxelize_partial(partial, VIEWS).with_copies(with_composition(*across))
    generator = torch.Generator().manual_seed(0)

    def sure_of(source: int, points: torch.Tensor) -> list[float]:
        sure = source_colors(pointing_at(source), inputs, partial, points, generator)[1]
        return [float(sure.min()), float(sure.max())]

    assert sure_of(2, partial.means[:200]) == pytest.approx([1.0, 1.0])
    assert sure_of(0, partial.means[:200]) == sure_of(1, hidden_points()) == [0.0, 0.0]


def test_the_colour_of_the_network_is_never_mixed_in():
    partial = half(ball())
    red = torch.tensor([0.9, 0.1, 0.2]).expand(len(partial), 3)
    partial = dataclasses.replace(partial, sh=colors_to_sh(red))
    taken, _ = colors_at(hidden_points(), pointing_at(OWN), partial)
    torch.testing.assert_close(taken, red[: len(taken)], atol=1e-4, rtol=0)


def test_of_two_sources_trusted_alike_only_the_likelier_is_taken(monkeypatch):
    points = hidden_points()
    both, _ = colors_at(points, pointing_at(1, 3))
    first, _ = colors_at(points, pointing_at(1))
    near = (both - first).abs().amax(dim=1) < 0.02
    assert float(near.float().mean()) > 0.9
    monkeypatch.setattr(sources, "_PREFERENCE", 0.0)
    mixed, _ = colors_at(points, pointing_at(1, 3))
    assert float((mixed - first).abs().mean()) > float((both - first).abs().mean())


def test_sources_without_a_share_change_no_bit(monkeypatch):
    """What is not looked up is what float32 would round away."""
    points = ball().means[::3]
    rng = torch.Generator().manual_seed(3)
    output = pointing_at(1)
    logits = 2.5 * torch.randn(output.sources.shape, generator=rng)
    output = dataclasses.replace(output, sources=logits)
    some, _ = colors_at(points, output)
    monkeypatch.setattr(sources, "_NO_SHARE", torch.inf)
    every, _ = colors_at(points, output)
    assert torch.equal(some, every)


def test_far_from_every_source_the_nearest_is_taken():
    taken, inputs = colors_at(torch.tensor([[-0.7, 0.0, 0.0]]), pointing_at(0))
    partial = half(ball())
    images = [torch.from_numpy(s.apply(partial.means.numpy())) for s in inputs.symmetries]
    places = torch.stack([partial.means, *images])
    nearest = (places + torch.tensor([0.7, 0.0, 0.0])).norm(dim=2).amin(dim=0).argmin()
    # Several near splats are mixed, whose colours differ a little. Measured: 0.006.
    torch.testing.assert_close(taken[0], partial.base_colors[nearest], atol=0.02, rtol=0)


@pytest.mark.parametrize("count", [1, 3])
def test_a_few_splats_are_enough(count):
    places = 0.1 * torch.rand(count, 3, generator=torch.Generator().manual_seed(1))
    partial = round_splats(places, scale=0.02, color=(0.7, 0.7, 0.7))
    taken, _ = colors_at(hidden_points(5), pointing_at(0), partial)
    torch.testing.assert_close(taken, torch.full((5, 3), 0.7), atol=1e-4, rtol=0)


def test_of_two_layers_the_outer_one_gives_its_colour_to_what_lies_between_them(monkeypatch):
    inner = ball()
    normals = torch.nn.functional.normalize(inner.means, dim=1)
    outer = dataclasses.replace(
        inner, means=inner.means * 1.1, sh=colors_to_sh(torch.zeros_like(inner.means))
    )
    white = dataclasses.replace(inner, sh=colors_to_sh(torch.ones_like(inner.means)))
    shown, points = concatenate([white, outer]), inner.means * 1.02
    generator = torch.Generator().manual_seed(0)
    assert float(nearest_colors(shown, points, normals, generator).mean()) < 0.1
    monkeypatch.setattr(sources, "_OUTWARD", 0.0)
    assert float(nearest_colors(shown, points, normals, generator).mean()) > 0.6


def test_a_gap_takes_the_colours_of_its_two_sides():
    complete = ball()
    sides = complete.select(complete.means[:, 0].abs() > 0.03)
    left = (sides.means[:, :1] < 0).float().expand(-1, 3)
    sides = dataclasses.replace(sides, sh=colors_to_sh(left))
    gap = complete.means[complete.means[:, 0].abs() < 0.02]
    normals = torch.nn.functional.normalize(gap, dim=1)
    taken = nearest_colors(sides, gap, normals, torch.Generator().manual_seed(0))
    is_left = gap[:, 0] < -0.01
    assert float(taken[is_left].mean()) > 0.7
    assert float(taken[gap[:, 0] > 0.01].mean()) < 0.3


def test_bands_go_on_round_what_stands_upright(monkeypatch):
    complete = ball()
    heights = complete.means[:, 2]
    red = (torch.floor(heights / 0.1) % 2 == 0).float()
    banded = dataclasses.replace(complete, sh=colors_to_sh(red[:, None].expand(-1, 3)))
    front = banded.select(complete.means[:, 0] > 0)
    behind = (complete.means[:, 0] < -0.1) & (heights.abs() < 0.25)
    points = complete.means[behind]
    normals = torch.nn.functional.normalize(points, dim=1)

    def share_kept() -> float:
        taken = nearest_colors(front, points, normals, torch.Generator().manual_seed(0))
        return float(((taken[:, 0] > 0.5) == (red[behind] > 0.5)).float().mean())

    kept = share_kept()
    monkeypatch.setattr(sources, "_HEIGHT_WEIGHT", 1.0)
    assert kept > share_kept() + 0.1
