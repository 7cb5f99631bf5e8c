"""Near pairs of a ring: neighbours on it, never the photo across, each pair once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from gscomplete.views import orbit_cameras
from splatcomplete_data.multiview.photos.lens import Lens
from splatcomplete_data.multiview.photos.posed import PosedPhoto, PosedPhotos
from splatcomplete_data.multiview.sfm.pairs import WIDEST_TURN_DEG, can_be_listed, near_pairs

TURNED_ROUND = np.diag([-1.0, 1.0, -1.0, 1.0])


def capture(poses) -> PosedPhotos:
    lens = Lens(8, 8, (8.0, 8.0), (4.0, 4.0))
    photos = [PosedPhoto(Path(f"/x/{k:02}"), lens, pose) for k, pose in enumerate(poses)]
    return PosedPhotos(tuple(photos), None, "test")


def ring(count: int, *, outwards: bool = False) -> PosedPhotos:
    """Return photos on a circle round the origin, taken towards it or away from it."""
    azimuths = torch.arange(count) * 360 / count
    cameras = orbit_cameras(azimuths, torch.zeros(count), radius=1, fov_deg=40, size_px=8)
    poses = cameras.camera_from_world.double().numpy()
    return capture(TURNED_ROUND @ poses if outwards else poses)


@pytest.mark.parametrize("outwards", [False, True])
def test_a_ring_is_paired_along_itself(outwards):
    pairs = near_pairs(ring(24, outwards=outwards), 4)
    steps = {min((int(b) - int(a)) % 24, (int(a) - int(b)) % 24) for a, b in pairs}
    assert steps == {1, 2}
    assert len(pairs) == len(set(pairs)) == 48


def test_photos_taken_in_other_directions_are_not_compared():
    pairs = near_pairs(ring(8), 7)  # 45 degrees apart
    assert WIDEST_TURN_DEG < 90
    assert len(pairs) == 8
    assert near_pairs(ring(3), 3) == []  # 120 degrees apart


def test_all_are_compared_where_few_look_the_same_way():
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = range(4)
    assert len(near_pairs(capture(poses), 12)) == 6


def test_names_that_divide_or_hide_a_line_are_not_listed():
    assert can_be_listed(["left/0001.png", "b#1.jpg"])
    for name in ("a b.png", "a\tb.png", "#1.png"):
        assert not can_be_listed(["a.png", name])
