import numpy as np
import pytest

from gscomplete.priors.embedded.shape.evidence import FRONT_TOLERANCE, gather_evidence
from gscomplete.priors.embedded.shape.grid import CELLS, fill_colored, splat_arrays
from gscomplete.priors.embedded.shape.inputs import SOURCES, shape_inputs
from gscomplete.priors.embedded.shape.symmetries import likely_symmetries
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


def test_half_a_sphere_is_mirrored_to_its_other_half():
    partial = half(sphere())
    positions, tangents, opacities, colors = splat_arrays(partial)
    alone = fill_colored(positions, tangents, opacities, colors, CELLS)
    first, second, both = likely_symmetries(positions, alone[0], gather_evidence(partial, VIEWS))
    copy = first.apply(positions)
    missing = copy[copy[:, 0] < -0.05]
    assert len(missing) > 0.6 * len(copy)
    assert np.linalg.norm(missing, axis=1) == pytest.approx(0.4, abs=0.06)
    assert first.score >= second.score
    np.testing.assert_allclose(both.apply(positions), second.apply(copy), atol=1e-5)


def test_maps_are_rigid_and_undone():
    seen = shape_inputs(half(sphere()), VIEWS)
    points = np.random.default_rng(0).normal(size=(20, 3)).astype(np.float32)
    for symmetry in seen.symmetries:
        there = symmetry.apply(points)
        np.testing.assert_allclose(symmetry.undo(there), points, atol=1e-5)
        np.testing.assert_allclose(
            np.linalg.norm(there[1:] - there[:-1], axis=1),
            np.linalg.norm(points[1:] - points[:-1], axis=1),
            atol=1e-5,
        )
    assert seen.volumes.shape == (SOURCES, 4, CELLS, CELLS, CELLS)
