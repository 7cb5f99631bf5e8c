import numpy as np
import pytest

from gscomplete.shape.evidence import FRONT_TOLERANCE, Evidence, gather_evidence, kind_of
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half

VIEWS = ViewDistribution(0.0, 10.0)


def test_views_tell_front_behind_and_beside():
    evidence = gather_evidence(half(ball()), VIEWS)
    points = np.array([[0.45, 0, 0], [0.0, 0, 0], [-0.3, 0, 0], [0, 0.69, 0.5]], np.float32)
    shares = evidence.classify(points)
    assert shares.sum(axis=1) == pytest.approx(1.0, abs=1e-6)
    assert shares[0, 0] > 0.9  # between the camera and the half sphere
    assert shares[1, 1] == pytest.approx(1.0)  # behind its surface
    assert shares[2, 1] == pytest.approx(1.0)
    assert shares[3, 2] > 0.6  # beside it


@pytest.mark.parametrize(("nearer", "kind"), [(-1.0, 1), (0.0, 1), (0.5, 1), (1.5, 0), (10.0, 0)])
def test_a_point_is_in_front_from_the_tolerance_on(nearer, kind):
    """P's surface is 2 away everywhere; the camera stands at the origin and looks along z."""
    depth = np.full((8, 8), 2.0, np.float32)
    camera = np.eye(4, dtype=np.float32)
    point = 0.0, 0.0, 2.0 - nearer * FRONT_TOLERANCE
    assert kind_of.py_func(*point, depth, camera, 8.0) == kind
    shares = Evidence(depth[None], camera[None], 8.0).classify(np.array([point], np.float32))
    assert shares.argmax(axis=1) == [kind]


def test_all_points_at_once_are_classified_as_one_by_one():
    """Shares of four views, some of which the points are behind, beside or outside of."""
    evidence = gather_evidence(half(ball()), VIEWS)
    points = np.random.default_rng(0).normal(0, 2.0, (500, 3)).astype(np.float32)
    points[0] = np.nan
    found = evidence.classify(points)
    views = list(zip(evidence.depth, evidence.camera_from_world, strict=True))
    for point, shares in zip(points, found, strict=True):
        kinds = [kind_of.py_func(*point, *view, evidence.focal_px) for view in views]
        assert shares == pytest.approx(np.bincount(kinds, minlength=3) / len(views))
    assert (found.max(axis=0) > 0).all()
