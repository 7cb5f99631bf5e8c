import numpy as np
from PIL import Image

from splatcomplete_data.mesh.files.textures import sample_texture, texture_array


def test_texture_lookup_wraps_and_interpolates() -> None:
    texture = np.array([[[0.0], [1.0]], [[2.0], [3.0]]], np.float32)  # rows from the top
    centers = np.array([[0.25, 0.75], [0.75, 0.75], [0.25, 0.25], [0.75, 0.25]], np.float32)
    np.testing.assert_allclose(sample_texture(texture, centers)[:, 0], [0, 1, 2, 3], atol=1e-6)
    np.testing.assert_allclose(
        sample_texture(texture, centers + np.float32([[3, -2]]))[:, 0], [0, 1, 2, 3], atol=1e-5
    )
    middle = sample_texture(texture, np.array([[0.5, 0.5], [0.0, 0.0], [np.nan, 0.5]], np.float32))
    np.testing.assert_allclose(middle[:2, 0], 1.5, atol=1e-6)
    assert np.isfinite(middle).all()


def test_greys_of_16_bits_keep_their_shades() -> None:
    greys = np.array([[0, 64], [128, 255]], np.uint16)
    texture = texture_array(Image.fromarray(greys * 257), has_alpha=False, max_px=8)
    np.testing.assert_allclose(texture[..., 1] * 255, greys, atol=1e-4)
    assert (texture[..., 3] == 1).all()
