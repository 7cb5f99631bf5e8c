"""Structural similarity (Wang et al. 2004) of image pairs, differentiable and fast on CPUs.

Conventions
-----------
* Images are [H, W, 3] with values in [0, 1]; statistics are taken per channel in an 11 x 11
  Gaussian window of standard deviation 1.5 px, with zeros beyond the border, as 3DGS does.
* ``ssim_map`` is the map [H, W, 3]; gradients reach the first image only (the second is a photo).
* C1 = 0.01^2 and C2 = 0.03^2 for a value range of 1.

With blur B, the map S is a function of mu = B x, B x^2 and B xy, and of the photo's B y, B y^2.
B is symmetric, so dL/dx = B(a) + 2 x B(b) + y B(c), where a, b, c are dL/dS times the partial
derivatives of S: three blurs forward and three backward.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

WINDOW_PX = 11
SIGMA_PX = 1.5
C1 = 0.01**2
C2 = 0.03**2
_HALF = WINDOW_PX // 2
_JIT: dict[str, Any] = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}


def gaussian_window() -> Tensor:  # [WINDOW_PX] float64
    """Return the one-dimensional window, of sum 1."""
    offset = torch.arange(WINDOW_PX, dtype=torch.float64) - _HALF
    weight = torch.exp(-0.5 * (offset / SIGMA_PX) ** 2)
    return weight / weight.sum()


_TAPS = gaussian_window().float().numpy()


@dataclass(frozen=True, slots=True)
class Reference:
    """A photo with the blurs that do not change while splats are fitted to it."""

    image: Tensor  # [H, W, 3] float32
    mean: Tensor  # [H, W, 3] B y
    square: Tensor  # [H, W, 3] B y^2

    @staticmethod
    def of(image: Tensor) -> Reference:  # [H, W, 3]
        """Blur a photo."""
        image = image.float().contiguous()
        return Reference(image, blur(image), blur(image * image))


def blur(image: Tensor) -> Tensor:  # [H, W, C] -> [H, W, C]
    """Blur with the window, zeros beyond the border; no gradient."""
    image = image.detach().float().contiguous()
    if image.is_cuda:
        return _blur_by_convolution(image)
    out = np.empty_like(image.numpy())
    _blur(image.numpy(), _TAPS, out)
    return torch.from_numpy(out)


def ssim_map(image: Tensor, reference: Reference) -> Tensor:  # [H, W, 3] -> [H, W, 3]
    """Return the map of structural similarity, in [-1, 1].

    Raises:
        ValueError: the images differ in shape.
    """
    if image.shape != reference.image.shape:
        raise ValueError(
            f"ssim_map: expected shape {tuple(reference.image.shape)}, found {tuple(image.shape)}"
        )
    return _Ssim.apply(image, reference)


class _Ssim(torch.autograd.Function):
    """The map and its gradient, from blurs."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, reference: Reference) -> Tensor:
        x = image.detach().float().contiguous()
        ctx.image, ctx.reference = x, reference
        if x.is_cuda:
            terms = _terms(blur(x), blur(x * x), blur(x * reference.image), reference)
            ctx.partials = terms[1:]
            return terms[0]
        out, partials = np.empty_like(x.numpy()), np.empty((3, *x.shape), np.float32)
        photo = reference.image.numpy(), reference.mean.numpy(), reference.square.numpy()
        _forward(x.numpy(), *photo, _TAPS, out, partials)
        ctx.partials = partials
        return torch.from_numpy(out)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> Any:
        x, photo, partials = ctx.image, ctx.reference.image, ctx.partials
        if x.is_cuda:
            a, b, c = (blur(upstream * partial) for partial in partials)
            return a + 2.0 * x * b + photo * c, None
        gradient = np.empty_like(x.numpy())
        upstream = upstream.float().contiguous()
        _backward(x.numpy(), photo.numpy(), upstream.numpy(), partials, _TAPS, gradient)
        return torch.from_numpy(gradient), None


