"""The denoiser for processors that multiply bytes in hardware (VNNI): convolutions in 8 bits.

Conventions
-----------
* Convolutions of residual blocks and of P's symmetric copies are of bytes, everything else is in
  bfloat16, as autocast has it; answers are about twice as far from float32's as bfloat16's are.
* Weights are bytes of one scale per output channel, as they are stored. What a convolution sees is
  SiLU of normalised features, in bytes of one step and one zero point per call: SiLU is never below
  ``SILU_MIN``, and its largest value follows from the channels' extremes, so nothing is clipped.
* Sums are of integers, hence exact; features between convolutions are float32. Results do not
  depend on threads: one thread adds up all features of a view.
* Features are [N, C, h, w] in channels-last memory; kernels see them as [N, hw, C].
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gscomplete.priors.embedded.model import (
    CopiesConvolution,
    FourViewDenoiser,
    JointTransformer,
    Level,
    ResidualBlock,
    TextEncoder,
    symmetric_copies,
)
from gscomplete.util.kernels import HELPER, KERNEL, run_kernel

SILU_MIN = -0.2784645
"""The least value of x * sigmoid(x), at x = -1.278."""
_STEPS = 255.0
_SMALLEST_STEP = 1e-6
"""Of features that are zero everywhere."""
_MAP_ZERO = 127.0
"""The byte of zero, and steps per unit, of P's map in [-1, 1]: P out of sight is zero exactly."""
_ROWS = 64
"""Pixels whose features are added up in float32 before their sums are added in float64."""
_SMALL_FEATURES = 50_000
"""Features that handing to another thread takes the time of."""
_GRAIN = 256
"""Rows of scores, likewise."""
_LANES = 16
"""Maxima that are kept side by side: LLVM does not vectorise a single one."""

_FAST: dict[str, Any] = {"fastmath": {"contract", "nsz", "arcp", "reassoc", "afn"}}

# exp(-x) on [0, 16] as the 32nd power of a polynomial on [0, 0.5]; relative error below 2e-6, bytes
# keep 4e-3 of the largest value.
_E = (
    np.polynomial.chebyshev.Chebyshev.interpolate(lambda x: np.exp(-x), 5, domain=[0.0, 0.5])
    .convert(kind=np.polynomial.Polynomial)
    .coef
)
_E0, _E1, _E2, _E3, _E4, _E5 = (np.float32(c) for c in _E)
_LARGEST_POWER = np.float32(16.0)


@numba.njit(**(KERNEL | _FAST))
def _norm_lines(
    first: int,
    last: int,
    features: Any,  # [N, hw, C] float32
    weight: Any,  # [C] float32, and so the bias
    bias: Any,
    factors: Any,  # [N, C] float32, and so the terms: what modulates the normalised features
    terms: Any,
    groups: int,
    eps: float,
    scale: Any,  # [N, C] float32, written, and so the shift: the norm and the modulation in one
    shift: Any,
    tops: Any,  # [N] float64, written: the largest feature after them, at least 0
) -> None:
    """Find the factor and the term of every channel of a group norm, and what they reach."""
    count, channels = features.shape[1], features.shape[2]
    width = channels // groups
    part = np.empty((2, channels), np.float32)
    extremes = np.empty((2, channels), np.float32)
    sums = np.empty((2, channels))
    for n in range(first, last):
        sums[:] = 0.0
        for c in range(channels):
            extremes[0, c] = features[n, 0, c]
            extremes[1, c] = features[n, 0, c]
        for start in range(0, count, _ROWS):
            for c in range(channels):
                part[0, c] = np.float32(0.0)
                part[1, c] = np.float32(0.0)
            for p in range(start, min(start + _ROWS, count)):
                for c in range(channels):
                    value = features[n, p, c]
                    part[0, c] += value
                    part[1, c] += value * value
                    extremes[0, c] = min(extremes[0, c], value)
                    extremes[1, c] = max(extremes[1, c], value)
            for c in range(channels):
                sums[0, c] += part[0, c]
                sums[1, c] += part[1, c]
        tops[n] = 0.0
        for group in range(groups):
            mean, square = 0.0, 0.0
            for c in range(group * width, (group + 1) * width):
                mean += sums[0, c]
                square += sums[1, c]
            mean /= width * count
            inverse = 1.0 / math.sqrt(max(square / (width * count) - mean * mean, 0.0) + eps)
            for c in range(group * width, (group + 1) * width):
                factor = inverse * weight[c] * factors[n, c]
                term = (bias[c] - mean * inverse * weight[c]) * factors[n, c] + terms[n, c]
                scale[n, c] = factor
                shift[n, c] = term
                tops[n] = max(tops[n], extremes[0, c] * factor + term)
                tops[n] = max(tops[n], extremes[1, c] * factor + term)


@numba.njit(**(HELPER | _FAST))
def _exp_neg(power: Any) -> Any:
    """Return exp(-power) in float32 arithmetic; powers above 16 count as 16."""
    x = min(power, _LARGEST_POWER) * np.float32(1.0 / 32.0)
    y = _E0 + x * (_E1 + x * (_E2 + x * (_E3 + x * (_E4 + x * _E5))))
    y *= y
    y *= y
    y *= y
    y *= y
    return y * y


