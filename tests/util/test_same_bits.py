import numpy as np
import pytest
import torch

from gscomplete.util.same_bits import (
    GroupNorm,
    Linear,
    fixed_mean,
    fixed_power,
    fixed_sigmoid,
    fixed_silu,
    fixed_softmax,
    fixed_sum,
)

THREADS = (1, 2, 3, 4, 5, 7, 11)
"""Divisors of the sizes below, and numbers that are none."""


@pytest.fixture(autouse=True)
def _threads_as_before():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def bits_with_each_number_of_threads(operation) -> set[bytes]:
    found = set()
    for threads in THREADS:
        torch.set_num_threads(threads)
        found.add(operation().contiguous().numpy().tobytes())
        assert torch.get_num_threads() == threads
    return found


def numbers(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(3))


# sizes that PyTorch divides among threads at places that are no multiple of a vector's length
@pytest.mark.parametrize("count", [40_299, 1_000_003])
def test_bits_do_not_depend_on_threads(count):
    values = numbers(count)
    operations = {
        "sum": lambda: fixed_sum(values),
        "mean": lambda: fixed_mean(values),
        "sigmoid": lambda: fixed_sigmoid(8 * values - 4),
        "silu": lambda: fixed_silu(8 * values - 4),
        "softmax": lambda: fixed_softmax((8 * values - 4)[: count // 7 * 7].reshape(7, -1), dim=0),
        "power": lambda: fixed_power(values, 1 / 3),
    }
    for name, operation in operations.items():
        assert len(bits_with_each_number_of_threads(operation)) == 1, name


def test_pytorchs_own_do_depend_on_threads():
    """What ``same_bits`` is for; where this fails, PyTorch has been mended."""
    values = numbers(1_000_003)
    assert len(bits_with_each_number_of_threads(values.sum)) > 1
    assert len(bits_with_each_number_of_threads((8 * values - 4).sigmoid)) > 1


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_group_norm_of_channels_last_features(dtype):
    features = numbers(1, 32, 24, 24, 24).to(memory_format=torch.channels_last_3d)
    norm = GroupNorm(8, 32)

    def normalised() -> torch.Tensor:
        with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=dtype != torch.float32):
            return norm(features.to(dtype)).float()

    assert len(bits_with_each_number_of_threads(normalised)) == 1
    groups = features.to(dtype).double().numpy().reshape(8, -1)
    spread = np.sqrt(groups.var(axis=1, keepdims=True) + norm.eps)
    expected = (groups - groups.mean(axis=1, keepdims=True)) / spread
    # bfloat16 keeps 8 bits: values of up to 2 are rounded by up to 2**-8
    tolerance = 1e-5 if dtype == torch.float32 else 2**-7
    np.testing.assert_allclose(normalised().numpy().reshape(8, -1), expected, atol=tolerance)


def test_long_products_of_few_outputs():
    """Tile processors split the sums of 960 terms over threads in a plain linear layer."""
    rows, layer = numbers(1, 256, 960), Linear(960, 320)

    def product() -> torch.Tensor:
        with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
            return layer(rows).float()

    assert len(bits_with_each_number_of_threads(product)) == 1
    weight, bias = layer.weight.bfloat16().double(), layer.bias.double()
    expected = (rows.bfloat16().double() @ weight.T + bias).detach()
    # one rounding of the result to 8 bits, and one of the bias
    torch.testing.assert_close(product().double(), expected, rtol=2**-7, atol=2**-8)


@pytest.mark.parametrize("shape", [(), (0,), (7,), (4096,), (4097,), (3, 50, 1001)])
def test_sums_and_their_gradients_are_right(shape):
    values = torch.rand(shape, generator=torch.Generator().manual_seed(3)).requires_grad_()
    total = fixed_sum(values)
    # float32 sums of n terms err by a few 2**-24 of the sum
    assert total.item() == pytest.approx(values.detach().double().sum().item(), rel=1e-6)
    total.backward()
    assert bool((values.grad == 1).all())
    if values.numel():
        assert fixed_mean(values).item() == pytest.approx(values.double().mean().item(), rel=1e-6)


def test_sigmoid_and_power_are_right():
    values = numbers(50_000).double().requires_grad_()
    sigmoid = 1 / (1 + np.exp(-values.detach().numpy()))
    torch.testing.assert_close(fixed_sigmoid(values).detach(), torch.from_numpy(sigmoid))
    (slope,) = torch.autograd.grad(fixed_sigmoid(values).sum(), values)
    torch.testing.assert_close(slope, torch.from_numpy(sigmoid * (1 - sigmoid)))
    power = np.power(values.detach().numpy(), 2.4)
    torch.testing.assert_close(fixed_power(values, 2.4).detach(), torch.from_numpy(power))
