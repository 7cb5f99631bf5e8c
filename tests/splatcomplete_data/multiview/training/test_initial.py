from __future__ import annotations

import numpy as np
import pytest

from gscomplete.errors import UserError
from splatcomplete_data.multiview.photos.images import load_views
from splatcomplete_data.multiview.photos.transforms_json import read_transforms
from splatcomplete_data.multiview.training.initial import (
    near_points,
    random_points,
    splats_from_points,
)
from splatcomplete_data.scan import PointCloud
from tests.builders import captures


def cloud(points: np.ndarray) -> PointCloud:
    return PointCloud(points, np.full((len(points), 3), 0.25, np.float32))


def test_widths_are_the_distance_to_neighbours():
    grid = np.stack(np.meshgrid(*[np.arange(5.0)] * 3), axis=-1).reshape(-1, 3)
    splats = splats_from_points(cloud(np.concatenate([grid, grid[:7]])))
    assert len(splats) == 125  # doubles are one point
    np.testing.assert_allclose(splats.scales.numpy(), 1.0)
    np.testing.assert_allclose(splats.base_colors.numpy(), 0.25, atol=1e-6)
    np.testing.assert_allclose(splats.opacities.numpy(), 0.1)


def test_a_lone_point_does_not_become_a_giant():
    points = np.random.default_rng(0).uniform(0, 1, (300, 3))
    splats = splats_from_points(cloud(np.concatenate([points, [[1e4, 0, 0]]])))
    assert splats.scales.max() < 1


def test_too_few_points_are_refused():
    with pytest.raises(UserError, match="at least 50 distinct points, found 1"):
        splats_from_points(cloud(np.zeros((99, 3))))


def test_random_points_are_seen_and_coloured(tmp_path):
    folder = captures.transforms_capture(tmp_path, alpha=True)
    posed = read_transforms(folder / "transforms.json")
    views = load_views(posed, max_side_px=100)
    points = random_points(posed, views, 300, seed=1)
    assert len(points) == 300
    again = random_points(posed, views, 300, seed=1)
    np.testing.assert_array_equal(points.points, again.points)
    # No photo shows one outside the ball of radius 0.6 (0.78 where it fades out): those that
    # only few photos show lie farther behind it.
    assert np.median(np.linalg.norm(points.points, axis=1)) < 0.8
    assert points.colors.max() <= 1.0
    assert points.colors.std() > 0.02


def test_far_points_are_dropped(tmp_path):
    posed = read_transforms(captures.transforms_capture(tmp_path) / "transforms.json")
    kept = near_points(cloud(np.array([[0.0, 0, 0], [8.9, 0, 0], [9.1, 0, 0]])), posed)
    assert len(kept) == 2  # cameras stand 3 away, three times that is the limit


def test_random_points_are_seen_by_two_cameras(tmp_path):
    posed = read_transforms(captures.transforms_capture(tmp_path) / "transforms.json")
    views = load_views(posed, max_side_px=100)
    with pytest.raises(UserError, match="no place that two of them see"):
        random_points(posed, views[:1], 300, seed=1)
    points = random_points(posed, views[:4], 300, seed=1).points
    times = np.zeros(300, np.int64)
    for view in views[:4]:  # their fields of view are 50 degrees wide
        pose = view.camera.camera_from_world[0].double().numpy()
        local = points @ pose[:3, :3].T + pose[:3, 3]
        slope = np.abs(local[:, :2]).max(axis=1) / local[:, 2]
        times += (local[:, 2] > 0) & (slope < np.tan(np.deg2rad(25.0)))
    assert times.min() == 2
