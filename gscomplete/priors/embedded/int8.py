"""The denoiser with 8-bit convolutions, for processors that multiply bytes in hardware.

Conventions
-----------
* The convolutions of residual blocks and of P's symmetric copies run in 8 bits
  (``networks.byte_convolution``). Everything else runs in bfloat16 under autocast, or in float32 if
  the processor does not multiply bfloat16. Answers differ from float32's about twice as much as
  those of bfloat16 do.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gscomplete.networks.byte_convolution import FAST, ByteConvolution, exp_neg, normalised_silu
from gscomplete.priors.embedded.model import (
    CopiesConvolution,
    FourViewDenoiser,
    JointTransformer,
    Level,
    ResidualBlock,
    TextEncoder,
    symmetric_copies,
)
from gscomplete.util.kernels import KERNEL, run_kernel

_MAP_ZERO = 127.0
"""Zero point, and steps per unit, of P's map in [-1, 1] in bytes, so that 0 (no P) is exact."""
_GRAIN = 256
"""Fewest rows of scores for which handing work to another thread saves time."""
_LANES = 16
"""Maxima that are kept side by side, because LLVM does not vectorise a single one."""


class ByteBlock(nn.Module):
    """A residual block whose convolutions run in 8 bits."""

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
    """The convolution of P's symmetric copies in 8 bits; P's map is within [-1, 1]."""

    def __init__(self, given: CopiesConvolution) -> None:
        super().__init__()
        self._convolution = ByteConvolution(given)

    def forward(self, cells: Tensor) -> Tensor:  # [B, 4, 20, s, s] -> [4B, C, s, s]
        """Return the features, float32."""
        values = (cells.float() * _MAP_ZERO + (_MAP_ZERO + 0.5)).to(torch.uint8)
        copies = symmetric_copies(values).flatten(0, 1)
        return self._convolution(copies, 1 / _MAP_ZERO, int(_MAP_ZERO))


class RememberedText(nn.Module):
    """A text encoder that caches its last answer: all steps of a run have the same words."""

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


@numba.njit(**(KERNEL | FAST))
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
            value = exp_neg((largest - values[k]) * scale)
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
        mask: as for PyTorch's operation, which is called if there is one; None = all keys.

    Returns:
        [B, H, Q, D].
    """
    if mask is not None:
        return F.scaled_dot_product_attention(query, key, value, mask)
    scores = query @ key.transpose(-1, -2)
    rows = scores.view(torch.int16).numpy().view(np.uint16).reshape(-1, scores.shape[-1])
    run_kernel(_softmax_rows, len(rows), _GRAIN, rows, np.float32(query.shape[-1] ** -0.5))
    return scores @ value


def in_bytes(model: FourViewDenoiser, *, bfloat16: bool) -> FourViewDenoiser:
    """Put a denoiser into 8 bits, in place.

    Args:
        model: the denoiser.
        bfloat16: whether the rest is put into bfloat16, which needs autocast when the network is
            called; otherwise the rest stays in float32.
    """
    model.requires_grad_(False)
    model.add_module("text", RememberedText(model.text))
    model.add_module("symmetries", ByteCopies(model.symmetries))
    for module in list(model.modules()):
        if isinstance(module, Level):
            blocks = [block for block in module.blocks if isinstance(block, ResidualBlock)]
            module.blocks = nn.ModuleList(ByteBlock(block) for block in blocks)
        elif isinstance(module, JointTransformer) and bfloat16:
            module.mix = attention
    if not bfloat16:
        return model
    for name, module in model.named_modules():
        if isinstance(module, nn.Linear | nn.Conv2d) and not name.startswith("text"):
            module.to(torch.bfloat16)
    return model
