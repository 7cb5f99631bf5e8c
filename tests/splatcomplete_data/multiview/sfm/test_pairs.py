"""Near pairs of a ring: neighbours on it, never the photo across, each pair once."""

from __future__ import annotations

import numpy as np

from splatcomplete_data.multiview.sfm.pairs import WIDEST_TURN_DEG, near_pairs


def ring(count: int, outwards: bool = False) -> dict[str, np.ndarray]:
    """Return cameras on a circle round the origin, which look at it or away from it."""
    poses = {}
    for k in range(count):
        angle = 2 * np.pi * k / count
        position = np.array([np.cos(angle), np.sin(angle), 0.0])
        forward = position if outwards else -position
        right = np.cross(forward, [0.0, 0.0, 1.0])
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ position
        poses[f"{k:02}"] = pose
    return poses


def test_a_ring_is_paired_along_itself():
    for outwards in (False, True):
        pairs = near_pairs(ring(24, outwards), 4)
        steps = {min((int(b) - int(a)) % 24, (int(a) - int(b)) % 24) for a, b in pairs}
        assert steps == {1, 2}
        assert len(pairs) == len(set(pairs)) == 48


def test_photos_taken_in_other_directions_are_not_compared():
    pairs = near_pairs(ring(8), 7)  # 45 degrees apart
    assert WIDEST_TURN_DEG < 90
    assert len(pairs) == 8
    back_to_back = {"a": np.eye(4), "b": np.diag([-1.0, 1.0, -1.0, 1.0])}
    assert near_pairs(back_to_back, 3) == []


def test_all_are_compared_where_few_look_the_same_way():
    same = {name: np.eye(4) for name in "abcd"}
    for index, pose in enumerate(same.values()):
        pose[0, 3] = index
    assert len(near_pairs(same, 12)) == 6
