import math

import torch
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.priors.mvdream.cameras import camera_matrices
from gscomplete.priors.mvdream.prior import MVDREAM_VIEWS
from gscomplete.views import Cameras, four_view_orbit

ANGLES = st.floats(-720, 720)
ELEVATIONS = st.floats(-90, 90)


def orbit(azimuth_deg: float, elevation_deg: float, radius: float = 2.0) -> Cameras:
    return four_view_orbit(azimuth_deg, elevation_deg, radius=radius, fov_deg=40, size_px=32)


def test_the_specification_s_matrix():
    """MVDream's e = 15, a = 90: our azimuth 0, the front."""
    expected = [
        [0, -0.2588, 0.9659, 0.9659],
        [1, 0, 0, 0],
        [0, 0.9659, 0.2588, 0.2588],
        [0, 0, 0, 1],
    ]
    found = camera_matrices(orbit(0, 15))[0].reshape(4, 4)
    torch.testing.assert_close(found, torch.tensor(expected), atol=5e-5, rtol=0)


def mvdream_camera(elevation_deg: float, a_deg: float) -> torch.Tensor:
    """The original's construction in its own words: OpenGL world, y up, then rows to Blender's."""
    e, a = math.radians(elevation_deg), math.radians(a_deg)
    position = torch.tensor(
        [math.cos(e) * math.sin(a), math.sin(e), math.cos(e) * math.cos(a)], dtype=torch.float64
    )
    back = position / position.norm()
    right = torch.tensor([math.cos(a), 0.0, -math.sin(a)], dtype=torch.float64)
    up = torch.linalg.cross(back, right)
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3] = torch.stack([right, up, back, position], dim=1)
    return matrix[[0, 2, 1, 3]] * torch.tensor([1, -1, 1, 1])[:, None]


@given(ANGLES, ELEVATIONS, st.floats(0.1, 100))
def test_equal_to_the_original_s_construction(azimuth_deg, elevation_deg, radius):
    found = camera_matrices(orbit(azimuth_deg, elevation_deg, radius)).reshape(4, 4, 4)
    for view in range(4):
        expected = mvdream_camera(elevation_deg, azimuth_deg + 90 * view + 90).float()
        torch.testing.assert_close(found[view], expected, atol=2e-5, rtol=0)


@given(ANGLES, ELEVATIONS, ANGLES)
def test_turning_the_front_is_turning_the_cameras(azimuth_deg, elevation_deg, front_deg):
    turned = camera_matrices(orbit(azimuth_deg, elevation_deg), front_deg)
    expected = camera_matrices(orbit(azimuth_deg - front_deg, elevation_deg))
    torch.testing.assert_close(turned, expected, atol=2e-5, rtol=0)


@given(ANGLES, ELEVATIONS)
def test_rigid_with_unit_translation_along_the_view(azimuth_deg, elevation_deg):
    cameras = orbit(azimuth_deg, elevation_deg)
    before = cameras.camera_from_world.clone()
    matrix = camera_matrices(cameras).reshape(4, 4, 4)
    assert torch.equal(cameras.camera_from_world, before)  # the reference edits its argument
    rotation, translation = matrix[:, :3, :3], matrix[:, :3, 3]
    assert torch.allclose(rotation @ rotation.transpose(1, 2), torch.eye(3), atol=1e-5)
    assert torch.allclose(torch.linalg.det(rotation), torch.ones(4), atol=1e-5)
    assert torch.allclose(translation.norm(dim=1), torch.ones(4), atol=1e-5)
    assert torch.allclose(rotation[:, :, 2], translation, atol=1e-5)  # looks along -z at the origin


def test_rings_are_framed_as_the_model_was_trained():
    """Elevations 0 to 30 degrees, as its data set was drawn from."""
    assert MVDREAM_VIEWS.elevation_range_deg == (0.0, 30.0)
    assert MVDREAM_VIEWS.fov_deg == 40.0
    assert MVDREAM_VIEWS.resolution_px == 256
