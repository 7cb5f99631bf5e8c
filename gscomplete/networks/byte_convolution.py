"""Convolutions in 8 bits, and the quantised SiLU of a group norm that feeds them (VNNI).

Conventions
-----------
* Weights are bytes with one scale per output channel, as they are stored. The input of a
  convolution is the SiLU of normalised features, in bytes with one step and one zero point per
  call. SiLU is never below ``SILU_MIN``, and its largest value follows from the channels' extremes,
  so nothing is clipped.
* Sums are over integers and therefore exact; features between convolutions are float32. Results do
  not depend on the number of threads: one thread sums all features of an item of the batch.
* Features are [N, C, ...] of two or three dimensions in channels-last memory; kernels see them as
  [N, cells, C].
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gscomplete.util.kernels import HELPER, KERNEL, run_kernel

SILU_MIN = -0.2784645
"""The least value of x * sigmoid(x), at x = -1.278."""
FAST: dict[str, Any] = {"fastmath": {"contract", "nsz", "arcp", "reassoc", "afn"}}
"""Compiler options of kernels whose results are rounded to a byte or to bfloat16 anyway."""
CHANNELS_LAST = {2: torch.channels_last, 3: torch.channels_last_3d}
"""Memory format by the number of spatial dimensions."""
_STEPS = 255.0
_SMALLEST_STEP = 1e-6
"""Least step of the bytes, used if all features are zero."""
_ROWS = 64
"""Cells whose features are summed in float32 before their sums are added in float64."""
_SMALL_FEATURES = 50_000
"""Fewest features for which handing work to another thread saves time."""

# exp(-x) on [0, 16] as the 32nd power of a polynomial on [0, 0.5]; relative error below 2e-6, bytes
# keep 4e-3 of the largest value.
_E = (
    np.polynomial.chebyshev.Chebyshev.interpolate(lambda x: np.exp(-x), 5, domain=[0.0, 0.5])
    .convert(kind=np.polynomial.Polynomial)
    .coef
)
_E0, _E1, _E2, _E3, _E4, _E5 = (np.float32(c) for c in _E)
_LARGEST_POWER = np.float32(16.0)


@numba.njit(**(KERNEL | FAST))
def norm_lines(
    first: int,
    last: int,
    features: Any,  # [N, cells, C] float32
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
    """Compute the scale and shift of every channel of a group norm, and the largest result."""
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


@numba.njit(**(HELPER | FAST))
def exp_neg(power: Any) -> Any:
    """Return exp(-power) in float32 arithmetic; powers above 16 count as 16."""
    x = min(power, _LARGEST_POWER) * np.float32(1.0 / 32.0)
    y = _E0 + x * (_E1 + x * (_E2 + x * (_E3 + x * (_E4 + x * _E5))))
    y *= y
    y *= y
    y *= y
    y *= y
    return y * y


@numba.njit(**(HELPER | FAST))
def _silu(x: Any) -> Any:
    """Return x * sigmoid(x) in float32 arithmetic."""
    y = exp_neg(abs(x))
    above = x if x > np.float32(0.0) else x * y
    return above / (np.float32(1.0) + y)


@numba.njit(**(KERNEL | FAST))
def silu_bytes(
    first: int,
    last: int,
    features: Any,  # [N * cells, C] float32
    cells: int,
    scale: Any,  # [N, C] float32
    shift: Any,  # [N, C] float32
    per_step: Any,  # steps per unit, float32
    zero: Any,  # byte of zero, float32
    out: Any,  # [N * cells, C] uint8, written
) -> None:
    """Write SiLU of scaled and shifted features."""
    for row in range(first, last):
        n = row // cells
        for c in range(features.shape[1]):
            y = _silu(features[row, c] * scale[n, c] + shift[n, c])
            byte = np.int32(y * per_step + zero + np.float32(0.5))
            out[row, c] = np.uint8(min(max(byte, np.int32(0)), np.int32(255)))


def normalised_silu(
    features: Tensor,  # [N, C, ...] float32, channels last, or they are copied so
    norm: nn.GroupNorm,
    film: tuple[Tensor, Tensor] | None = None,
) -> tuple[Tensor, float, int]:
    """Return SiLU of a group norm in bytes.

    Args:
        features: of any size.
        norm: its groups, weight and bias.
        film: factors and terms [N, C] that the normalised features are modulated by; None = none.

    Returns:
        Bytes [N, C, ...], channels last; the value of a step; the byte of zero.
    """
    items, channels = features.shape[:2]
    last = features.movedim(1, -1).contiguous()
    values = last.reshape(items, -1, channels).numpy()
    cells = values.shape[1]
    scale, shift = np.empty((2, items, channels), np.float32)
    tops = np.empty(items)
    if film is None:
        factors, terms = np.ones_like(scale), np.zeros_like(scale)
    else:
        factors, terms = (part.numpy() for part in film)
    run_kernel(
        norm_lines, items, 1 + _SMALL_FEATURES // values[0].size,
        values, norm.weight.detach().numpy(), norm.bias.detach().numpy(), factors, terms,
        norm.num_groups, norm.eps, scale, shift, tops,
    )  # fmt: skip
    top = float(tops.max())
    step = max((top / (1.0 + math.exp(-top)) - SILU_MIN) / _STEPS, _SMALLEST_STEP)
    zero = round(-SILU_MIN / step)
    out = np.empty((items * cells, channels), np.uint8)
    run_kernel(
        silu_bytes, items * cells, 1 + _SMALL_FEATURES // channels,
        values.reshape(-1, channels), cells, scale, shift,
        np.float32(1.0 / step), np.float32(zero), out,
    )  # fmt: skip
    return torch.from_numpy(out).reshape(last.shape).movedim(-1, 1), step, zero


class ByteConvolution:
    """A convolution in 8 bits, 3 cells wide, made from a floating-point convolution."""

    def __init__(self, given: nn.Conv2d | nn.Conv3d) -> None:
        """Quantise the weights, one scale per output channel."""
        weight = given.weight.detach().float()
        dimensions = weight.ndim - 2
        self._ones = [1] * dimensions
        self._convolve = F.conv2d if dimensions == 2 else F.conv3d
        self._multiply = (
            torch.ops.onednn.qconv2d_pointwise
            if dimensions == 2
            else torch.ops.onednn.qconv3d_pointwise
        )
        scale = (weight.flatten(1).abs().amax(dim=1) / 127).clamp(min=2.0**-24)
        wide = scale.reshape(-1, 1, *self._ones)
        rounded = (weight / wide).round_()
        self._scale = scale
        self._zeros = torch.zeros(len(scale), dtype=torch.int64)
        self._bias = None if given.bias is None else given.bias.detach().float()
        self._packed = torch.ops.onednn.qconv_prepack(
            rounded.to(torch.int8), scale, 1.0, 0, self._ones, self._ones, self._ones, 1, None
        )
        self._weight_sums = rounded.sum(dim=1, keepdim=True) * wide
        self._of_ones: dict[tuple[int, ...], Tensor] = {}

    def __call__(self, values: Tensor, step: float, zero: int) -> Tensor:
        """Return float32 features of bytes [N, C, ...] with a step and a zero point."""
        result: Tensor = self._multiply(
            values, step, 0, self._packed, self._scale, self._zeros, self._bias,
            self._ones, self._ones, self._ones, 1, 1.0, 0, torch.float32, "none", [], None,
        )  # fmt: skip
        return result.sub_(self._answer_to_ones(values), alpha=step * zero)

    def _answer_to_ones(self, values: Tensor) -> Tensor:  # [N, C, ...] -> [1, O, ...]
        """Return the convolution of an input of ones, with zeros beyond the border."""
        size = tuple(values.shape[2:])
        if size not in self._of_ones:
            with torch.autocast("cpu", enabled=False):
                answer = self._convolve(torch.ones(1, 1, *size), self._weight_sums, padding=1)
            self._of_ones[size] = answer.contiguous(memory_format=CHANNELS_LAST[len(size)])
        return self._of_ones[size]
