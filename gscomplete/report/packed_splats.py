"""Splats small enough for a page: 18 bytes each, base64.

Conventions
-----------
* The object frame; splats with an opacity below ``FAINT`` or outside ``REACH`` are left out.
* A splat is three uint16 (place in [-REACH, REACH]^3), three uint8 (logarithms of the scales from
  ``SMALLEST`` to ``LARGEST``), four int8 (quaternion w, x, y, z times 127), four uint8 (colour of
  the constant band, opacity) and one uint8 (1 = added by the completion). Little-endian; the
  values lie field after field, not splat after splat.
* ``viewer.js`` reads it; ``unpacked`` is its twin.
"""

from __future__ import annotations

import base64
import itertools
import math

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.splats import Splats
from gscomplete.splats.filters import thinned

REACH = 1.0
SMALLEST, LARGEST = 1e-4, 0.5
FAINT = 0.02

FloatArray = NDArray[np.float32]


def packed(splats: Splats, is_new: torch.Tensor, most: int) -> tuple[int, str]:  # [N] bool
    """Pack an even choice of splats.

    Args:
        splats: in the object frame, drawable.
        is_new: which of them a completion added.
        most: of more, a random choice is taken, widened to match.

    Returns:
        How many, and the base64 text.
    """
    kept = (splats.opacities >= FAINT) & (splats.means.abs() <= REACH).all(dim=1)
    generator = torch.Generator().manual_seed(0)
    groups = [splats.select(kept & mask) for mask in (~is_new, is_new)]
    total = sum(len(group) for group in groups)
    share = min(1.0, most / max(total, 1))
    chosen = [thinned(g, max(1, int(share * len(g))), generator) if len(g) else g for g in groups]
    flags = np.repeat(np.array([0, 1], np.uint8), [len(group) for group in chosen])
    fields = [np.concatenate(parts) for parts in zip(*map(_fields, chosen), strict=True)]
    data = b"".join(field.tobytes() for field in (*fields, flags))
    return len(flags), base64.b64encode(data).decode("ascii")


def unpacked(count: int, text: str) -> dict[str, NDArray[np.float64]]:
    """Read what ``packed`` wrote: means, scales, quaternions, colors, opacities, is_new."""
    data = base64.b64decode(text)
    sizes = [6 * count, 3 * count, 4 * count, 4 * count, count]
    at = np.cumsum([0, *sizes])
    means, scales, quaternions, rgba, flags = (data[a:b] for a, b in itertools.pairwise(at))
    place = np.frombuffer(means, "<u2").reshape(count, 3)
    log = np.frombuffer(scales, np.uint8).reshape(count, 3) / 255.0
    colors = np.frombuffer(rgba, np.uint8).reshape(count, 4) / 255.0
    return {
        "means": (place / 65535.0 * 2 - 1) * REACH,
        "scales": SMALLEST * (LARGEST / SMALLEST) ** log,
        "quaternions": np.frombuffer(quaternions, np.int8).reshape(count, 4) / 127.0,
        "colors": colors[:, :3],
        "opacities": colors[:, 3],
        "is_new": np.frombuffer(flags, np.uint8).astype(np.float64),
    }


def _fields(splats: Splats) -> tuple[NDArray[np.generic], ...]:
    """Quantise every field."""
    place = (splats.means.double().numpy() / REACH + 1) / 2 * 65535
    scales = splats.scales.double().numpy().clip(SMALLEST, LARGEST)
    log = np.log(scales / SMALLEST) / math.log(LARGEST / SMALLEST) * 255
    unit = torch.nn.functional.normalize(splats.quaternions.double(), dim=1).numpy()
    rgba = torch.cat([splats.base_colors, splats.opacities[:, None]], dim=1).double().numpy()
    return (
        np.rint(place).clip(0, 65535).astype("<u2"),
        np.rint(log).astype(np.uint8),
        np.rint(127 * unit).astype(np.int8),
        np.rint(255 * rgba.clip(0, 1)).astype(np.uint8),
    )
