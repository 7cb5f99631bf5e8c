"""The denoiser: a U-Net over four views that attend to each other and to the prompt.

Conventions
-----------
* B rings of four views, images of S x S pixels. Noisy images are premultiplied RGBA mapped to
  [-1, 1]; the input map is P seen by the same cameras (``inputs.input_map``), zeros when withheld.
* The shape map is what the same cameras see of a known shape (``inputs.shape_map``), zeros when
  there is none.
* The output is v = alpha_t * noise - sigma_t * x0 (``diffusion``).
* Inside, views are folded into the batch, [4B, C, h, w] in channels-last memory, so that turning
  a level into tokens [B, 4hw, C] copies nothing.
* Nothing tells the views apart but their Plucker rays and their order round the ring: turning the
  ring (views and rays alike) turns the output.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gscomplete.priors.embedded.rays import RAY_CHANNELS, camera_vector, ring_rays
from gscomplete.util.same_bits import GroupNorm, Linear

IMAGE_CHANNELS = 4
INPUT_CHANNELS = 5
SHAPE_CHANNELS = 2
VIEWS = 4
SYMMETRIES = 7
"""Copies of P that ``symmetric_copies`` makes: three turns, and mirror images in four turns."""
_PATCH = 2


@dataclass(frozen=True, slots=True)
class ModelConfig:
    """Size of the denoiser. Widths are channels at 1/2, 1/4 and 1/8 of the image size."""

    resolution_px: int = 64
    widths: tuple[int, int, int] = (128, 192, 320)
    blocks: tuple[int, int, int] = (2, 2, 1)  # residual blocks per level, each way
    transformers: tuple[int, int] = (1, 3)  # joint-attention blocks at levels 1/4 and 1/8
    head_width: int = 32
    groups: int = 16  # of the group norms
    embedding: int = 256  # width of the time + camera + text vector
    text_width: int = 128
    text_length: int = 16  # longest prompt in tokens
    vocabulary_size: int = 1280  # token ids, those of padding and no text included


class TextEncoder(nn.Module):
    """Learned words, two transformer layers: token states and one pooled vector."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        width = config.text_width
        self.words = nn.Embedding(config.vocabulary_size, width)
        self.positions = nn.Parameter(torch.randn(config.text_length, width) * 0.02)
        self.layers = nn.ModuleList(
            nn.TransformerEncoderLayer(
                width, 4, 2 * width, dropout=0.0, activation="gelu", batch_first=True,
                norm_first=True,
            )
            for _ in range(2)
        )  # fmt: skip
        self.norm = nn.LayerNorm(width)
        self.words_to_states = nn.Linear(width, width, bias=False)
        nn.init.zeros_(self.words_to_states.weight)

    def forward(self, tokens: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Encode token ids.

        Args:
            tokens: [B, L] with 0 for padding and at least one other id per row.

        Returns:
            States [B, L, D], pooled [B, D], and the mask [B, L] of real tokens.
        """
        mask = tokens != 0
        words = self.words(tokens)
        states = words + self.positions[: tokens.shape[1]]
        for layer in self.layers:
            states = layer(states, src_key_padding_mask=~mask)
        # Words also bypass the layers, which alone drift to one constant state for all prompts.
        states = (self.norm(states) + self.words_to_states(words)) * mask[..., None]
        pooled = states.sum(1) / mask.sum(1, keepdim=True).clamp(min=1)
        return states, pooled, mask


class ResidualBlock(nn.Module):
    """Two 3 x 3 convolutions with group norm, modulated by the embedding (FiLM)."""

    def __init__(self, width: int, embedding: int, groups: int) -> None:
        super().__init__()
        self.norm_in = GroupNorm(groups, width)
        self.conv_in = nn.Conv2d(width, width, 3, padding=1)
        self.film = nn.Linear(embedding, 2 * width)
        self.norm_out = GroupNorm(groups, width)
        self.conv_out = nn.Conv2d(width, width, 3, padding=1)
        nn.init.zeros_(self.conv_out.weight)
        nn.init.zeros_(self.film.weight)

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:  # [4B, C, h, w], [4B, E]
        """Return the features after the block."""
        scale, shift = self.film(embedding)[:, :, None, None].chunk(2, dim=1)
        h = self.conv_in(F.silu(self.norm_in(x)))
        h = F.silu(torch.addcmul(shift.to(h.dtype), self.norm_out(h), 1 + scale.to(h.dtype)))
        return x + self.conv_out(h)


class JointTransformer(nn.Module):
    """Attention among the tokens of all four views, to the prompt, then an MLP.

    With ``pool`` 2 the keys and values are averaged over 2 x 2 cells. This takes a quarter of the
    work where tokens are many; queries still distinguish all positions.
    """

    def __init__(self, width: int, config: ModelConfig, *, pool: int, with_text: bool) -> None:
        super().__init__()
        self.heads = width // config.head_width
        self.pool = pool
        self.mix: Callable[[Tensor, Tensor, Tensor, Tensor | None], Tensor]
        self.mix = F.scaled_dot_product_attention
        self.rays = nn.Linear(RAY_CHANNELS, width)
        self.norm_self = nn.LayerNorm(width)
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.out_self = nn.Linear(width, width)
        self.with_text = with_text
        if with_text:
            self.norm_text = nn.LayerNorm(width)
            self.query_text = nn.Linear(width, width)
            self.key_value_text = nn.Linear(config.text_width, 2 * width)
            self.out_text = nn.Linear(width, width)
            nn.init.zeros_(self.out_text.weight)
        self.norm_mlp = nn.LayerNorm(width)
        self.mlp_in = nn.Linear(width, 3 * width)
        self.mlp_out = Linear(3 * width, width)
        nn.init.zeros_(self.out_self.weight)
        nn.init.zeros_(self.mlp_out.weight)

    def forward(
        self,
        x: Tensor,  # [4B, C, h, w]
        rays: Tensor,  # [4B, h, w, 6]
        states: Tensor,  # [B, L, D]
        mask: Tensor,  # [B, L]
    ) -> Tensor:  # [4B, C, h, w]
        """Return the features after the block."""
        batch, width, height, _ = x.shape
        tokens = x.permute(0, 2, 3, 1)  # [4B, h, w, C]
        normed = self.norm_self(tokens + self.rays(rays))
        keyed = normed
        if self.pool > 1:
            keyed = F.avg_pool2d(normed.permute(0, 3, 1, 2), self.pool).permute(0, 2, 3, 1)
        joint = (batch // VIEWS, -1, width)
        attended = self._attend(
            self.query(normed.reshape(joint)), self.key_value(keyed.reshape(joint)), None
        )
        flat = tokens.reshape(joint) + self.out_self(attended)
        if self.with_text:
            query = self.query_text(self.norm_text(flat))
            read = self._attend(query, self.key_value_text(states), mask[:, None, None, :])
            flat = flat + self.out_text(read)
        # trained with the tanh form, which differs by less than 5e-4 and takes five times as long
        flat = flat + self.mlp_out(F.gelu(self.mlp_in(self.norm_mlp(flat)).float()))
        return flat.reshape(batch, height, height, width).permute(0, 3, 1, 2)

    def _attend(self, query: Tensor, key_value: Tensor, mask: Tensor | None) -> Tensor:
        batch, count, width = query.shape
        key, value = key_value.chunk(2, dim=-1)
        split = (batch, -1, self.heads, width // self.heads)
        mixed = self.mix(
            query.reshape(split).transpose(1, 2),
            key.reshape(split).transpose(1, 2),
            value.reshape(split).transpose(1, 2),
            mask,
        )
        return mixed.transpose(1, 2).reshape(batch, count, width)


class Level(nn.Module):
    """Residual blocks, then joint transformers on the way down. Level 0 is the largest image."""

    def __init__(self, level: int, config: ModelConfig, *, going_down: bool) -> None:
        super().__init__()
        width, deepest = config.widths[level], len(config.widths) - 1
        transformers = (0, *config.transformers)[level] if going_down else 0
        self.blocks = nn.ModuleList(
            ResidualBlock(width, config.embedding, config.groups)
            for _ in range(config.blocks[level])
        )
        self.transformers = nn.ModuleList(
            JointTransformer(
                width, config, pool=1 if level == deepest else 2, with_text=level == deepest
            )
            for _ in range(transformers)
        )

    def forward(
        self, x: Tensor, embedding: Tensor, rays: Tensor, states: Tensor, mask: Tensor
    ) -> Tensor:
        """Return the features after the level."""
        for block in self.blocks:
            x = block(x, embedding)
        for transformer in self.transformers:
            x = transformer(x, rays, states, mask)
        return x


class CopiesConvolution(nn.Conv2d):
    """A convolution over P's turned and mirrored copies (``symmetric_copies``)."""

    def __init__(self, width: int) -> None:
        super().__init__(SYMMETRIES * INPUT_CHANNELS * _PATCH**2, width, 3, padding=1, bias=False)
        nn.init.zeros_(self.weight)

    def forward(self, cells: Tensor) -> Tensor:  # [B, 4, 20, s, s] -> [4B, C, s, s]
        """Return the features."""
        return super().forward(symmetric_copies(cells).flatten(0, 1))


class FourViewDenoiser(nn.Module):
    """Predict v of four noisy views from P's views, the ring, the timestep and the prompt."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        w, e = config.widths, config.embedding
        self.text = TextEncoder(config)
        self.time = nn.Sequential(nn.Linear(2 * _FREQUENCIES, e), nn.SiLU(), nn.Linear(e, e))
        self.camera = nn.Sequential(nn.Linear(3, e), nn.SiLU(), nn.Linear(e, e))
        self.pooled = nn.Linear(config.text_width, e)
        folded = (IMAGE_CHANNELS + INPUT_CHANNELS) * _PATCH**2 + RAY_CHANNELS
        self.stem = nn.Conv2d(folded, w[0], 3, padding=1)
        self.symmetries = CopiesConvolution(w[0])
        self.shape = nn.Conv2d(SHAPE_CHANNELS * _PATCH**2, w[0], 3, padding=1, bias=False)
        nn.init.zeros_(self.shape.weight)
        self.down = nn.ModuleList(Level(level, config, going_down=True) for level in range(3))
        self.up = nn.ModuleList(Level(level, config, going_down=False) for level in range(3))
        self.shrink = nn.ModuleList(
            nn.Conv2d(w[i], w[i + 1], _PATCH, stride=_PATCH) for i in range(2)
        )
        self.grow = nn.ModuleList(nn.Conv2d(w[i + 1], w[i], 1) for i in range(2))
        self.norm = GroupNorm(config.groups, w[0])
        self.head = nn.Conv2d(w[0], IMAGE_CHANNELS * _PATCH**2, 3, padding=1)
        nn.init.zeros_(self.head.weight)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                kernel = module.weight.data
                module.weight.data = kernel.contiguous(memory_format=torch.channels_last)

    def forward(
        self,
        noisy: Tensor,  # [B, 4, 4, S, S] views, channels
        input_map: Tensor,  # [B, 4, 5, S, S], zeros where P is withheld
        shape_map: Tensor,  # [B, 4, 2, S, S], zeros where no shape is known
        timestep: Tensor,  # [B] in 0 .. 999, may be fractional
        ring: Tensor,  # [B, 3] elevation_deg, radius, fov_deg
        tokens: Tensor,  # [B, L] word ids
        rays: Tensor | None = None,  # [B, 4, 6, S/2, S/2], None = computed from ring
    ) -> Tensor:  # [B, 4, 4, S, S]
        """Predict v."""
        states, pooled, mask = self.text(tokens)
        embedding = self.time(_time_features(timestep)) + self.camera(camera_vector(ring))
        embedding = F.silu(embedding + self.pooled(pooled)).repeat_interleave(VIEWS, dim=0)
        if rays is None:
            rays = ring_rays(ring, self.config.resolution_px // _PATCH)
        rays = rays.flatten(0, 1)
        ray_levels = [
            F.avg_pool2d(rays, 2**level).permute(0, 2, 3, 1) if level else rays.permute(0, 2, 3, 1)
            for level in range(3)
        ]
        cells = fold_cells(torch.cat([noisy, input_map], dim=2))
        x = self.stem(torch.cat([cells.flatten(0, 1), rays], dim=1))
        x = x + self.symmetries(cells[:, :, IMAGE_CHANNELS * _PATCH**2 :])
        x = x + self.shape(fold_cells(shape_map).flatten(0, 1))
        kept = []
        for level in range(3):
            x = self.down[level](x, embedding, ray_levels[level], states, mask)
            if level < 2:
                kept.append(x)
                x = self.shrink[level](x)
        for level in (2, 1, 0):
            if level < 2:
                x = F.interpolate(self.grow[level](x), scale_factor=2.0, mode="nearest")
                x = x + kept[level]
            x = self.up[level](x, embedding, ray_levels[level], states, mask)
        folded = self.head(F.silu(self.norm(x)))
        return F.pixel_shuffle(folded, _PATCH).unflatten(0, (-1, VIEWS)).float()


def fold_cells(images: Tensor) -> Tensor:  # [B, 4, C, S, S] -> [B, 4, 4C, S/2, S/2]
    """Fold cells of 2 x 2 pixels into channels, channels last: the order of a pixel unshuffle."""
    batch, views, channels, size, _ = images.shape
    half = size // _PATCH
    cells = images.reshape(batch, views, channels, half, _PATCH, half, _PATCH)
    rows = cells.permute(0, 1, 3, 5, 2, 4, 6).reshape(batch, views, half, half, -1)
    return rows.permute(0, 1, 4, 2, 3)


def symmetric_copies(cells: Tensor) -> Tensor:  # [B, 4, 20, s, s] -> [B, 4, 140, s, s]
    """Give every view what it would see of P turned by 90, 180 or 270 degrees, or mirrored.

    The views are 90 degrees apart at one elevation. So turning P about the ring's axis only
    permutes the views, and mirroring P through the upright plane of a view flips that view: both
    are exact and cost nothing. Most objects are symmetric, so what is missing is often there
    elsewhere.

    Args:
        cells: input maps, folded by :func:`fold_cells`; flipping also swaps the columns of a cell.
    """
    swapped = torch.arange(cells.shape[2]).bitwise_xor(1)
    rows = cells.permute(0, 1, 3, 4, 2)
    mirrored = rows.flip(3)[..., swapped]
    turned = [rows.roll(turn, dims=1) for turn in (1, 2, 3)]
    copies = torch.cat(turned + [mirrored.roll(turn, dims=1) for turn in range(4)], dim=4)
    return copies.permute(0, 1, 4, 2, 3)


_FREQUENCIES = 64


def _time_features(timestep: Tensor) -> Tensor:  # [B] -> [B, 2 * _FREQUENCIES]
    exponents = torch.arange(_FREQUENCIES, device=timestep.device, dtype=torch.float32)
    frequencies = torch.exp(exponents * (-math.log(10000.0) / _FREQUENCIES))
    angles = timestep.float()[:, None] * frequencies
    return torch.cat([torch.cos(angles), torch.sin(angles)], dim=1)


def count_parameters(model: nn.Module) -> int:
    """Return the number of learned scalars."""
    return sum(parameter.numel() for parameter in model.parameters())
