"""Cameras at the bounds of V, and what is drawn into them."""

import dataclasses

import torch

from gscomplete.viewer.view_errors import bounds_of, view_errors
from gscomplete.views import ViewDistribution
from tests.builders.objects import round_splats


def test_cameras_at_the_bounds_of_v():
    views = ViewDistribution(30.0, 80.0, 40.0, 15.0)
    cameras = bounds_of(views, 32)
    assert len(cameras) == 8
    x, y, z = cameras.positions.double().T
    azimuths = torch.rad2deg(torch.atan2(y, x))
    assert sorted({round(float(a)) for a in azimuths}) == [-10, 30, 70]
    elevations = torch.rad2deg(torch.asin(z / views.radius))
    assert sorted({round(float(e)) for e in elevations}) == [65, 80, 89]


def test_errors_are_red_where_what_was_added_hides_p():
    views = ViewDistribution(0.0, 0.0)
    grid = torch.stack(torch.meshgrid(*[torch.linspace(-0.3, 0.3, 25)] * 2, indexing="ij"), -1)
    sheet = torch.cat([torch.zeros(625, 1), grid.reshape(-1, 2)], 1)  # squarely before c
    partial = round_splats(sheet, scale=0.03, color=torch.full((625, 3), 0.2))
    hiding = round_splats(torch.tensor([[0.3, 0.1, 0.0]]), scale=0.05, color=torch.ones(1, 3))
    behind = dataclasses.replace(hiding, means=-hiding.means)
    camera = views.input_camera(64)
    red, white = (view_errors(partial, added, camera) for added in (hiding, behind))
    is_red = (red.pictures[0][:, :, 0].astype(int) - red.pictures[0][:, :, 1]) > 60
    assert 10 < is_red.sum() < 400
    assert (white.pictures[0][:, :, 0].astype(int) - white.pictures[0][:, :, 1]).max() < 30
    # the hiding splat, at 1.9 of the 2.2 from c, hides what is 0.1 * 2.2 / 1.9 beside the middle
    away = (sheet - torch.tensor([0.0, 0.1 * 2.2 / 1.9, 0.0])).norm(dim=1)
    assert red.on_splats[away < 0.04].min() > 0.5
    assert red.on_splats[away > 0.2].max() < 0.05
    assert white.on_splats.max() < 0.1


def test_splats_that_no_camera_sees_have_no_error():
    """A second sheet behind the first; all of the front one changes."""
    grid = torch.stack(torch.meshgrid(*[torch.linspace(-0.3, 0.3, 25)] * 2, indexing="ij"), -1)
    front = torch.cat([torch.full((625, 1), 0.1), grid.reshape(-1, 2)], 1)
    both = torch.cat([front, front - torch.tensor([0.2, 0.0, 0.0])])
    partial = round_splats(both, scale=0.03, color=torch.full((1250, 3), 0.2))
    over = round_splats(front + torch.tensor([0.1, 0.0, 0.0]), scale=0.03, color=torch.ones(625, 3))
    found = view_errors(partial, over, ViewDistribution(0.0, 0.0).input_camera(64)).on_splats
    inner = (both[:, 1:].abs() < 0.2).all(dim=1)
    assert found[:625][inner[:625]].min() > 0.5
    assert found[625:].max() == 0.0
