"""Clusters are the connected components of the points that are near enough to each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from splatcomplete_data.scan.clusters import cluster


def slow_twin(points: np.ndarray, radius: float) -> np.ndarray:
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (len(points),) * 2)
    return connected_components(graph, directed=False)[1]


def is_one_to_one(first: np.ndarray, second: np.ndarray) -> bool:
    pairs = np.unique(np.stack([first, second], axis=1), axis=0)
    return len(pairs) == len(np.unique(first)) == len(np.unique(second))


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 120),
    st.sampled_from([1, 2, 3]),
    st.floats(0.01, 0.6),
    st.sampled_from([1e-6, 1.0, 1e6]),
)
@settings(max_examples=150, deadline=None)
def test_clusters_equal_their_slow_twin(
    seed: int, count: int, dimensions: int, radius: float, scale: float
) -> None:
    """Of lines, sheets and volumes of points, thick and thin, in any unit."""
    points = np.zeros((count, 3))
    points[:, :dimensions] = np.random.default_rng(seed).uniform(-0.5, 0.5, (count, dimensions))
    labels = cluster(scale * points, scale * radius)
    assert is_one_to_one(labels, slow_twin(scale * points, scale * radius))
    assert (np.diff(np.bincount(labels)) <= 0).all()  # largest first


@given(
    st.lists(st.tuples(*[st.integers(-6, 6)] * 3), min_size=1, max_size=80),
    st.sampled_from([1.0, 2.0, 3.0, 5.0]),
)
@settings(max_examples=150, deadline=None)
def test_points_exactly_a_radius_apart_are_of_one_cluster(
    places: list[tuple[int, int, int]], radius: float
) -> None:
    """On whole numbers squares are exact; (2, 2, 1) is 3 away, and doubles are 0."""
    points = np.array(places, np.float64)
    assert is_one_to_one(cluster(points, radius), slow_twin(points, radius))


def test_dense_blobs_are_judged_by_their_nearest_points() -> None:
    """The mean points of their cubes are farther apart than the blobs are."""
    rng = np.random.default_rng(0)
    blob = rng.uniform(0, 1, (2000, 3))
    for gap, count in ((0.85, 1), (1.1, 2)):
        both = np.concatenate([blob, blob[:500] + np.array([1 + 0.3 * gap, 0, 0])])
        labels = cluster(both, 0.3)
        assert labels.max() + 1 == count
        assert is_one_to_one(labels, slow_twin(both, 0.3))


def test_a_point_astronomically_far_away_is_a_cluster_of_its_own() -> None:
    points = np.concatenate([np.zeros((3, 3)), [[1e300, 0, 0]], np.full((2, 3), -1e300)])
    assert cluster(points, 1e-3).tolist() == [0, 0, 0, 2, 1, 1]


@pytest.mark.parametrize("count", [0, 1])
def test_few_points(count: int) -> None:
    assert cluster(np.zeros((count, 3)), 1.0).tolist() == [0] * count
