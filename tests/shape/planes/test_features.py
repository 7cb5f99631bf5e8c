import math

import numpy as np
import pytest

from gscomplete.shape.evidence import gather_evidence
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.planes.features import (
    ANGLES,
    FEATURES,
    OFFSETS,
    PartSamples,
    plane_features,
    plane_normals,
)
from gscomplete.shape.voxels import CELLS
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half, moved

VIEWS = ViewDistribution(0.0, 10.0)
MIDDLE = OFFSETS.index(0.0)


def sampled(partial: Splats) -> PartSamples:
    return voxelize_partial(partial, VIEWS).samples()


def features_of(partial: Splats) -> dict[str, np.ndarray]:
    features = plane_features(sampled(partial), gather_evidence(partial, VIEWS))
    assert features.shape == (ANGLES, len(OFFSETS), len(FEATURES))
    assert np.isfinite(features).all()
    return dict(zip(FEATURES, np.moveaxis(features, -1, 0), strict=True))


def test_samples_are_counted_as_by_hand():
    """One plane, counted sample by sample in float64."""
    partial = half(ball())
    part = sampled(partial)
    evidence = gather_evidence(partial, VIEWS)
    found = features_of(partial)
    a, o = 7, MIDDLE + 3
    normal = np.array([*plane_normals()[a], 0.0], np.float64)
    copies = part.points + 2 * (OFFSETS[o] - part.points @ normal)[:, None] * normal
    cells = np.floor((copies + 0.72) * CELLS / 1.44).astype(int)
    inside = ((cells >= 0) & (cells < CELLS)).all(axis=1)
    far = np.where(inside, part.distance[tuple(cells.clip(0, CELLS - 1).T)], 3)
    shares = evidence.classify(copies.astype(np.float32))
    # A sample on the border of two cells may fall on the other side in float32.
    slack = 3 / len(part.points)
    assert found["new"][a, o] == pytest.approx((far >= 2).mean(), abs=slack)
    assert found["near"][a, o] == pytest.approx((far == 2).mean(), abs=slack)
    assert found["exact"][a, o] == pytest.approx((far == 0).mean(), abs=slack)
    for n, name in enumerate(("front", "behind", "beside")):
        expected = (shares[:, n] * (far >= 2)).mean()
        assert found[name][a, o] == pytest.approx(expected, abs=slack)


def test_half_a_sphere_closes_across_its_cut():
    found = features_of(half(ball()))
    assert found["rim_at_plane"][0, MIDDLE] > 0.8
    assert found["rim_closed"][0, MIDDLE] > 0.8
    assert found["behind"][0, MIDDLE] > 0.6  # the copy is new and out of sight
    assert found["new"][0, MIDDLE] > 0.7
    across = ANGLES // 2
    assert found["new"][across, MIDDLE] < 0.05  # its other plane of symmetry shows nothing new
    assert found["exact"][across, MIDDLE] > 0.6
    assert found["aligned"][across, MIDDLE] > 0.8 * found["exact"][across, MIDDLE]


def test_colors_of_a_copy_are_compared():
    found = features_of(ball())  # its colour is its normal
    for angle in (0, ANGLES // 2):
        share = found["exact"][angle, MIDDLE]
        # The mean of |2 n 0.4| / 3 over a sphere.
        assert found["color_error"][angle, MIDDLE] / share == pytest.approx(0.4 / 3, abs=0.04)


def test_lengths():
    part = moved(half(ball(radius=0.2)), (0.1, 0.0, 0.0))  # x from 0.1 to 0.3
    found = features_of(part)
    at = OFFSETS.index(0.4)
    # Ends are quantiles, .5 % of the width inside; samples of a sphere lie evenly along x.
    error = 0.2 * (0.005 * 0.995 / len(part)) ** 0.5  # standard error of an end
    assert found["gap"][0, at] == pytest.approx(0.1 + 0.005 * 0.2, abs=2 * error)
    assert found["gap"][0, OFFSETS.index(0.2)] == 0
    assert found["width"][0, at] == pytest.approx(0.99 * 0.2, abs=2 * error)
    assert found["edge"][0, OFFSETS.index(0.2)] == pytest.approx(0.5, abs=2 * error / 0.2)
    assert found["offset"][0, at] == pytest.approx(0.4)


@pytest.mark.parametrize("count", [1, 2, 9, 600])
def test_few_or_equal_points_break_nothing(count):
    one = ball(count=count)
    features_of(one)
    features_of(moved(one, (3.0, 0.0, 0.0)))  # outside the grid


def test_normals_are_unit_and_spread():
    normals = plane_normals()
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    assert math.degrees(math.acos(float(normals[0] @ normals[1]))) == pytest.approx(5.0, abs=1e-3)
