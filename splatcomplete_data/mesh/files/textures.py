"""Textures and colours of meshes as arrays in [0, 1].

Conventions
-----------
* Texture coordinates are OpenGL's: v upwards, wrapping round, bilinear between texels; arrays have
  their top row first.
* Colours are sRGB unless a name says linear.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float32Array
from splatcomplete_data.pictures import UNREADABLE, eight_bits


def sample_texture(
    texture: Float32Array,  # [H, W, C], top row first
    uv: Float32Array,  # [N, 2], v upwards
) -> Float32Array:  # [N, C]
    """Look a texture up bilinearly, wrapping round at its edges."""
    height, width = texture.shape[:2]
    x = np.nan_to_num(uv[:, 0].astype(np.float64)) * width - 0.5
    y = (1.0 - np.nan_to_num(uv[:, 1].astype(np.float64))) * height - 0.5
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = (x - column)[:, None], (y - row)[:, None]
    left, right = column % width, (column + 1) % width
    top, bottom = row % height, (row + 1) % height
    upper = texture[top, left] * (1 - fx) + texture[top, right] * fx
    lower = texture[bottom, left] * (1 - fx) + texture[bottom, right] * fx
    return (upper * (1 - fy) + lower * fy).astype(np.float32)


def srgb_from_linear(values: Float32Array) -> Float32Array:
    """Encode linear light in [0, 1] as sRGB."""
    values = np.clip(values, 0.0, 1.0)
    encoded = np.where(
        values <= 0.0031308, 12.92 * values, 1.055 * np.maximum(values, 1e-9) ** (1 / 2.4) - 0.055
    )
    return encoded.astype(np.float32)


def open_image(path: Path) -> Image.Image:
    """Open an image file.

    Raises:
        UserError: it is missing, not an image, or has too many pixels.
    """
    try:
        return Image.open(path)
    except UNREADABLE as error:
        raise UserError(f"{path}: cannot read it as an image ({error})") from error


def texture_array(image: Image.Image, has_alpha: bool, max_px: int) -> Float32Array:  # [H, W, 4]
    """Turn an image into colours in [0, 1], reduced so that no side is above twice ``max_px``."""
    image = eight_bits(image).convert("RGBA")
    factor = max(image.size) // max_px
    if factor > 1:
        image = image.reduce(factor)
    pixels = np.asarray(image, np.float32) / np.float32(255.0)
    if not has_alpha:
        pixels = pixels.copy()
        pixels[..., 3] = 1.0
    return pixels


def unit_rgb(colors: NDArray[Any]) -> Float32Array:
    """Scale colours [..., 3 or 4] of any type to RGB in [0, 1]."""
    return unit_colors(np.asarray(colors)[..., :3])


def unit_colors(values: NDArray[Any]) -> Float32Array:
    """Scale colours of any type to [0, 1]."""
    if np.issubdtype(values.dtype, np.integer):
        return (values / np.iinfo(values.dtype).max).astype(np.float32)
    return values.astype(np.float32)


def as_srgb(colors: Float32Array, is_linear: bool) -> Float32Array:
    """Encode colours as sRGB if they are linear."""
    return srgb_from_linear(colors) if is_linear else colors
