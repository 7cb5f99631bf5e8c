"""Half a pipe with stripes outside, plain inside: the far side's colours."""

import dataclasses

import numpy as np
import pytest
import torch

from gscomplete.shape.colors.bands import with_bands
from gscomplete.splats import colors_to_sh
from gscomplete.splats.geometry.axis_coordinates import Axis, Turning
from tests.builders.objects import pipe

AXIS = Axis.through(np.zeros(3), np.array([0.0, 0.0, 1.0]))
GREY = 0.5


def outward(points):
    """Return the normals of both walls, away from the wall's middle."""
    radial = points * torch.tensor([1.0, 1.0, 0.0])
    radius = radial.norm(dim=1, keepdim=True)
    return torch.where(radius > 0.485, 1.0, -1.0) * radial / radius


def stripes(points):
    """Return blue inside; outside white above and red below."""
    outer = points[:, :2].norm(dim=1) > 0.485
    above = points[:, 2] > 0
    colors = torch.tensor([0.1, 0.2, 0.7]).repeat(len(points), 1)
    colors[outer & above] = 0.9
    colors[outer & ~above] = torch.tensor([0.8, 0.1, 0.1])
    return colors


def completed(colors_of):
    """Give the far side grey and then P's bands; return its colours and places."""
    whole = pipe()
    whole = dataclasses.replace(whole, sh=colors_to_sh(colors_of(whole.means)))
    seen = whole.means[:, 0] > 0
    partial, points = whole.select(seen), whole.means[~seen]
    places = partial.means.double().numpy()
    body = Turning.about(AXIS, places, outward(partial.means).double().numpy())
    grey = torch.full((len(points), 3), GREY)
    return with_bands(grey, points, outward(points), partial, body, AXIS), points


def test_the_far_side_has_the_colours_that_go_all_round():
    found, points = completed(stripes)
    far = (points[:, 0] < -0.2) & (points[:, 2].abs() > 0.05)  # .15 from P; stripes meet at 0
    # colours pass sRGB, Oklab and float32; means of equal colours
    torch.testing.assert_close(found[far], stripes(points)[far], atol=1e-4, rtol=0)


def test_beside_the_part_other_colours_stay():
    found, points = completed(stripes)
    seen = pipe().means
    away = torch.cdist(points, seen[seen[:, 0] > 0]).amin(dim=1)
    changed = (found - GREY).abs().amax(dim=1)
    assert float(away.min()) < 0.01
    most = 0.4  # P's colours differ from grey by this
    assert bool((changed <= most * (away / 0.15).clamp(max=1.0) + 1e-4).all())


def test_colours_that_vary_round_the_part_stay_out():
    def random_colors(points):
        return torch.rand(len(points), 3, generator=torch.Generator().manual_seed(1)).round()

    found, _ = completed(random_colors)
    assert float((found - GREY).abs().max()) < 1e-3


@pytest.mark.parametrize("count", [0, 1])
def test_few_splats_are_no_error(count):
    whole = pipe()
    places = whole.means.double().numpy()
    body = Turning.about(AXIS, places, outward(whole.means).double().numpy())
    points = whole.means[:count]
    colors = torch.full((count, 3), GREY)
    found = with_bands(colors, points, outward(points), whole, body, AXIS)
    assert torch.equal(found, colors)  # where P is, given colours stay
