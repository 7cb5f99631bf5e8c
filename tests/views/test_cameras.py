"""Batches of cameras: one by one, and no others."""

import itertools

import pytest
import torch

from gscomplete.render import prepare_frozen
from gscomplete.views import four_view_orbit, join_cameras
from tests.builders.objects import BALL

RING = four_view_orbit(20.0, 15.0, radius=2.5, fov_deg=45.0, size_px=8)


def test_cameras_come_one_by_one():
    found = list(itertools.islice(RING, 9))
    assert [len(camera) for camera in found] == [1, 1, 1, 1]
    assert torch.equal(join_cameras(found).camera_from_world, RING.camera_from_world)
    for index in range(-4, 4):
        assert torch.equal(RING[index].camera_from_world[0], RING.camera_from_world[index])


@pytest.mark.parametrize("index", [4, -5])
def test_there_is_no_camera_and_no_view_beyond_the_last(index):
    with pytest.raises(IndexError):
        RING[index]
    with pytest.raises(IndexError):
        prepare_frozen(BALL, RING)[index]
