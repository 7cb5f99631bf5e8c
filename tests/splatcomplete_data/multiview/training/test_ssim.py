from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatcomplete_data.multiview.training import ssim


def slow_ssim(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The definition, window by window, in float64."""
    taps = np.exp(-0.5 * ((np.arange(11) - 5) / 1.5) ** 2)
    window = np.outer(taps, taps) / taps.sum() ** 2
    pad = [(5, 5), (5, 5), (0, 0)]
    x, y = np.pad(x.astype(np.float64), pad), np.pad(y.astype(np.float64), pad)
    height, width, channels = x.shape[0] - 10, x.shape[1] - 10, x.shape[2]
    out = np.empty((height, width, channels))
    for row in range(height):
        for column in range(width):
            for c in range(channels):
                a, b = (i[row : row + 11, column : column + 11, c] for i in (x, y))
                ma, mb = (window * a).sum(), (window * b).sum()
                va, vb = (window * a * a).sum() - ma**2, (window * b * b).sum() - mb**2
                cov = (window * a * b).sum() - ma * mb
                top = (2 * ma * mb + 0.01**2) * (2 * cov + 0.03**2)
                out[row, column, c] = top / ((ma**2 + mb**2 + 0.01**2) * (va + vb + 0.03**2))
    return out


def twin(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """The same map through PyTorch's own convolutions and autograd, in float64."""
    taps = ssim.gaussian_window()
    kernel = torch.outer(taps, taps)[None, None]

    def blur(image: torch.Tensor) -> torch.Tensor:
        planes = image.permute(2, 0, 1)[:, None]
        return torch.nn.functional.conv2d(planes, kernel, padding=5)[:, 0].permute(1, 2, 0)

    mx, my = blur(x), blur(y)
    vx, vy, cov = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
    top = (2 * mx * my + ssim.C1) * (2 * cov + ssim.C2)
    return top / ((mx * mx + my * my + ssim.C1) * (vx + vy + ssim.C2))


def pair(seed: int, height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    y = torch.rand(height, width, 3, generator=generator)
    return (y + 0.2 * torch.randn(y.shape, generator=generator)).clamp(0, 1), y


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1000), st.integers(1, 14), st.integers(1, 14))
def test_map_equals_the_definition_at_every_size(seed, height, width):
    x, y = pair(seed, height, width)
    found = ssim.ssim_map(x, ssim.Reference.of(y)).numpy()
    np.testing.assert_allclose(found, slow_ssim(x.numpy(), y.numpy()), atol=2e-5)


@pytest.mark.parametrize(("height", "width"), [(23, 31), (3, 40), (40, 3)])
def test_gradient_equals_float64_autograd(height, width):
    x, y = pair(1, height, width)
    weight = torch.rand(height, width, 3, generator=torch.Generator().manual_seed(2))
    fast = x.clone().requires_grad_()
    (ssim.ssim_map(fast, ssim.Reference.of(y)) * weight).sum().backward()
    slow = x.double().requires_grad_()
    (twin(slow, y.double()) * weight).sum().backward()
    assert fast.grad is not None
    assert slow.grad is not None
    error = (fast.grad - slow.grad).norm() / slow.grad.norm()
    # Cancellation in E[x^2] - E[x]^2 at float32 leaves about 1e-5 of the largest terms.
    assert error < 1e-4


def test_convolution_path_of_other_devices_draws_the_same_blur():
    image = torch.rand(20, 17, 3, generator=torch.Generator().manual_seed(3))
    torch.testing.assert_close(ssim._blur_by_convolution(image), ssim.blur(image))


def test_terms_of_other_devices_equal_the_fused_kernel():
    x, y = pair(4, 12, 15)
    reference = ssim.Reference.of(y)
    terms = ssim._terms(ssim.blur(x), ssim.blur(x * x), ssim.blur(x * y), reference)
    torch.testing.assert_close(terms[0], ssim.ssim_map(x, reference), atol=1e-5, rtol=1e-4)


def test_equal_images_are_perfectly_similar_and_pull_nowhere():
    _, y = pair(5, 16, 16)
    x = y.clone().requires_grad_()
    value = ssim.ssim_map(x, ssim.Reference.of(y))
    torch.testing.assert_close(value, torch.ones_like(value), atol=1e-5, rtol=0)
    value.mean().backward()
    assert x.grad is not None
    assert x.grad.abs().max() < 1e-5


def test_flat_black_and_white_images_give_finite_values():
    for a, b in ((0.0, 0.0), (0.0, 1.0), (1.0, 1.0)):
        x = torch.full((9, 9, 3), a, requires_grad=True)
        value = ssim.ssim_map(x, ssim.Reference.of(torch.full((9, 9, 3), b)))
        value.sum().backward()
        assert value.isfinite().all()
        assert x.grad is not None
        assert x.grad.isfinite().all()


def test_other_shapes_are_refused():
    with pytest.raises(ValueError, match="expected shape"):
        ssim.ssim_map(torch.zeros(4, 5, 3), ssim.Reference.of(torch.zeros(5, 4, 3)))
