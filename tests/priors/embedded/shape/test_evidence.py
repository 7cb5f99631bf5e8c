import numpy as np
import pytest

from gscomplete.priors.embedded.shape.evidence import FRONT_TOLERANCE, gather_evidence
from gscomplete.views import ViewDistribution
from tests.priors.embedded.shape.shapes import half, sphere

VIEWS = ViewDistribution(0.0, 10.0)


def test_views_tell_front_behind_and_beside():
    evidence = gather_evidence(half(sphere()), VIEWS)
    points = np.array([[0.45, 0, 0], [0.0, 0, 0], [-0.3, 0, 0], [0, 0.69, 0.5]], np.float32)
    shares = evidence.classify(points)
    assert shares.sum(axis=1) == pytest.approx(1.0, abs=1e-6)
    assert shares[0, 0] > 0.9  # between the camera and the half sphere
    assert shares[1, 1] == pytest.approx(1.0)  # behind its surface
    assert shares[2, 1] == pytest.approx(1.0)
    assert shares[3, 2] > 0.6  # beside it
    assert FRONT_TOLERANCE > 0
