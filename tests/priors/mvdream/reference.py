"""MVDream's three networks once more: float64, from original tensor names, no diffusers.

Structure is read off the names that are there, so nothing is shared with the code under test. The
timestep embedding is computed in float32 and then widened, as the original does.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional as F

Weights = dict[str, Tensor]


def linear(w: Weights, name: str, x: Tensor) -> Tensor:
    y = x @ w[f"{name}.weight"].T
    return y + w[f"{name}.bias"] if f"{name}.bias" in w else y


def conv(w: Weights, name: str, x: Tensor, stride: int = 1) -> Tensor:
    kernel = w[f"{name}.weight"]
    return F.conv2d(x, kernel, w[f"{name}.bias"], stride=stride, padding=kernel.shape[-1] // 2)


def group_norm(w: Weights, name: str, x: Tensor, eps: float, groups: int = 32) -> Tensor:
    flat = x.reshape(len(x), groups, -1)
    mean, var = flat.mean(-1, keepdim=True), flat.var(-1, unbiased=False, keepdim=True)
    y = ((flat - mean) / (var + eps).sqrt()).reshape(x.shape)
    return y * w[f"{name}.weight"][:, None, None] + w[f"{name}.bias"][:, None, None]


def layer_norm(w: Weights, name: str, x: Tensor) -> Tensor:
    mean, var = x.mean(-1, keepdim=True), x.var(-1, unbiased=False, keepdim=True)
    return (x - mean) / (var + 1e-5).sqrt() * w[f"{name}.weight"] + w[f"{name}.bias"]


def silu(x: Tensor) -> Tensor:
    return x / (1 + torch.exp(-x))


def gelu(x: Tensor) -> Tensor:
    return 0.5 * x * (1 + torch.erf(x / math.sqrt(2)))


def softmax_attention(
    q: Tensor, k: Tensor, v: Tensor, heads: int, mask: Tensor | None = None
) -> Tensor:
    """[B, L, C] each, one head at a time."""
    out = []
    for a, b, c in zip(q.chunk(heads, -1), k.chunk(heads, -1), v.chunk(heads, -1), strict=True):
        logits = a @ b.transpose(1, 2) / math.sqrt(a.shape[-1])
        if mask is not None:
            logits = logits + mask
        out.append(torch.softmax(logits, dim=-1) @ c)
    return torch.cat(out, dim=-1)


def timestep_embedding(timesteps: Tensor, width: int) -> Tensor:
    half = width // 2
    frequencies = torch.exp(-math.log(10000) * torch.arange(half, dtype=torch.float32) / half)
    angles = timesteps[:, None].float() * frequencies[None]
    return torch.cat([angles.cos(), angles.sin()], dim=1).double()


def residual(w: Weights, name: str, x: Tensor, emb: Tensor) -> Tensor:
    h = conv(w, f"{name}.in_layers.2", silu(group_norm(w, f"{name}.in_layers.0", x, 1e-5)))
    h = h + linear(w, f"{name}.emb_layers.1", silu(emb))[:, :, None, None]
    h = conv(w, f"{name}.out_layers.3", silu(group_norm(w, f"{name}.out_layers.0", h, 1e-5)))
    if f"{name}.skip_connection.weight" in w:
        x = conv(w, f"{name}.skip_connection", x)
    return x + h


def transformer(
    w: Weights, name: str, x: Tensor, context: Tensor, head_width: int, views: int
) -> Tensor:
    b, c, height, width = x.shape
    tokens = group_norm(w, f"{name}.norm", x, 1e-6).reshape(b, c, -1).transpose(1, 2)
    tokens = linear(w, f"{name}.proj_in", tokens)
    heads, depth = c // head_width, 0
    while f"{name}.transformer_blocks.{depth}.norm1.weight" in w:
        block = f"{name}.transformer_blocks.{depth}"
        h = layer_norm(w, f"{block}.norm1", tokens)
        h = h.reshape(b // views, -1, c)  # the views of a group, one after the other
        qkv = [linear(w, f"{block}.attn1.to_{part}", h) for part in "qkv"]
        h = linear(w, f"{block}.attn1.to_out.0", softmax_attention(*qkv, heads))
        tokens = tokens + h.reshape(b, -1, c)
        h = layer_norm(w, f"{block}.norm2", tokens)
        q = linear(w, f"{block}.attn2.to_q", h)
        k, v = (linear(w, f"{block}.attn2.to_{part}", context) for part in "kv")
        tokens = tokens + linear(w, f"{block}.attn2.to_out.0", softmax_attention(q, k, v, heads))
        h = linear(w, f"{block}.ff.net.0.proj", layer_norm(w, f"{block}.norm3", tokens))
        value, gate = h.chunk(2, dim=-1)
        tokens = tokens + linear(w, f"{block}.ff.net.2", value * gelu(gate))
        depth += 1
    tokens = linear(w, f"{name}.proj_out", tokens)
    return x + tokens.transpose(1, 2).reshape(b, c, height, width)


def unet(
    w: Weights,
    x: Tensor,
    timesteps: Tensor,
    context: Tensor,
    camera: Tensor,
    *,
    head_width: int,
    views: int,
) -> Tensor:
    emb = timestep_embedding(timesteps, w["input_blocks.0.0.weight"].shape[0])
    emb = linear(w, "time_embed.2", silu(linear(w, "time_embed.0", emb)))
    emb = emb + linear(w, "camera_embed.2", silu(linear(w, "camera_embed.0", camera)))

    def apply(name: str, h: Tensor) -> Tensor:
        """Everything in a block, in order, recognised by its tensors."""
        for place in (f"{name}.{index}" for index in range(4)):
            if f"{place}.in_layers.0.weight" in w:
                h = residual(w, place, h, emb)
            elif f"{place}.proj_in.weight" in w:
                h = transformer(w, place, h, context, head_width, views)
            elif f"{place}.op.weight" in w:
                h = conv(w, f"{place}.op", h, stride=2)
            elif f"{place}.conv.weight" in w:
                h = h.repeat_interleave(2, dim=2).repeat_interleave(2, dim=3)
                h = conv(w, f"{place}.conv", h)
            elif f"{place}.weight" in w:
                h = conv(w, place, h)
        return h

    skips, h, index = [], x, 0
    while any(key.startswith(f"input_blocks.{index}.") for key in w):
        h = apply(f"input_blocks.{index}", h)
        skips.append(h)
        index += 1
    h = apply("middle_block", h)
    for index in range(len(skips)):
        h = apply(f"output_blocks.{index}", torch.cat([h, skips.pop()], dim=1))
    return conv(w, "out.2", silu(group_norm(w, "out.0", h, 1e-5)))


def vae_residual(w: Weights, name: str, x: Tensor, groups: int) -> Tensor:
    h = conv(w, f"{name}.conv1", silu(group_norm(w, f"{name}.norm1", x, 1e-6, groups)))
    h = conv(w, f"{name}.conv2", silu(group_norm(w, f"{name}.norm2", h, 1e-6, groups)))
    return h + (conv(w, f"{name}.nin_shortcut", x) if f"{name}.nin_shortcut.weight" in w else x)


def vae_middle(w: Weights, side: str, x: Tensor, groups: int) -> Tensor:
    x = vae_residual(w, f"{side}.mid.block_1", x, groups)
    name = f"{side}.mid.attn_1"
    h = group_norm(w, f"{name}.norm", x, 1e-6, groups)
    flat = [conv(w, f"{name}.{p}", h).flatten(2).transpose(1, 2) for p in "qkv"]
    h = softmax_attention(*flat, 1).transpose(1, 2).reshape(x.shape)
    x = x + conv(w, f"{name}.proj_out", h)
    return vae_residual(w, f"{side}.mid.block_2", x, groups)


def vae_moments(w: Weights, images: Tensor, *, groups: int) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation of the posterior, unscaled."""
    h, level = conv(w, "encoder.conv_in", images), 0
    while f"encoder.down.{level}.block.0.norm1.weight" in w:
        block = 0
        while f"encoder.down.{level}.block.{block}.norm1.weight" in w:
            h = vae_residual(w, f"encoder.down.{level}.block.{block}", h, groups)
            block += 1
        if f"encoder.down.{level}.downsample.conv.weight" in w:
            name = f"encoder.down.{level}.downsample.conv"
            h = F.conv2d(F.pad(h, (0, 1, 0, 1)), w[f"{name}.weight"], w[f"{name}.bias"], stride=2)
        level += 1
    h = silu(group_norm(w, "encoder.norm_out", vae_middle(w, "encoder", h, groups), 1e-6, groups))
    mean, log_variance = conv(w, "quant_conv", conv(w, "encoder.conv_out", h)).chunk(2, dim=1)
    return mean, torch.exp(0.5 * log_variance.clamp(-30, 20))


