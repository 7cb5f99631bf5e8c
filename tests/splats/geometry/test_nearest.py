"""Nearest neighbours in threads."""

import signal
import threading
import time

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from gscomplete.splats.geometry.nearest import query_nearest

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("k", [1, 3, [1], [2, 5]])
@pytest.mark.parametrize("threads", [1, 3])
def test_answers_are_those_of_one_thread(k, threads, monkeypatch):
    monkeypatch.setattr(torch, "get_num_threads", lambda: threads)
    tree, points = cKDTree(RNG.random((50, 3))), RNG.random((20_001, 3))
    for found, expected in zip(
        query_nearest(tree, points, k), tree.query(points, k=k), strict=True
    ):
        assert np.array_equal(found, expected)


def test_what_is_not_within_reach_is_infinitely_far():
    tree, points = cKDTree(RNG.random((50, 3))), RNG.random((9_000, 3))
    every, _ = tree.query(points)
    near, _ = query_nearest(tree, points, within=0.1)
    assert np.array_equal(near, np.where(every < 0.1, every, np.inf))


def test_no_points_have_no_neighbours():
    distances, indices = query_nearest(cKDTree(np.zeros((1, 3))), np.zeros((0, 3)))
    assert len(distances) == len(indices) == 0


def test_an_interrupt_leaves_no_thread_behind(monkeypatch):
    """A thread that reads a tree while the interpreter ends is a segmentation fault."""
    running = threading.active_count()
    reading = []

    class SlowTree:
        def query(self, rows, k, distance_upper_bound):
            reading.append(rows)
            time.sleep(0.3)
            reading.pop()
            return np.zeros(len(rows)), np.zeros(len(rows), np.intp)

    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    main = threading.main_thread().ident
    threading.Timer(0.1, signal.pthread_kill, [main, signal.SIGINT]).start()
    with pytest.raises(KeyboardInterrupt):
        query_nearest(SlowTree(), np.zeros((20_000, 3)))
    assert not reading
    assert threading.active_count() == running
