import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.shape.surface import continuation
from gscomplete.shape.surface.continuation import (
    CROSSING_DEPTHS,
    CROSSINGS,
    OrientedPoints,
    crossings,
)
from gscomplete.shape.voxels import CELL_SIDE
from tests.builders.objects import ball
from tests.builders.threads import each_thread_count


def column(found, name):
    return found[:, CROSSINGS.index(name)]


def surface(count=30, seed=0):
    """Points in the middle of the frame and normals in all directions."""
    rng = np.random.default_rng(seed)
    places, normals = rng.uniform(-0.3, 0.3, (count, 3)), rng.normal(size=(count, 3))
    return places, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def by_hand(points, normals, splats):
    """The slow twin: all pairs at once, and each count by its definition."""
    cosine = normals @ splats.normals.T
    way = points[:, None] - splats.points
    facing = np.where(cosine > 0, 1.0, -1.0)[..., None] * splats.normals
    both = facing + normals[:, None]
    depth = (way * both).sum(axis=2) / ((both * normals[:, None]).sum(axis=2) * CELL_SIDE)
    distance = np.linalg.norm(way, axis=2)
    counts = (depth >= -2.0) & (depth <= 4.0) & (distance <= 0.45)
    weight = np.where(counts, np.abs(cosine), 0.0)
    weight *= np.exp(-0.5 * (distance / continuation._REACH) ** 2)
    depths = np.array(CROSSING_DEPTHS)
    share = np.clip(1 - np.abs(depth[..., None] - depths) / 0.5, 0, 1)
    rows = (weight[..., None] * share).sum(axis=1)
    about = []
    for row in rows:
        few = slice(max(row.argmax() - 1, 0), row.argmax() + 2)
        whole = row[few].sum()
        about.append((row[few] @ depths[few] / whole if whole else 0.0, math.log(0.01 + whole)))
    nearest = np.where(counts, distance, np.inf).argmin(axis=1)
    row = np.arange(len(points))
    last = np.stack([depth[row, nearest], distance[row, nearest], np.abs(cosine)[row, nearest]])
    last = np.where(counts.any(axis=1), last, np.array([0.0, 0.45, 0.0])[:, None])
    return np.concatenate([np.log(0.01 + rows), np.array(about), last.T], axis=1)


def test_crossings_are_those_of_the_slow_twin():
    points, normals = surface()
    splats = OrientedPoints.of(ball(800).means.numpy() * 0.4)
    found = crossings(points, normals, splats)
    # written in float32; a sum of hundreds of weights in another order
    np.testing.assert_allclose(found, by_hand(points, normals, splats), rtol=1e-5, atol=1e-5)


@given(st.floats(-1.9, 3.9), st.floats(0.0, 2 * math.pi))
def test_a_wall_is_crossed_where_it_is_continued(depth, azimuth_rad):
    """A flat wall goes on in its plane."""
    out = np.array([math.cos(azimuth_rad), math.sin(azimuth_rad), 0.0])
    along = np.array([-out[1], out[0], 0.0])
    a, b = (v.ravel() for v in np.meshgrid(np.linspace(-0.4, 0.0, 20), np.linspace(-0.2, 0.2, 20)))
    wall = a[:, None] * along + b[:, None] * np.array([0.0, 0.0, 1.0]) + 0.3 * out
    place = 0.05 * along + (0.3 + depth * CELL_SIDE) * out
    found = crossings(place[None], out[None], OrientedPoints.of(wall))
    assert column(found, "nearest_depth")[0] == pytest.approx(depth, abs=1e-4)
    assert column(found, "nearest_cosine")[0] == pytest.approx(1.0, abs=1e-6)
    assert column(found, "most_depth")[0] == pytest.approx(depth, abs=1e-4)
    distance = np.linalg.norm(place - wall, axis=1)
    shares = np.exp(-0.5 * (distance / continuation._REACH) ** 2)[distance <= 0.45]
    assert column(found, "most")[0] == pytest.approx(math.log(0.01 + shares.sum()), abs=1e-4)


@given(st.floats(-0.9, 0.9), st.floats(0.0, 2 * math.pi), st.floats(-1.5, 3.0))
def test_a_ball_is_crossed_where_it_goes_on(height, azimuth_rad, depth):
    """From anywhere on half a ball, the circle through it and the way in is the ball's own."""
    radius = 0.4
    front = np.random.default_rng(0).normal(size=(800, 3))
    front = front[front[:, 0] > 0] / np.linalg.norm(front[front[:, 0] > 0], axis=1, keepdims=True)
    level = math.sqrt(1 - height * height)
    out = np.array([level * math.cos(azimuth_rad), level * math.sin(azimuth_rad), height])
    place = (radius + depth * CELL_SIDE) * out
    # a normal that faces away from the way in is taken for the opposite one
    near = (front @ out > 0.05) & (np.linalg.norm(radius * front - place, axis=1) < 0.45)
    found = crossings(place[None], out[None], OrientedPoints(radius * front[near], front[near]))
    if near.any():
        assert column(found, "nearest_depth")[0] == pytest.approx(depth, abs=1e-4)
        assert column(found, "most_depth")[0] == pytest.approx(depth, abs=1e-4)


def test_far_splats_do_not_count():
    wall = np.random.default_rng(0).uniform(-0.2, 0.2, (500, 3)) * np.array([1.0, 1.0, 0.0])
    far = np.array([[1.5, 0.0, 0.0]])
    found = crossings(far, np.array([[0.0, 0.0, 1.0]]), OrientedPoints.of(wall))
    assert column(found, "most")[0] == pytest.approx(math.log(0.01), abs=1e-6)
    assert column(found, "nearest_distance")[0] == pytest.approx(0.45)


@pytest.mark.parametrize("count", [1, 2, 3, 10])
def test_few_splats_are_continued(count):
    points, normals = surface()
    splats = OrientedPoints.of(np.random.default_rng(1).normal(size=(count, 3)))
    assert np.isfinite(crossings(points, normals, splats)).all()


def test_crossings_do_not_depend_on_threads():
    points, normals = surface(5000)
    splats = OrientedPoints.of(ball(800).means.numpy() * 0.4)
    assert len({crossings(points, normals, splats).tobytes() for _ in each_thread_count()}) == 1
