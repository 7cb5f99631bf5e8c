import numpy as np
import pytest

from recipes.train_embedded_prior.procedural.primitives import box, cylinder, disc, ellipsoid
from recipes.train_embedded_prior.procedural.quads import Quads
from recipes.train_embedded_prior.procedural.sampling import (
    FINEST,
    sample_quads,
    spacing_per_part,
)
from recipes.train_embedded_prior.procedural.sweeps import rod


def areas_of(quads: Quads) -> np.ndarray:
    """Slow float64 twin: areas of quads from their two triangles."""
    c = quads.corners.astype(np.float64)
    first = np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1)
    second = np.linalg.norm(np.cross(c[:, 2] - c[:, 0], c[:, 3] - c[:, 0]), axis=1)
    return 0.5 * (first + second)


def thick(quads: Quads) -> Quads:
    return Quads(quads.corners, quads.uv, None)


def test_parts_share_points_by_area():
    parts = [thick(box((1, 1, 1))), thick(ellipsoid((0.5, 0.5, 0.5), rows=20, segments=40))]
    samples = sample_quads(parts, 5000, np.random.default_rng(0))
    areas = np.array([areas_of(part).sum() for part in parts])
    found = np.bincount(samples.part)
    assert found.sum() == 5000
    assert np.abs(found - 5000 * areas / areas.sum()).max() < 3


def test_points_lie_on_the_surface_with_unit_normals_outward():
    samples = sample_quads([box((2, 2, 2))], 3000, np.random.default_rng(1))
    centered = samples.points - [0, 0, 1]
    assert np.allclose(np.abs(centered).max(axis=1), 1.0, atol=1e-5)
    assert np.allclose(np.linalg.norm(samples.normals, axis=1), 1, atol=1e-5)
    assert (np.einsum("ij,ij->i", samples.normals, centered) > 0.99).all()


@pytest.mark.parametrize("shape", [disc(1.0, 40), cylinder(0.0001, 1.0, 1.0, 40)])
def test_degenerate_quads_are_covered_evenly(shape):
    samples = sample_quads([thick(shape)], 4000, np.random.default_rng(2))
    radius = np.hypot(samples.points[:, 0], samples.points[:, 1])
    top = samples.normals[:, 2] > 0.9
    # on a disc half of the points lie beyond radius sqrt(1/2)
    assert np.mean(radius[top] > np.sqrt(0.5)) == pytest.approx(0.5, abs=0.03)


def test_points_are_spread_without_holes_or_heaps():
    samples = sample_quads([thick(box((1, 1, 1)))], 6000, np.random.default_rng(3))
    spacing = float(samples.spacing[0])
    probes = sample_quads([thick(box((1, 1, 1)))], 400, np.random.default_rng(4)).points
    gap = np.linalg.norm(probes[:, None] - samples.points[None], axis=2).min(axis=1)
    assert gap.max() < 1.6 * spacing


def test_thin_parts_get_finer_points():
    parts = [box((1, 1, 1)), rod((0, 0, 1), (0, 0, 2), 0.01)]
    samples = sample_quads(parts, 6000, np.random.default_rng(5))
    coarse, fine = (samples.spacing[samples.part == k][0] for k in range(2))
    assert fine == pytest.approx(FINEST * coarse, rel=1e-6)  # float32
    assert len(samples.points) == 6000


def test_spacings_use_up_the_budget():
    areas, features = np.array([6.0, 0.3, 0.1]), np.array([np.inf, 0.05, 0.02])
    spacing = spacing_per_part(areas, features, 9000)
    # float32, squared: four iterations leave less
    assert (areas / spacing.astype(np.float64) ** 2).sum() == pytest.approx(9000, rel=1e-6)


def test_same_generator_state_same_points():
    first, second = (
        sample_quads([box((1, 2, 3))], 100, np.random.default_rng(7)) for _ in range(2)
    )
    assert np.array_equal(first.points, second.points)


def test_nothing_to_sample_is_refused():
    with pytest.raises(ValueError, match="at least one part"):
        sample_quads([], 10, np.random.default_rng(0))
    flat = Quads(np.zeros((2, 4, 3), np.float32), np.zeros((2, 4, 2), np.float32))
    with pytest.raises(ValueError, match="area"):
        sample_quads([flat], 10, np.random.default_rng(0))
