"""Neighbours of a point tell its surface's normal, and whether it ends there."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from gscomplete.splats import Splats
from gscomplete.splats.geometry.neighbourhood import (
    ON_RIM,
    flat_axes,
    normals_at,
    normals_of,
    one_sidedness,
)
from tests.builders.objects import cylinder, pipe


@pytest.mark.parametrize("normal", [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.48, 0.64, 0.6]])
def test_the_normal_of_a_plane_is_found_wherever_it_lies(normal: list[float]) -> None:
    rng = np.random.default_rng(0)
    across = np.array(normal)
    flat = rng.normal(size=(5, 16, 3))
    flat -= (flat @ across)[..., None] * across
    found = normals_of(flat + np.array([100.0, -3.0, 7.0]))
    # offsets from a place 100 away are rounded to 1e-14
    assert np.abs(found @ across) == pytest.approx(np.ones(5), abs=1e-10)
    assert np.linalg.norm(found, axis=1) == pytest.approx(np.ones(5))


def test_a_rim_has_its_neighbours_to_one_side() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    around = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    inside, rim = one_sidedness(np.stack([around, np.abs(around) * [1, -1, 1]]))
    assert inside < 1e-9
    assert rim > ON_RIM
    assert one_sidedness(np.zeros((2, 0, 3))).tolist() == [0.0, 0.0]


def outward(splats: Splats) -> np.ndarray:  # [N, 3]
    """Return the normals of upright cylinders about the z axis."""
    flat = splats.means.double().numpy() * [1.0, 1.0, 0.0]
    return flat / np.linalg.norm(flat, axis=1, keepdims=True)


def test_flat_splats_tell_the_normal_of_a_thin_wall_and_places_do_not() -> None:
    wall = pipe()
    points, tree = wall.means.double().numpy(), cKDTree(wall.means.double().numpy())
    by_axes = (normals_at(points, points, tree, flat_axes(wall)) * outward(wall)).sum(axis=1)
    by_places = (normals_at(points, points, tree) * outward(wall)).sum(axis=1)
    # Neighbours reach about .06 along a circle of radius .5, and the wall is .03 thick.
    assert np.abs(by_axes).min() > 0.99  # measured: .998
    assert (np.abs(by_places) < 0.9).mean() > 0.25  # measured: .39


def test_round_splats_and_axes_that_disagree_leave_it_to_places() -> None:
    spots = cylinder(is_flat=False)
    points, tree = spots.means.double().numpy(), cKDTree(spots.means.double().numpy())
    assert not flat_axes(spots).any()
    anywhere = np.random.default_rng(0).normal(size=points.shape)
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    by_places = normals_at(points, points, tree)
    for axes in (flat_axes(spots), anywhere):
        found = normals_at(points, points, tree, axes)
        same = (found == by_places).all(axis=1)
        assert same.mean() > 0.95  # a few of 3,000 draws of 17 directions happen to agree


def test_axes_do_not_depend_on_the_scale_of_quaternions_or_splats() -> None:
    wall = pipe(500)
    other = Splats(wall.means, 7.0 * wall.quaternions, 1e-3 * wall.scales, wall.opacities, wall.sh)
    np.testing.assert_allclose(flat_axes(other), flat_axes(wall), atol=1e-6)  # float32
    assert torch.from_numpy(flat_axes(wall)).norm(dim=1).numpy() == pytest.approx(1.0, abs=1e-6)
