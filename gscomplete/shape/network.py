"""The shape network: a three-dimensional U-Net from P's voxels to the complete object's.

It predicts for each fine cell whether the object fills it (it is solid, or a thin wall passes it),
and for each coarse cell where its colour comes from: from P nearby, from one of P's mirror images,
or from a colour of the network's own. So it continues patterns by pointing at them rather than by
painting them. Occupancy works likewise: what P or a mirror image fills is added to the logits,
weighted by how much the coarse cell trusts that source.

Conventions
-----------
* The body works on coarse cells; 2 x 2 x 2 fine cells are folded into channels at both ends.
* Sources of colour, in this order: P, the mirror images, free.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gscomplete.shape.symmetry import COPIES, SOURCES
from gscomplete.util.same_bits import GroupNorm, fixed_sigmoid, fixed_silu

Network = TypeVar("Network", bound=nn.Module)
_FOLD = 2
_EVIDENCE = 3
_POSITION = 3


@dataclass(frozen=True, slots=True)
class ShapeModelConfig:
    """Sizes of the network."""

    vocabulary_size: int
    widths: tuple[int, int, int] = (32, 96, 192)
    blocks: tuple[int, int, int] = (1, 1, 2)
    embedding: int = 128
    groups: int = 8


@dataclass(frozen=True, slots=True)
class ShapeOutput:
    """What the network says of every cell."""

    occupancy: Tensor  # [B, C, C, C] logits
    colors: Tensor  # [B, 3, C/2, C/2, C/2] of the network's own, in [0, 1]
    sources: Tensor  # [B, SOURCES + 1, C/2, C/2, C/2] logits


class ResidualBlock(nn.Module):
    """Two convolutions with scale and shift from the prompt between them."""

    def __init__(self, width: int, config: ShapeModelConfig) -> None:
        super().__init__()
        self.norm_in = GroupNorm(config.groups, width)
        self.conv_in = nn.Conv3d(width, width, 3, padding=1)
        self.norm_out = GroupNorm(config.groups, width)
        self.conv_out = nn.Conv3d(width, width, 3, padding=1)
        self.modulation = nn.Linear(config.embedding, 2 * width)
        nn.init.zeros_(self.conv_out.weight)
        nn.init.zeros_(self.conv_out.bias)  # type: ignore[arg-type]
        nn.init.zeros_(self.modulation.weight)

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:  # [B, C, n, n, n], [B, E]
        """Return the features after the block."""
        scale, shift = self.modulation(embedding)[:, :, None, None, None].chunk(2, dim=1)
        h = self.conv_in(fixed_silu(self.norm_in(x)))
        h = fixed_silu(torch.addcmul(shift.to(h.dtype), self.norm_out(h), 1 + scale.to(h.dtype)))
        return x + self.conv_out(h)


class Level(nn.ModuleList):
    """The residual blocks of one resolution."""

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:  # [B, C, n, n, n], [B, E]
        """Return the features after the level."""
        for block in self:
            x = block(x, embedding)
        return x


class GlobalAttention(nn.Module):
    """Attention among all cells of the coarsest level."""

    def __init__(self, width: int, cells: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.LayerNorm(width)
        self.position = nn.Parameter(torch.zeros(cells**3, width))
        self.read = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        nn.init.normal_(self.position, std=0.02)
        nn.init.zeros_(self.out.weight)

    def forward(self, x: Tensor) -> Tensor:  # [B, C, n, n, n]
        """Return the features after attention."""
        batch, width = x.shape[:2]
        tokens = x.flatten(2).transpose(1, 2)
        read = self.read(self.norm(tokens + self.position))
        split = read.reshape(batch, -1, 3, self.heads, width // self.heads).permute(2, 0, 3, 1, 4)
        mixed = F.scaled_dot_product_attention(split[0], split[1], split[2])
        tokens = self.out(mixed.transpose(1, 2).reshape(batch, -1, width))
        return x + tokens.transpose(1, 2).reshape(x.shape)


class ShapeCompleter(nn.Module):
    """Predict the complete object from a part."""

    def __init__(self, config: ShapeModelConfig, coarse_cells: int) -> None:
        super().__init__()
        self.config = config
        w, e = config.widths, config.embedding
        self.words = nn.EmbeddingBag(config.vocabulary_size, e, mode="mean", padding_idx=0)
        self.scores = nn.Linear(COPIES, e)
        self.mix = nn.Sequential(nn.SiLU(), nn.Linear(e, e), nn.SiLU())
        folded = SOURCES * 4 * _FOLD**3 + _EVIDENCE + _POSITION
        self.stem = nn.Conv3d(folded, w[0], 1)
        self.down = nn.ModuleList(self._level(level) for level in range(3))
        self.up = nn.ModuleList(self._level(level) for level in range(3))
        self.shrink = nn.ModuleList(nn.Conv3d(w[i], w[i + 1], 2, stride=2) for i in range(2))
        self.grow = nn.ModuleList(nn.Conv3d(w[i + 1], w[i], 1) for i in range(2))
        self.attend = GlobalAttention(w[2], coarse_cells // 4)
        self.norm = GroupNorm(config.groups, w[0])
        self.head = nn.Conv3d(w[0], _FOLD**3 + 3 + SOURCES + 1 + SOURCES, 3, padding=1)
        nn.init.zeros_(self.head.weight)

    def _level(self, level: int) -> Level:
        width = self.config.widths[level]
        return Level(ResidualBlock(width, self.config) for _ in range(self.config.blocks[level]))

    def forward(
        self,
        volumes: Tensor,  # [B, SOURCES, 4, C, C, C]
        evidence: Tensor,  # [B, 3, C/2, C/2, C/2]
        scores: Tensor,  # [B, COPIES]
        tokens: Tensor,  # [B, L] word ids, 0 = padding
    ) -> ShapeOutput:
        """Predict the complete object."""
        embedding = self.mix(self.words(tokens) + self.scores(scores))
        place = positions(evidence.shape[-1], evidence.device).expand(len(volumes), -1, -1, -1, -1)
        x = torch.cat([fold(volumes.flatten(1, 2)), evidence, place], dim=1)
        x = self.stem(x.contiguous(memory_format=torch.channels_last_3d))
        x = x.contiguous(memory_format=torch.channels_last_3d)  # lost where one thread convolves
        kept = []
        for level in range(3):
            x = self.down[level](x, embedding)
            if level < 2:
                kept.append(x)
                x = self.shrink[level](x)
        x = self.attend(x)
        for level in (2, 1, 0):
            if level < 2:
                x = F.interpolate(self.grow[level](x), scale_factor=2.0, mode="nearest")
                x = x + kept[level]
            x = self.up[level](x, embedding)
        out = self.answer_of(x).float()
        parts = (_FOLD**3, 3, SOURCES + 1, SOURCES)
        filled, colors, sources, trust = out.split(parts, dim=1)
        pointed = F.interpolate(trust, scale_factor=float(_FOLD)) * volumes[:, :, 0]
        return ShapeOutput(unfold(filled)[:, 0] + pointed.sum(1), fixed_sigmoid(colors), sources)

    def answer_of(self, x: Tensor) -> Tensor:  # [B, C, n, n, n] -> [B, O, n, n, n]
        """Return what the last features say."""
        answer: Tensor = self.head(fixed_silu(self.norm(x)))
        return answer


def laid_out(network: Network) -> Network:
    """Store convolution kernels channels last, the layout that convolutions read; in place."""
    return network.to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]


def positions(cells: int, device: torch.device) -> Tensor:  # [3, n, n, n]
    """Return where the cells of a cubic grid are along its axes, from -1 to 1."""
    along = torch.linspace(-1, 1, cells, device=device)
    return torch.stack(torch.meshgrid(along, along, along, indexing="ij"))


def fold(x: Tensor) -> Tensor:  # [B, C, n, n, n] -> [B, 8 C, n/2, n/2, n/2]
    """Fold 2 x 2 x 2 cells into channels."""
    b, c, n = x.shape[:3]
    h = n // _FOLD
    x = x.reshape(b, c, h, _FOLD, h, _FOLD, h, _FOLD)
    return x.permute(0, 1, 3, 5, 7, 2, 4, 6).reshape(b, c * _FOLD**3, h, h, h)


def unfold(x: Tensor) -> Tensor:  # [B, 8 C, n, n, n] -> [B, C, 2n, 2n, 2n]
    """Undo :func:`fold`."""
    b, folded, h = x.shape[:3]
    c = folded // _FOLD**3
    x = x.reshape(b, c, _FOLD, _FOLD, _FOLD, h, h, h)
    return x.permute(0, 1, 5, 2, 6, 3, 7, 4).reshape(b, c, h * _FOLD, h * _FOLD, h * _FOLD)