def _terms(
    mean: Tensor, square: Tensor, product: Tensor, reference: Reference
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the map and its derivatives by B x, B x^2 and B xy (as ``_forward`` does)."""
    cross = mean * reference.mean
    below_l = mean * mean + reference.mean * reference.mean + C1
    below_c = (square - mean * mean) + (reference.square - reference.mean * reference.mean) + C2
    luminance = (2.0 * cross + C1) / below_l
    contrast = (2.0 * (product - cross) + C2) / below_c
    by_square = -luminance * contrast / below_c
    by_product = 2.0 * luminance / below_c
    by_luminance = 2.0 * contrast * (reference.mean - mean * luminance) / below_l
    by_mean = by_luminance - by_product * reference.mean - 2.0 * mean * by_square
    return luminance * contrast, by_mean, by_square, by_product


def _blur_by_convolution(image: Tensor) -> Tensor:  # [H, W, C]
    """Blur by two convolutions, for devices that Numba does not serve."""
    taps = gaussian_window().to(image)
    planes = image.permute(2, 0, 1)[:, None]
    planes = torch.nn.functional.conv2d(planes, taps[None, None, :, None], padding=(_HALF, 0))
    planes = torch.nn.functional.conv2d(planes, taps[None, None, None, :], padding=(0, _HALF))
    return planes[:, 0].permute(1, 2, 0).contiguous()


@numba.njit(**_JIT)
def _across(rows: Any, taps: Any, channels: int, out: Any) -> None:
    """Blur rows [F, W * C] that have 5 * C zeros at either end into ``out`` [F, W * C]."""
    for f in range(out.shape[0]):
        row, target = rows[f], out[f]
        for k in range(target.shape[0]):
            target[k] = np.float32(0.0)
        for t in range(taps.shape[0]):
            weight, shift = taps[t], np.uint64(t * channels)
            for k in range(np.uint64(0), np.uint64(target.shape[0])):
                target[k] += weight * row[k + shift]


@numba.njit(parallel=True, **_JIT)
def _blur(image: Any, taps: Any, out: Any) -> None:
    """Blur [H, W, C] into ``out``."""
    height, width, channels = image.shape
    half, flat = taps.shape[0] // 2, width * channels
    source, target = image.reshape(height, flat), out.reshape(height, flat)
    pad = np.uint64(half * channels)
    for row in numba.prange(height):
        rows = np.zeros((1, flat + 2 * half * channels), np.float32)
        for t in range(max(0, half - row), min(taps.shape[0], height + half - row)):
            weight, line = taps[t], source[row + t - half]
            for k in range(np.uint64(0), np.uint64(flat)):
                rows[0, k + pad] += weight * line[k]
        _across(rows, taps, channels, target[row : row + 1])


@numba.njit(parallel=True, **_JIT)
def _forward(
    image: Any,  # [H, W, C] float32
    photo: Any,
    photo_mean: Any,
    photo_square: Any,
    taps: Any,
    out: Any,  # [H, W, C], written
    partials: Any,  # [3, H, W, C], written: derivatives by B x, B x^2, B xy
) -> None:
    """Blur x, x^2 and xy row by row and turn them into the map and its derivatives."""
    height, width, channels = image.shape
    half, flat = taps.shape[0] // 2, width * channels
    x, y = image.reshape(height, flat), photo.reshape(height, flat)
    y_mean, y_square = photo_mean.reshape(height, flat), photo_square.reshape(height, flat)
    result, derivative = out.reshape(height, flat), partials.reshape(3, height, flat)
    pad = np.uint64(half * channels)
    c1, c2, two = np.float32(C1), np.float32(C2), np.float32(2.0)
    for row in numba.prange(height):
        rows = np.zeros((3, flat + 2 * half * channels), np.float32)
        blurred = np.empty((3, flat), np.float32)
        for t in range(max(0, half - row), min(taps.shape[0], height + half - row)):
            weight, a, b = taps[t], x[row + t - half], y[row + t - half]
            for k in range(np.uint64(0), np.uint64(flat)):
                weighted = weight * a[k]
                rows[0, k + pad] += weighted
                rows[1, k + pad] += weighted * a[k]
                rows[2, k + pad] += weighted * b[k]
        _across(rows, taps, channels, blurred)
        for k in range(np.uint64(0), np.uint64(flat)):
            mean, other = blurred[0, k], y_mean[row, k]
            cross = mean * other
            below_l = mean * mean + other * other + c1
            below_c = (blurred[1, k] - mean * mean) + (y_square[row, k] - other * other) + c2
            luminance = (two * cross + c1) / below_l
            contrast = (two * (blurred[2, k] - cross) + c2) / below_c
            by_square = -luminance * contrast / below_c
            by_product = two * luminance / below_c
            by_luminance = two * contrast * (other - mean * luminance) / below_l
            result[row, k] = luminance * contrast
            derivative[0, row, k] = by_luminance - by_product * other - two * mean * by_square
            derivative[1, row, k] = by_square
            derivative[2, row, k] = by_product


@numba.njit(parallel=True, **_JIT)
def _backward(
    image: Any,  # [H, W, C]
    photo: Any,
    upstream: Any,
    partials: Any,  # [3, H, W, C]
    taps: Any,
    gradient: Any,  # [H, W, C], written
) -> None:
    """Blur the three weighted derivatives and combine them."""
    height, width, channels = image.shape
    half, flat = taps.shape[0] // 2, width * channels
    x, y = image.reshape(height, flat), photo.reshape(height, flat)
    above, out = upstream.reshape(height, flat), gradient.reshape(height, flat)
    derivative = partials.reshape(3, height, flat)
    pad = np.uint64(half * channels)
    for row in numba.prange(height):
        rows = np.zeros((3, flat + 2 * half * channels), np.float32)
        blurred = np.empty((3, flat), np.float32)
        for t in range(max(0, half - row), min(taps.shape[0], height + half - row)):
            weight, line = taps[t], row + t - half
            for k in range(np.uint64(0), np.uint64(flat)):
                weighted = weight * above[line, k]
                rows[0, k + pad] += weighted * derivative[0, line, k]
                rows[1, k + pad] += weighted * derivative[1, line, k]
                rows[2, k + pad] += weighted * derivative[2, line, k]
        _across(rows, taps, channels, blurred)
        for k in range(np.uint64(0), np.uint64(flat)):
            out[row, k] = (
                blurred[0, k]
                + np.float32(2.0) * x[row, k] * blurred[1, k]
                + y[row, k] * blurred[2, k]
            )