@numba.njit(**(HELPER | _FAST))
def _silu(x: Any) -> Any:
    """Return x * sigmoid(x) in float32 arithmetic."""
    y = _exp_neg(abs(x))
    above = x if x > np.float32(0.0) else x * y
    return above / (np.float32(1.0) + y)


@numba.njit(**(KERNEL | _FAST))
def _silu_bytes(
    first: int,
    last: int,
    features: Any,  # [N, hw, C] float32
    scale: Any,  # [N, C] float32
    shift: Any,  # [N, C] float32
    per_step: Any,  # steps per unit, float32
    zero: Any,  # byte of zero, float32
    out: Any,  # [N, hw, C] uint8, written
) -> None:
    """Write SiLU of scaled and shifted features."""
    for n in range(first, last):
        for p in range(features.shape[1]):
            for c in range(features.shape[2]):
                y = _silu(features[n, p, c] * scale[n, c] + shift[n, c])
                byte = np.int32(y * per_step + zero + np.float32(0.5))
                out[n, p, c] = np.uint8(min(max(byte, np.int32(0)), np.int32(255)))


def normalised_silu(
    features: Tensor,  # [N, C, h, w] float32, channels last
    norm: nn.GroupNorm,
    film: tuple[Tensor, Tensor] | None = None,
) -> tuple[Tensor, float, int]:
    """Return SiLU of a group norm in bytes.

    Args:
        features: of any size.
        norm: its groups, weight and bias.
        film: factors and terms [N, C] that the normalised features are modulated by; None = none.

    Returns:
        Bytes [N, C, h, w], channels last; the value of a step; the byte of zero.
    """
    views, channels, height, width = features.shape
    values = features.permute(0, 2, 3, 1).reshape(views, height * width, channels).numpy()
    scale, shift = np.empty((2, views, channels), np.float32)
    tops = np.empty(views)
    if film is None:
        factors, terms = np.ones_like(scale), np.zeros_like(scale)
    else:
        factors, terms = (part.numpy() for part in film)
    grain = 1 + _SMALL_FEATURES // values[0].size
    run_kernel(
        _norm_lines, views, grain, values, norm.weight.numpy(), norm.bias.numpy(), factors, terms,
        norm.num_groups, norm.eps, scale, shift, tops,
    )  # fmt: skip
    top = float(tops.max())
    step = max((top / (1.0 + math.exp(-top)) - SILU_MIN) / _STEPS, _SMALLEST_STEP)
    zero = round(-SILU_MIN / step)
    out = np.empty(values.shape, np.uint8)
    run_kernel(
        _silu_bytes, views, grain, values, scale, shift,
        np.float32(1.0 / step), np.float32(zero), out,
    )  # fmt: skip
    stored = torch.from_numpy(out).reshape(views, height, width, channels)
    return stored.permute(0, 3, 1, 2), step, zero


class ByteConvolution:
    """A 3 x 3 convolution of bytes with the weights of one of floats."""

    def __init__(self, given: nn.Conv2d) -> None:
        """Quantise the weights, one scale per output channel."""
        weight = given.weight.detach().float()
        scale = (weight.flatten(1).abs().amax(dim=1) / 127).clamp(min=2.0**-24)
        weight_bytes = (weight / scale[:, None, None, None]).round().to(torch.int8)
        self._scale = scale
        self._zeros = torch.zeros(len(scale), dtype=torch.int64)
        self._bias = None if given.bias is None else given.bias.detach().float()
        self._packed = torch.ops.onednn.qconv_prepack(
            weight_bytes, scale, 1.0, 0, [1, 1], [1, 1], [1, 1], 1, None
        )
        self._weight_sums = (
            weight_bytes.float().sum(dim=1, keepdim=True) * scale[:, None, None, None]
        )
        self._of_ones: dict[tuple[int, int], Tensor] = {}

    def __call__(self, values: Tensor, step: float, zero: int) -> Tensor:
        """Return float32 features of bytes [N, C, h, w] with a step and a zero point."""
        result: Tensor = torch.ops.onednn.qconv2d_pointwise(
            values, step, 0, self._packed, self._scale, self._zeros, self._bias,
            [1, 1], [1, 1], [1, 1], 1, 1.0, 0, torch.float32, "none", [], None,
        )  # fmt: skip
        return result.sub_(self._answer_to_ones(values), alpha=step * zero)

    def _answer_to_ones(self, values: Tensor) -> Tensor:  # [N, C, h, w] -> [1, O, h, w]
        """Return what the weights make of ones: beyond the border there are none."""
        height, width = values.shape[2:]
        if (height, width) not in self._of_ones:
            with torch.autocast("cpu", enabled=False):
                answer = F.conv2d(torch.ones(1, 1, height, width), self._weight_sums, padding=1)
            self._of_ones[height, width] = answer.contiguous(memory_format=torch.channels_last)
        return self._of_ones[height, width]


