"""Even samples of a surface, against a search among all pairs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from gscomplete.splats.geometry.poisson_disk import keep_apart, poisson_disk_sample


def kept_slowly(points, normals, spacing):
    """Twin of ``keep_apart`` that compares each point with all that were kept."""
    kept = []
    for i in range(len(points)):
        near = ((points[kept] - points[i]) ** 2).sum(axis=1) < spacing**2
        if not (near & (normals[kept] @ normals[i] > 0)).any():
            kept.append(i)
    return np.isin(np.arange(len(points)), kept)


def ball(count, seed=0):
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return 0.3 * normals, normals


@given(st.integers(0, 60), st.floats(1e-3, 3.0), st.integers(0, 2**32 - 1), st.booleans())
def test_the_same_points_are_kept_as_by_comparing_all_pairs(count, spacing, seed, is_gridded):
    rng = np.random.default_rng(seed)
    points, normals = rng.uniform(0, 1, (count, 3)), rng.normal(size=(count, 3))
    if is_gridded:  # points in the same place and on the borders of cells
        points, normals = np.floor(4 * points) * 0.25, np.sign(normals)
    assert (keep_apart(points, normals, spacing) == kept_slowly(points, normals, spacing)).all()


@pytest.mark.parametrize("most", [1, 37, 1000, 5000])
def test_as_many_are_kept_as_there_is_room_for(most):
    points, normals = ball(60_000)
    kept, spacing = poisson_disk_sample(points, normals, most, 1e-4)
    assert 0.9 * most <= len(kept) <= most  # ends from .97 on, or after its rounds
    assert (np.diff(kept) > 0).all()
    pairs = cKDTree(points[kept]).query_pairs(spacing, output_type="ndarray")
    apart = (normals[kept][pairs[:, 0]] * normals[kept][pairs[:, 1]]).sum(axis=1)
    assert (apart <= 0).all()  # only points that face opposite ways are nearer than the spacing
    assert cKDTree(points[kept]).query(points)[0].max() <= spacing


def test_an_even_sample_leaves_smaller_gaps_than_one_of_a_grid():
    points, normals = ball(60_000)
    kept, _ = poisson_disk_sample(points, normals, 2000, 1e-4)
    _, of_grid = np.unique(np.floor(points / 0.0284), axis=0, return_index=True)
    assert len(of_grid) >= len(kept)
    gaps, of_others = (cKDTree(points[k]).query(points)[0].max() for k in (kept, of_grid))
    assert gaps < 0.8 * of_others


def test_no_spacing_is_smaller_than_the_least():
    points, normals = ball(60_000)
    kept, spacing = poisson_disk_sample(points, normals, 60_000, 0.02)
    assert spacing == 0.02
    assert cKDTree(points[kept]).query(points[kept], k=2)[0][:, 1].min() >= 0.02


def test_all_of_a_few_are_kept_and_both_sides_of_a_thin_wall():
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1e-3], [1.0, 0.0, 0.0]])
    normals = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    assert poisson_disk_sample(points, normals, 10, 0.01)[0].tolist() == [0, 1, 2]
    assert poisson_disk_sample(points, normals, 1, 0.01)[0].tolist() == [0]
    assert len(poisson_disk_sample(points[:0], normals[:0], 10, 0.01)[0]) == 0
    same, up = np.zeros((50, 3)), np.tile([0.0, 0.0, 1.0], (50, 1))
    assert poisson_disk_sample(same, up, 3, 0.01)[0].tolist() == [0]
