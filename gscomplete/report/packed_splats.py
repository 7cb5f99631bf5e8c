"""Splats small enough for a page: 17 bytes each, base64.

Conventions
-----------
* The object frame; splats with an opacity below ``FAINT`` or outside ``REACH`` are left out.
* A splat is three uint16 (place in [-REACH, REACH]^3), three uint8 (logarithms of the scales from
  ``SMALLEST`` to ``LARGEST``), four int8 (quaternion w, x, y, z times 127) and four uint8 (colour
  of the constant band, opacity). Little-endian; the values lie field after field, not splat after
  splat.
* ``viewer.js`` reads it; ``unpacked`` is its twin.
"""

from __future__ import annotations

import base64
import dataclasses
import itertools
import math
from typing import TypedDict

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.evaluate.align.align import evenly_spread
from gscomplete.splats import Splats
from gscomplete.splats.thinning import thinned
from gscomplete.util.arrays import Float64Array

REACH = 1.0
SMALLEST, LARGEST = 1e-4, 0.5
FAINT = 0.02
_LOOKED_AT, _LOOKED_AT_PER_SHOWN = 30_000, 3
"""Splats that the choice is made from: so many, or so many for each that is shown."""


class Packed(TypedDict):
    """Splats as a page holds them."""

    count: int
    data: str
    """Base64."""


def packed(splats: Splats, most: int) -> Packed:
    """Pack an even choice of splats.

    Args:
        splats: in the object frame, drawable.
        most: most splats to pack; of more, an evenly spaced subset is packed, its scales enlarged
            to close the gaps.
    """
    kept = (splats.opacities >= FAINT) & (splats.means.abs() <= REACH).all(dim=1)
    chosen = splats.select(kept)
    if len(chosen) > most:
        chosen = _spread(chosen, most)
    data = b"".join(field.tobytes() for field in _fields(chosen))
    return {"count": len(chosen), "data": base64.b64encode(data).decode("ascii")}


def _spread(splats: Splats, most: int) -> Splats:
    """Choose splats at about equal distances, since a random choice would leave holes."""
    means = splats.means.double().numpy()
    if not np.ptp(means, axis=0).max() > 0:
        return thinned(splats, most, torch.Generator().manual_seed(0))
    looked_at = max(_LOOKED_AT, _LOOKED_AT_PER_SHOWN * most)
    rows = evenly_spread(means, most, np.random.default_rng(0), looked_at)
    chosen = splats.select(torch.from_numpy(np.sort(rows)))
    widened = chosen.scales * (len(splats) / len(chosen)) ** 0.5
    return dataclasses.replace(chosen, scales=widened)


def unpacked(splats: Packed) -> dict[str, Float64Array]:
    """Read what ``packed`` wrote: means, scales, quaternions, colors, opacities."""
    count, data = splats["count"], base64.b64decode(splats["data"])
    at = np.cumsum([0, 6 * count, 3 * count, 4 * count, 4 * count])
    means, scales, quaternions, rgba = (data[a:b] for a, b in itertools.pairwise(at))
    place = np.frombuffer(means, "<u2").reshape(count, 3)
    log = np.frombuffer(scales, np.uint8).reshape(count, 3) / 255.0
    colors = np.frombuffer(rgba, np.uint8).reshape(count, 4) / 255.0
    return {
        "means": (place / 65535.0 * 2 - 1) * REACH,
        "scales": SMALLEST * (LARGEST / SMALLEST) ** log,
        "quaternions": np.frombuffer(quaternions, np.int8).reshape(count, 4) / 127.0,
        "colors": colors[:, :3],
        "opacities": colors[:, 3],
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