def vae_decode(w: Weights, latents: Tensor, *, groups: int) -> Tensor:
    h = conv(w, "decoder.conv_in", conv(w, "post_quant_conv", latents))
    h = vae_middle(w, "decoder", h, groups)
    levels = len({key.split(".")[2] for key in w if key.startswith("decoder.up.")})
    for level in reversed(range(levels)):
        block = 0
        while f"decoder.up.{level}.block.{block}.norm1.weight" in w:
            h = vae_residual(w, f"decoder.up.{level}.block.{block}", h, groups)
            block += 1
        if f"decoder.up.{level}.upsample.conv.weight" in w:
            h = h.repeat_interleave(2, dim=2).repeat_interleave(2, dim=3)
            h = conv(w, f"decoder.up.{level}.upsample.conv", h)
    return conv(w, "decoder.conv_out", silu(group_norm(w, "decoder.norm_out", h, 1e-6, groups)))


def text_tower(w: Weights, ids: Tensor, *, heads: int) -> Tensor:
    """OpenCLIP's text tower without its last block, then the final norm."""
    blocks = len({key.split(".")[2] for key in w if key.startswith("transformer.resblocks.")})
    x = w["token_embedding.weight"][ids] + w["positional_embedding"][: ids.shape[1]]
    mask = torch.full((ids.shape[1], ids.shape[1]), -torch.inf, dtype=x.dtype).triu(1)
    for block in range(blocks - 1):
        name = f"transformer.resblocks.{block}"
        h = layer_norm(w, f"{name}.ln_1", x)
        h = h @ w[f"{name}.attn.in_proj_weight"].T + w[f"{name}.attn.in_proj_bias"]
        h = softmax_attention(*h.chunk(3, dim=-1), heads, mask)
        x = x + linear(w, f"{name}.attn.out_proj", h)
        h = gelu(linear(w, f"{name}.mlp.c_fc", layer_norm(w, f"{name}.ln_2", x)))
        x = x + linear(w, f"{name}.mlp.c_proj", h)
    return layer_norm(w, "ln_final", x)