class ByteBlock(nn.Module):
    """A residual block whose convolutions are of bytes."""

    def __init__(self, block: ResidualBlock) -> None:
        super().__init__()
        self.norm_in, self.norm_out, self.film = block.norm_in, block.norm_out, block.film
        self._conv_in = ByteConvolution(block.conv_in)
        self._conv_out = ByteConvolution(block.conv_out)

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:  # [4B, C, h, w], [4B, E]
        """Return the features after the block, float32."""
        x = x.float()
        scale, shift = self.film(embedding).float().chunk(2, dim=1)
        h = self._conv_in(*normalised_silu(x, self.norm_in))
        h = self._conv_out(*normalised_silu(h, self.norm_out, (1 + scale, shift.contiguous())))
        return h.add_(x)


class ByteCopies(nn.Module):
    """The convolution of symmetric copies, of bytes: P's map is within [-1, 1]."""

    def __init__(self, given: CopiesConvolution) -> None:
        super().__init__()
        self._convolution = ByteConvolution(given)

    def forward(self, cells: Tensor) -> Tensor:  # [B, 4, 20, s, s] -> [4B, C, s, s]
        """Return the features, float32."""
        values = (cells.float() * _MAP_ZERO + (_MAP_ZERO + 0.5)).to(torch.uint8)
        copies = symmetric_copies(values).flatten(0, 1)
        return self._convolution(copies, 1 / _MAP_ZERO, int(_MAP_ZERO))


class RememberedText(nn.Module):
    """A text encoder that keeps its last answer: a run asks with the same words at every step."""

    def __init__(self, encoder: TextEncoder) -> None:
        super().__init__()
        self._encoder = encoder
        self._tokens = torch.empty(0)
        self._answer: tuple[Tensor, Tensor, Tensor] | None = None

    def forward(self, tokens: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Encode token ids [B, L]; see :class:`TextEncoder`."""
        if self._answer is None or not torch.equal(self._tokens, tokens):
            self._answer, self._tokens = self._encoder(tokens), tokens.clone()
        return self._answer


@numba.njit(**(KERNEL | _FAST))
def _softmax_rows(
    first: int,
    last: int,
    scores: Any,  # [R, K] uint16, the upper halves of float32; replaced by their softmax
    scale: Any,  # of scores, float32
) -> None:
    """Replace rows of bfloat16 by their softmax."""
    count = scores.shape[1]
    words = np.empty(count, np.uint32)
    values = words.view(np.float32)
    peaks = np.empty(_LANES, np.float32)
    for r in range(first, last):
        for k in range(count):
            words[k] = np.uint32(scores[r, k]) << np.uint32(16)
        for j in range(_LANES):
            peaks[j] = values[0]
        for start in range(0, count - _LANES + 1, _LANES):
            for j in range(_LANES):
                peaks[j] = max(peaks[j], values[start + j])
        for k in range(count // _LANES * _LANES, count):
            peaks[0] = max(peaks[0], values[k])
        largest = peaks.max()
        total = np.float32(0.0)
        for k in range(count):
            value = _exp_neg((largest - values[k]) * scale)
            values[k] = value
            total += value
        inverse = np.float32(1.0) / total
        for k in range(count):
            values[k] *= inverse
        for k in range(count):
            scores[r, k] = np.uint16((words[k] + np.uint32(0x8000)) >> np.uint32(16))


def attention(query: Tensor, key: Tensor, value: Tensor, mask: Tensor | None) -> Tensor:
    """Return scaled dot product attention in bfloat16, in a third of the time of PyTorch's.

    Args:
        query: [B, H, Q, D] bfloat16.
        key: [B, H, K, D] bfloat16.
        value: [B, H, K, D] bfloat16.
        mask: as PyTorch's operation has it, which then does the work; None = all keys.

    Returns:
        [B, H, Q, D].
    """
    if mask is not None:
        return F.scaled_dot_product_attention(query, key, value, mask)
    scores = query @ key.transpose(-1, -2)
    rows = scores.view(torch.int16).numpy().view(np.uint16).reshape(-1, scores.shape[-1])
    run_kernel(_softmax_rows, len(rows), _GRAIN, rows, np.float32(query.shape[-1] ** -0.5))
    return scores @ value


def in_bytes(model: FourViewDenoiser) -> FourViewDenoiser:
    """Put a denoiser into 8 bits and bfloat16, in place; autocast has to be on when it is asked."""
    model.requires_grad_(False)
    model.add_module("text", RememberedText(model.text))
    model.add_module("symmetries", ByteCopies(model.symmetries))
    for module in list(model.modules()):
        if isinstance(module, Level):
            blocks = [block for block in module.blocks if isinstance(block, ResidualBlock)]
            module.blocks = nn.ModuleList(ByteBlock(block) for block in blocks)
        elif isinstance(module, JointTransformer):
            module.mix = attention
    for name, module in model.named_modules():
        if isinstance(module, nn.Linear | nn.Conv2d) and not name.startswith("text"):
            module.to(torch.bfloat16)
    return model
