"""What P shows from all around is its surface, however far its splats' centres are."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from gscomplete.shape.surface.solid import is_known_all_round, solid_views
from gscomplete.splats import Splats, colors_to_sh
from gscomplete.splats.rotations import quaternions_facing
from tests.builders.objects import ball, half


def wide_ball(count: int = 1200, scale: float = 0.03) -> Splats:
    """A ball of radius 0.4, of few splats so wide that it is closed."""
    number = torch.arange(count, dtype=torch.float64)
    height = 1.0 - 2.0 * (number + 0.5) / count
    turn = number * math.pi * (3.0 - math.sqrt(5.0))
    wide = (1.0 - height.square()).sqrt()
    normals = torch.stack([wide * turn.cos(), wide * turn.sin(), height], dim=1).float()
    scales = torch.full((count, 3), scale)
    scales[:, 2] *= 0.1
    colors = colors_to_sh(torch.full((count, 3), 0.5))
    opacities = torch.full((count,), 0.98)
    return Splats(0.4 * normals, quaternions_facing(normals), scales, opacities, colors)


def directions(count: int = 500) -> torch.Tensor:  # [N, 3]
    generator = torch.Generator().manual_seed(1)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)


@pytest.mark.parametrize(
    ("radius", "least", "most"), [(0.4, 0.95, 1.0), (0.3, 0.0, 0.0), (0.5, 0.0, 0.05)]
)
def test_points_on_a_closed_surface_are_covered(radius: float, least: float, most: float) -> None:
    """Inside the ball points are hidden; outside, only views along the surface find them on it."""
    splats = wide_ball()
    away = torch.cdist(directions() * 0.4, splats.means).amin(dim=1)
    assert float(away.amax()) > 0.02  # centres alone do not tell
    covered = solid_views(splats).cover(directions() * radius)
    assert least <= float(covered.double().mean()) <= most


def test_beyond_the_rim_nothing_is_covered() -> None:
    splats = half(wide_ball())
    points = directions() * 0.4
    toward = splats.means.mean(dim=0)
    beyond = points @ toward / toward.norm()
    covered = solid_views(splats).cover(points)
    assert float(covered[beyond > 0.12].double().mean()) > 0.95
    assert not covered[beyond < -0.12].any()


def test_faint_splats_are_no_surface() -> None:
    splats = wide_ball()
    faint = dataclasses.replace(splats, opacities=0.1 * splats.opacities)
    assert not solid_views(faint).cover(directions() * 0.4).any()


def test_what_is_behind_a_scan_is_not_known() -> None:
    splats = ball()
    assert not is_known_all_round(splats, 0.9, ends_in_plane=False)
    assert is_known_all_round(splats, 0.7, ends_in_plane=False)
    assert is_known_all_round(splats, 0.9, ends_in_plane=True)
    scales = splats.scales.clone()
    scales[::10] *= 3
    assert is_known_all_round(dataclasses.replace(splats, scales=scales), 0.9, ends_in_plane=False)


def test_votes_are_those_of_single_views_in_float64() -> None:
    """Points whose pixel or depth is within rounding of a limit may differ."""
    views = solid_views(half(wide_ball()))
    generator = torch.Generator().manual_seed(2)
    points = torch.rand(3000, 3, generator=generator) - 0.5
    expected = []
    for point in points.double().numpy():
        seen = on_surface = 0
        for view in range(len(views.depth)):
            matrix = views.camera_from_world[view].double().numpy()
            x, y, z = matrix[:3, :3] @ point + matrix[:3, 3]
            size = views.depth.shape[1]
            column = int(np.clip(x / z * views.focal_px + size / 2, 0, size - 1))
            row = int(np.clip(y / z * views.focal_px + size / 2, 0, size - 1))
            behind = z - float(views.depth[view, row, column])
            seen += behind < 0.03
            on_surface += abs(behind) < 0.03 and bool(views.is_solid[view, row, column])
        expected.append(on_surface > 0 and on_surface >= 0.3 * seen)
    found = views.cover(points)
    assert 100 < sum(expected) < 2900
    assert (found.numpy() != np.array(expected)).mean() < 0.002


def test_points_at_cameras_and_behind_them_are_not_covered() -> None:
    views = solid_views(wide_ball())
    world_from_camera = torch.linalg.inv(views.camera_from_world)
    eyes = world_from_camera[:, :3, 3]
    assert not views.cover(torch.cat([eyes, 1.5 * eyes, 100 * eyes])).any()
