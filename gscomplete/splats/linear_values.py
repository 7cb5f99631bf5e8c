"""Signs that values lack the logarithm, logit or SH conversion that splat files hold them with."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.splats.filters import middle_and_extent, usable_rows
from gscomplete.splats.record import Splats
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import Float32Array, Float64Array

_FEWEST_ROWS = 100
"""Fewer rows tell nothing."""
_SURELY, _PERHAPS = 0.5, 0.05
"""Opacities (or f_dc) all in [0, 1] that spread over more than the first are linear, surely;
opacities that spread over more than the second may be."""
_LARGE_SCALE = 0.25
"""A typical splat larger than this part of the extent hints at linear scales."""
_BYTE_COLOR = 20.0
"""f_dc that are all positive and reach above this are RGB of 0 to 255."""
_ROWS = 20_000
"""So many splats of a set are enough."""
_DIGITS = 5
"""Of a logit between 0 and 1 that float32 keeps as an opacity."""


@dataclass(frozen=True, slots=True)
class LinearValues:
    """One kind of value that was probably written as it is."""

    name: str
    """``linear_opacity``, ``linear_scale`` or ``linear_color``."""
    is_sure: bool
    message: str
    """What was found, and what was expected."""


def linear_values(
    means: Float32Array,  # [N, 3]
    largest_scales: NDArray[np.floating],  # [N]
    opacity: tuple[float, float],
    scale: tuple[float, float],
    base: tuple[float, float],
) -> list[LinearValues]:
    """Find values that look as if a conversion had been left out.

    Args:
        means: positions, finite.
        largest_scales: logarithm of every splat's largest deviation.
        opacity: smallest and largest logit.
        scale: smallest and largest logarithm of a deviation.
        base: smallest and largest ``f_dc``.
    """
    if len(means) < _FEWEST_ROWS:
        return []
    found = []
    low, high = opacity
    if low >= 0 and high <= 1 and high - low > _PERHAPS:
        message = f"opacities look linear, expected logits: all in [{low:.3g}, {high:.3g}]"
        found.append(LinearValues("linear_opacity", high - low > _SURELY, message))
    _, extent = middle_and_extent(means)
    typical = float(np.median(largest_scales))
    large = _LARGE_SCALE * extent
    if scale[0] >= 0 and typical < large < math.exp(min(typical, 80.0)):
        message = (
            f"scales look linear, expected logarithms: all positive, typically {typical:.3g}; as "
            f"logarithms they are splats of {math.exp(min(typical, 80.0)):.3g} in an extent of "
            f"{extent:.3g}"
        )
        found.append(LinearValues("linear_scale", True, message))
    low, high = base
    if low >= 0 and (high > _BYTE_COLOR or (high <= 1 and high - low > _SURELY)):
        message = (
            f"f_dc looks like RGB, expected (RGB - 0.5) / 0.2821: all in [{low:.3g}, {high:.3g}]"
        )
        found.append(LinearValues("linear_color", high > _BYTE_COLOR, message))
    return found


def linear_values_of(splats: Splats) -> list[LinearValues]:
    """Find such values by what reading a file made of them.

    Args:
        splats: activated, in the frame of their file; those that cannot be drawn are left out, and
            of many an even choice is enough.
    """
    few = splats.select(torch.from_numpy(every_nth(np.arange(len(splats)), _ROWS)))
    given = few.select(usable_rows(few)[0])
    scales = given.scales.double().numpy()
    known = (scales > 0).all(axis=1)
    if not known.any():
        return []
    logs = np.log(scales[known])
    opacities = given.opacities.double().clamp(1e-12, 1 - 1e-12)
    logits = (opacities / (1 - opacities)).log()
    return linear_values(
        given.means.numpy(),
        logs.max(axis=1),
        opacity=_ends(logits.numpy()),
        scale=_ends(logs),
        base=_ends(given.sh[:, 0].double().numpy()),
    )


def _ends(values: Float64Array) -> tuple[float, float]:
    """Return the smallest and the largest value, without what float32 rounds off."""
    return round(float(values.min()), _DIGITS), round(float(values.max()), _DIGITS)
