import pytest
import torch

from gscomplete.priors.embedded.inputs import (
    images_to_color_alpha,
    input_map,
    network_images,
    resize_images,
    shape_map,
)
from tests.builders.tiny_denoiser import ring_views


@pytest.mark.parametrize("size", [8, 16, 32, 48])
def test_resizing_keeps_the_mean_and_is_differentiable(size):
    images = torch.rand(4, 3, 32, 32, requires_grad=True)
    resized = resize_images(images, size)
    assert resized.shape == (4, 3, size, size)
    # float32 rounding of means
    torch.testing.assert_close(resized.mean(), images.mean(), rtol=1e-6, atol=0.0)
    resized.sum().backward()
    assert (images.grad > 0).all()


def test_shrinking_by_a_whole_factor_is_the_block_mean():
    images = torch.rand(1, 2, 8, 8)
    blocks = images.unflatten(3, (4, 2)).unflatten(2, (4, 2)).mean((3, 5))
    torch.testing.assert_close(resize_images(images, 4), blocks)


def test_images_round_trip():
    views = ring_views(16)
    color, alpha = images_to_color_alpha(network_images(views.color, views.alpha, 16))
    torch.testing.assert_close(color, views.color, rtol=0, atol=1e-6)
    torch.testing.assert_close(alpha, views.alpha, rtol=0, atol=1e-6)


def test_any_images_become_valid_renders():
    color, alpha = images_to_color_alpha(torch.randn(4, 4, 8, 8) * 3)
    assert ((color >= 0) & (color <= alpha[..., None])).all()
    assert ((alpha >= 0) & (alpha <= 1)).all()


def test_relief_is_positive_in_front_of_the_target_and_zero_where_nothing_is_seen():
    color = torch.zeros(1, 3, 3, 3)
    alpha = torch.tensor([1.0, 0.5, 0.0]).expand(1, 3, 3)
    depth = torch.tensor([1.5, 2.5, 0.0]).expand(1, 3, 3)
    mapped = input_map(color, alpha, depth, 2.0, 3)
    torch.testing.assert_close(mapped[0, 4, 1], torch.tensor([0.5, -0.25, 0.0]))


def test_a_shape_has_relief_as_the_input_has():
    alpha = torch.tensor([1.0, 0.5, 0.0]).expand(1, 3, 3)
    depth = torch.tensor([1.5, 2.5, 0.0]).expand(1, 3, 3)
    mapped = input_map(torch.zeros(1, 3, 3, 3), alpha, depth, 2.0, 3)
    assert torch.equal(shape_map(alpha, depth, 2.0, 3), mapped[:, 3:])


def test_out_of_sight_looks_like_withheld():
    nothing = input_map(torch.zeros(4, 8, 8, 3), torch.zeros(4, 8, 8), torch.zeros(4, 8, 8), 2.2, 4)
    assert not nothing.any()
