"""Convolutions of bytes against float64 twins of what they compute."""

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from gscomplete.networks.byte_convolution import CHANNELS_LAST, ByteConvolution, normalised_silu
from gscomplete.networks.precision import multiplies_bytes

pytestmark = pytest.mark.skipif(
    not multiplies_bytes(), reason="the processor does not multiply bytes itself"
)
CONVOLUTIONS = {2: (nn.Conv2d, F.conv2d), 3: (nn.Conv3d, F.conv3d)}


def features(*shape, seed=0):
    g = torch.Generator().manual_seed(seed)
    offsets = 3 * torch.randn(shape[1], *[1] * (len(shape) - 2), generator=g)
    memory = CHANNELS_LAST[len(shape) - 2]
    return (torch.randn(shape, generator=g) + offsets).contiguous(memory_format=memory)


@pytest.mark.parametrize("modulated", [False, True])
@pytest.mark.parametrize(
    "shape", [(4, 16, 8, 8), (4, 64, 16, 16), (8, 48, 5, 3), (1, 32, 24, 24, 24), (2, 8, 3, 5, 4)]
)
def test_normalised_features_are_within_half_a_step(shape, modulated):
    x, norm = features(*shape), nn.GroupNorm(4, shape[1]).requires_grad_(False)
    norm.weight.uniform_(0.5, 2.0)
    norm.bias.uniform_(-1.0, 1.0)
    film = None
    twin = F.group_norm(x.double(), 4, norm.weight.double(), norm.bias.double())
    if modulated:
        film = torch.rand(shape[:2]) - 0.3, torch.randn(shape[:2])
        factor, term = (part.double().reshape(*shape[:2], *[1] * (x.ndim - 2)) for part in film)
        twin = twin * factor + term
    values, step, zero = normalised_silu(x, norm, film)
    assert values.is_contiguous(memory_format=CHANNELS_LAST[x.ndim - 2])
    error = (values.double() - zero) * step - F.silu(twin)
    # half a step for a value's rounding; sums, exponentials and zero's rounding in float32
    assert float(error.abs().max()) <= 0.51 * step
    assert step <= 1.01 * float(F.silu(twin).max() + 0.2785) / 255


def test_features_of_zeros_and_of_one_large_value_are_kept():
    norm = nn.GroupNorm(1, 4, affine=True).requires_grad_(False)
    values, step, zero = normalised_silu(torch.zeros(1, 4, 4, 4), norm)
    assert float(((values.double() - zero) * step).abs().max()) <= step
    spike = torch.zeros(1, 4, 4, 4).contiguous(memory_format=CHANNELS_LAST[2])
    spike[0, 2, 1, 1] = 1e6
    values, step, zero = normalised_silu(spike, norm)
    assert values.max() == 255
    assert abs((255 - zero) * step - float(F.group_norm(spike.double(), 1).max())) < 0.51 * step


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("zero", [0, 9, 127])
def test_a_convolution_of_bytes_is_that_of_what_they_stand_for(zero, dimensions):
    make, convolve = CONVOLUTIONS[dimensions]
    given = make(20, 24, 3, padding=1).requires_grad_(False)
    codes = torch.randint(-127, 128, given.weight.shape)
    codes.flatten(1)[:, 0] = 127
    weight = codes * (torch.rand(24, *[1] * (dimensions + 1)) / 127)
    given.weight.copy_(weight)
    values = torch.randint(0, 256, (4, 20, *[7] * dimensions), dtype=torch.uint8)
    shown = values.contiguous(memory_format=CHANNELS_LAST[dimensions])
    answer = ByteConvolution(given)(shown, 0.01, zero)
    meant = (values.double() - zero) * 0.01
    expected = convolve(meant, weight.double(), given.bias.double(), padding=1)
    # sums of integers are exact; their scaling is in float32
    torch.testing.assert_close(answer.double(), expected, rtol=1e-5, atol=1e-5)


def test_features_in_any_order_of_memory_give_the_same_bytes():
    x, norm = features(2, 16, 6, 5, 4), nn.GroupNorm(4, 16).requires_grad_(False)
    (one, *steps), (other, *again) = (normalised_silu(y, norm) for y in (x, x.contiguous()))
    assert torch.equal(one, other)
    assert steps == again
