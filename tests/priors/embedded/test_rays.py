import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.priors.embedded.rays import ring_numbers, ring_rays
from gscomplete.views.cameras import four_view_orbit, orbit_cameras


@given(
    azimuth=st.floats(-720, 720),
    elevation=st.floats(-80, 80),
    radius=st.floats(0.5, 20),
    fov=st.floats(5, 100),
    target=st.tuples(*[st.floats(-3, 3)] * 3),
)
@settings(max_examples=50, deadline=None)
def test_numbers_are_read_back_from_cameras(azimuth, elevation, radius, fov, target):
    cameras = orbit_cameras(
        azimuth + 90.0 * torch.arange(4, dtype=torch.float64),
        torch.full((4,), elevation, dtype=torch.float64),
        radius=radius,
        fov_deg=fov,
        size_px=48,
        target=torch.tensor(target, dtype=torch.float64),
    )
    found = ring_numbers(cameras)
    # Numbers are float32, and at 80 degrees a sine's error counts six times. Measured: 5e-6.
    assert float(found[0]) == pytest.approx(elevation, abs=1e-3)
    assert float(found[1]) == pytest.approx(radius, rel=1e-3, abs=1e-4)
    assert float(found[2]) == pytest.approx(fov, rel=1e-4)


def test_rays_agree_with_the_cameras_of_a_ring_at_azimuth_zero():
    size = 8
    cameras = four_view_orbit(0.0, 25.0, radius=2.3, fov_deg=40.0, size_px=size).to(
        dtype=torch.float64
    )
    rays = ring_rays(torch.tensor([[25.0, 2.3, 40.0]], dtype=torch.float64), size)[0]
    for view in range(4):
        for row, column in ((0, 0), (3, 5), (7, 2)):
            x = (column + 0.5 - size / 2) / cameras.focal_px[view, 0]
            y = (row + 0.5 - size / 2) / cameras.focal_px[view, 1]
            inside = torch.stack([x, y, torch.ones_like(x)])
            rotation = cameras.camera_from_world[view, :3, :3]
            direction = rotation.T @ (inside / inside.norm())
            moment = torch.linalg.cross(cameras.positions[view], direction)
            expected = torch.cat([direction, moment])
            torch.testing.assert_close(rays[view, :, row, column], expected, rtol=1e-5, atol=1e-5)


def test_rays_of_the_ring_are_turned_by_quarter_turns():
    rays = ring_rays(torch.tensor([[10.0, 2.0, 40.0]], dtype=torch.float64), 4)[0]
    turn = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=torch.float64)
    both = torch.block_diag(turn, turn)
    for view in range(4):
        turned = torch.einsum("ij,jhw->ihw", both, rays[view])
        torch.testing.assert_close(rays[(view + 1) % 4], turned)


def test_directions_are_unit_and_moments_orthogonal():
    rays = ring_rays(torch.tensor([[-10.0, 1.9, 40.0], [80.0, 3.0, 60.0]]), 5)
    direction, moment = rays.split(3, dim=2)
    torch.testing.assert_close(direction.norm(dim=2), torch.ones(2, 4, 5, 5))
    torch.testing.assert_close((direction * moment).sum(2), torch.zeros(2, 4, 5, 5))
