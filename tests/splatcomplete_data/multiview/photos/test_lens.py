from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatcomplete_data.multiview.photos.lens import Lens, SourceMap, undistort

SMALL = st.floats(-0.1, 0.1)


def lens(**values) -> Lens:
    defaults = {"width": 64, "height": 48, "focal_px": (50.0, 52.0), "center_px": (31.0, 25.0)}
    return Lens(**(defaults | values))


def slow_brown(x: float, y: float, k: tuple[float, ...], p: tuple[float, float]):
    """OpenCV's documented formula, written out for one point."""
    r2 = x**2 + y**2
    radial = (1 + k[0] * r2 + k[1] * r2**2 + k[2] * r2**3) / (
        1 + k[3] * r2 + k[4] * r2**2 + k[5] * r2**3
    )
    return (
        x * radial + 2 * p[0] * x * y + p[1] * (r2 + 2 * x**2),
        y * radial + p[0] * (r2 + 2 * y**2) + 2 * p[1] * x * y,
    )


@given(st.tuples(*[SMALL] * 6), st.tuples(SMALL, SMALL), st.floats(-1, 1), st.floats(-1, 1))
def test_brown_model_follows_opencvs_formula(k, p, x, y):
    found = lens(radial=k, tangential=p).distort(np.array(x), np.array(y))
    np.testing.assert_allclose(found, slow_brown(x, y, k, p), rtol=1e-12, atol=1e-12)


@given(st.floats(0.01, 1.3), st.floats(0, 6.28))
def test_fisheye_without_coefficients_is_equidistant(theta, angle):
    r = np.tan(theta)
    fisheye = lens(kind="fisheye")
    x, y = fisheye.distort(np.array(r * np.cos(angle)), np.array(r * np.sin(angle)))
    np.testing.assert_allclose(np.hypot(x, y), theta, rtol=1e-9)
    np.testing.assert_allclose(np.arctan2(y, x) % (2 * np.pi), angle % (2 * np.pi), atol=1e-6)


def test_fisheye_centre_stays():
    assert lens(kind="fisheye").distort(np.array(0.0), np.array(0.0)) == (0.0, 0.0)


def test_pinhole_photo_is_returned_as_it_is():
    photo = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    image, inside = undistort(photo, SourceMap.of(lens()))
    assert image is photo
    assert inside.all()


def test_undistortion_puts_a_known_point_where_a_pinhole_sees_it():
    camera = lens(radial=(0.15, -0.05, 0, 0, 0, 0), tangential=(0.002, -0.003))
    column, row = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    # A smooth picture in undistorted coordinates: what a photo pixel shows is found by inverting
    # the distortion with fixed-point iteration, independent of the code under test.
    shown_x = (column - 31.0) / 50.0
    shown_y = (row - 25.0) / 52.0
    x, y = shown_x.copy(), shown_y.copy()
    for _ in range(200):
        fx, fy = camera.distort(x, y)
        x, y = x - (fx - shown_x), y - (fy - shown_y)

    def scene(a, b):
        return 127 + 60 * np.sin(3 * a) + 50 * np.cos(4 * b)

    photo = np.repeat(scene(x, y)[:, :, None], 3, axis=2).round().astype(np.uint8)
    image, inside = undistort(photo, SourceMap.of(camera))
    wanted = scene(shown_x, shown_y)
    assert 0.5 < inside.mean() <= 1
    assert np.abs(image[:, :, 0][inside] - wanted[inside]).max() < 2.0
    assert (image[~inside] == 0).all()


def test_folding_lens_shows_nothing_twice():
    camera = lens(radial=(-0.9, 0, 0, 0, 0, 0))  # r (1 - 0.9 r^2) turns back at r = 0.61
    assert camera.fold_radius() == pytest.approx(np.sqrt(1 / 2.7), rel=1e-2)
    _, inside = undistort(np.full((48, 64, 3), 200, np.uint8), SourceMap.of(camera))
    row, column = np.nonzero(inside)
    r = np.hypot((column + 0.5 - 31) / 50, (row + 0.5 - 25) / 52)
    assert r.max() < 0.62
    assert lens(radial=(0.3, 0, 0, 0, 0, 0)).fold_radius() == np.inf


def test_resized_lens_shows_the_same_directions():
    small = lens(radial=(0.1, 0, 0, 0, 0, 0)).resized(32, 24)
    assert small.focal_px == (25.0, 26.0)
    assert small.center_px == (15.5, 12.5)
    assert small.radial[0] == 0.1


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"width": 0}, "size"),
        ({"focal_px": (0.0, 1.0)}, "focal length"),
        ({"radial": (float("nan"), 0, 0, 0, 0, 0)}, "finite"),
    ],
)
def test_impossible_lenses_are_refused(values, words):
    with pytest.raises(ValueError, match=words):
        lens(**values)


def test_photo_of_another_size_is_refused():
    with pytest.raises(ValueError, match="photo 10 x 10, lens 64 x 48"):
        undistort(np.zeros((10, 10, 3), np.uint8), SourceMap.of(lens()))
