import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recipes.train_embedded_prior.procedural.sampling import SurfaceSamples
from recipes.train_embedded_prior.procedural.warps import Warp, draw_warp, warped


def ball(count=2000, seed=0):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    flat = np.zeros((count, 2), np.float32)
    spacing = np.full(count, 0.05, np.float32)
    return SurfaceSamples(0.5 * normals, normals, flat, spacing, np.zeros(count, np.int64))


@given(st.integers(0, 10_000))
def test_mirror_images_stay_mirror_images(seed):
    warp = draw_warp(np.random.default_rng(seed))
    points = np.random.default_rng(seed + 1).uniform(-0.5, 0.5, (50, 3)).astype(np.float32)
    mirror = np.array([1, -1, 1], np.float32)
    # float32 rounding of values near 1
    np.testing.assert_allclose(warp(points * mirror), warp(points) * mirror, atol=2e-6)


@given(st.integers(0, 10_000))
def test_nothing_folds_over(seed):
    warp = draw_warp(np.random.default_rng(seed))
    points = np.random.default_rng(seed + 1).uniform(-0.5, 0.5, (200, 3))
    step = 1e-4
    columns = [(warp(points + step * e) - warp(points - step * e)) / (2 * step) for e in np.eye(3)]
    assert np.linalg.det(np.stack(columns, axis=-1)).min() > 0.05


def test_normals_and_spacing_follow_the_surface():
    # A ball stretched to an ellipsoid has known normals and known growth of its area.
    stretch = (1.3, 0.8, 1.1)
    samples = ball()
    found = warped(samples, Warp(stretch, 0.0, 0.0, 1.0, 0.0, 0.0, ()))
    scale = np.array(stretch)
    expected = samples.normals / scale
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    # Points are up to .65; float32 rounds their differences over 0.002 to steps of 3e-5.
    np.testing.assert_allclose(found.normals, expected, rtol=0, atol=1e-4)
    area = scale.prod() * np.linalg.norm(samples.normals / scale, axis=1)
    np.testing.assert_allclose(found.spacing, 0.05 * np.sqrt(area), rtol=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_radial_warps_leave_circles_round(seed):
    rng = np.random.default_rng(seed)
    warp = draw_warp(rng)
    while warp.waves or warp.bend or warp.stretch[0] != warp.stretch[1]:
        warp = draw_warp(rng)
    angle = np.linspace(0, 6, 40)
    circle = np.stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), np.full(40, 0.2)], axis=1)
    radius = np.linalg.norm(warp(circle.astype(np.float32))[:, :2], axis=1)
    np.testing.assert_allclose(radius, radius[0], rtol=1e-5)
