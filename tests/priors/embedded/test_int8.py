"""Blocks in 8 bits against float64 twins of what they compute."""

import numba
import pytest
import torch
import torch.nn.functional as F
from torch import nn

from gscomplete.priors.embedded.int8 import (
    ByteConvolution,
    ByteCopies,
    attention,
    in_bytes,
    normalised_silu,
)
from gscomplete.priors.embedded.model import CopiesConvolution, fold_cells, symmetric_copies
from gscomplete.priors.embedded.precision import multiplies_bytes
from gscomplete.priors.embedded.prior import packaged_weights
from gscomplete.priors.embedded.weights import read_weights
from tests.builders.tiny_denoiser import tiny_model
from tests.priors.embedded.test_model import inputs

pytestmark = pytest.mark.skipif(
    not multiplies_bytes(), reason="the processor does not multiply bytes itself"
)
CHANNELS_LAST = torch.channels_last


def features(*shape, seed=0):
    g = torch.Generator().manual_seed(seed)
    offsets = 3 * torch.randn(shape[1], 1, 1, generator=g)
    return (torch.randn(shape, generator=g) + offsets).contiguous(memory_format=CHANNELS_LAST)


@pytest.mark.parametrize("modulated", [False, True])
@pytest.mark.parametrize("shape", [(4, 16, 8, 8), (4, 64, 16, 16), (8, 48, 5, 3)])
def test_normalised_features_are_within_half_a_step(shape, modulated):
    x, norm = features(*shape), nn.GroupNorm(4, shape[1]).requires_grad_(False)
    norm.weight.uniform_(0.5, 2.0)
    norm.bias.uniform_(-1.0, 1.0)
    film = None
    twin = F.group_norm(x.double(), 4, norm.weight.double(), norm.bias.double())
    if modulated:
        film = torch.rand(shape[:2]) - 0.3, torch.randn(shape[:2])
        twin = twin * film[0].double()[..., None, None] + film[1].double()[..., None, None]
    values, step, zero = normalised_silu(x, norm, film)
    assert values.is_contiguous(memory_format=CHANNELS_LAST)
    error = (values.double() - zero) * step - F.silu(twin)
    # half a step for a value's rounding; sums, exponentials and zero's rounding in float32
    assert float(error.abs().max()) <= 0.51 * step
    assert step <= 1.01 * float(F.silu(twin).max() + 0.2785) / 255


def test_features_of_zeros_and_of_one_large_value_are_kept():
    norm = nn.GroupNorm(1, 4, affine=True).requires_grad_(False)
    values, step, zero = normalised_silu(torch.zeros(1, 4, 4, 4), norm)
    assert float(((values.double() - zero) * step).abs().max()) <= step
    spike = torch.zeros(1, 4, 4, 4).contiguous(memory_format=CHANNELS_LAST)
    spike[0, 2, 1, 1] = 1e6
    values, step, zero = normalised_silu(spike, norm)
    assert values.max() == 255
    assert abs((255 - zero) * step - float(F.group_norm(spike.double(), 1).max())) < 0.51 * step


@pytest.mark.parametrize("zero", [0, 9, 127])
def test_a_convolution_of_bytes_is_that_of_what_they_stand_for(zero):
    given = nn.Conv2d(20, 24, 3, padding=1).requires_grad_(False)
    codes = torch.randint(-127, 128, given.weight.shape)
    codes[:, 0, 0, 0] = 127
    scales = torch.rand(24, 1, 1, 1) / 127
    given.weight.copy_(codes * scales)
    values = torch.randint(0, 256, (4, 20, 7, 7), dtype=torch.uint8)
    answer = ByteConvolution(given)(values.contiguous(memory_format=CHANNELS_LAST), 0.01, zero)
    meant = (values.double() - zero) * 0.01
    expected = F.conv2d(meant, (codes * scales).double(), given.bias.double(), padding=1)
    # sums of integers are exact; their scaling is in float32
    torch.testing.assert_close(answer.double(), expected, rtol=1e-5, atol=1e-5)


def test_copies_are_shown_in_steps_of_a_127th():
    given = CopiesConvolution(16).requires_grad_(False)
    given.weight.normal_()
    cells = fold_cells(torch.rand(1, 4, 5, 16, 16) * 2 - 1)
    expected = F.conv2d(symmetric_copies(cells).flatten(0, 1), given.weight, padding=1)
    error = (ByteCopies(given)(cells) - expected).square().mean().sqrt()
    assert float(error / expected.std()) < 0.02  # of weights and of values, each about a 1/127


@pytest.mark.parametrize("keys", [7, 16, 64, 100])
def test_attention_is_that_of_float64(keys):
    query, key, value = (torch.randn(1, 3, n, 32).bfloat16() for n in (50, keys, keys))
    expected = F.scaled_dot_product_attention(query.double(), key.double(), value.double())
    found = attention(query, key, value, None)
    plain = F.scaled_dot_product_attention(query, key, value)
    assert found.dtype == torch.bfloat16

    def distance(answer):
        return float((answer.double() - expected).square().mean().sqrt())

    # scores are rounded to 8 bits, which the operation of PyTorch does not do
    assert distance(found) <= 3 * distance(plain)


@torch.no_grad()
def test_the_packaged_denoiser_in_bytes_is_close_to_float32():
    g = torch.Generator().manual_seed(3)
    noisy, seen = torch.randn(1, 4, 4, 64, 64, generator=g), torch.zeros(1, 4, 5, 64, 64)
    seen[..., 16:48, 16:48] = torch.rand(1, 4, 5, 32, 32, generator=g)
    shape = seen[:, :, 3:]
    ring, tokens = torch.tensor([[20.0, 2.3, 40.0]]), torch.tensor([[40, 60, 0, 0]])
    stored = read_weights(packaged_weights())
    plain, fast = stored.denoiser(), in_bytes(stored.denoiser())
    for timestep in (150.0, 800.0):
        given = noisy, seen, shape, torch.tensor([timestep]), ring, tokens
        expected = plain(*given)
        with torch.autocast("cpu", torch.bfloat16):
            error = fast(*given) - expected
        # measured: 0.007 to 0.012 (bfloat16: 0.005)
        assert float(error.square().mean().sqrt() / expected.std()) < 0.02


@torch.no_grad()
def test_bytes_do_not_depend_on_threads_or_on_what_was_asked_before():
    given, fast = inputs(), in_bytes(tiny_model())
    threads = torch.get_num_threads(), numba.get_num_threads()
    answers = []
    try:
        for count in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            torch.set_num_threads(count)
            numba.set_num_threads(count)
            with torch.autocast("cpu", torch.bfloat16):
                answers.append(fast(*given))
                other = fast(*given[:5], given[5].flip(0))
        assert torch.equal(answers[0], answers[1])
        assert not torch.equal(answers[0], other)
    finally:
        torch.set_num_threads(threads[0])
        numba.set_num_threads(threads[1])
