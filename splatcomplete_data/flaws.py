"""Flaws of real captures: noise, holes, shifted colours, flying splats.

Conventions
-----------
* A pure function of (seed, index) and of the splats, which are expected in the object frame.
* Each flaw's strength is drawn between none and its largest value.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from gscomplete.splats.record import SH_C0, Splats, concatenate
from splatcomplete_data.cuts.geometry import splat_points

_CLEAN_SHARE = 0.35
"""Share of partials left as they are."""
_MOST_HOLES = 4
"""Most round patches dropped."""
_FLYING_SHARE = 0.01
"""Largest share of flying splats added."""
_POSITION_NOISE = 0.006
"""Largest standard deviation of positions, object frame."""
_COLOR_NOISE = 0.06
"""Largest standard deviation of colours, sRGB."""
_COLOR_SHIFT = 0.06
"""Largest shift of all colours together, sRGB."""
_SIZE_NOISE = 0.3
"""Largest standard deviation of log scales."""
_HOLE_RADIUS = (0.03, 0.12)
"""Radius of dropped patches, object frame."""


def corrupt(splats: Splats, mask: Tensor, seed: int, index: int) -> Splats:
    """Return the kept splats with flaws of real captures.

    Flaws: noise of positions, colours and sizes, a shift of all colours, round holes, and a few
    flying splats. A share of all results is left clean.

    Args:
        splats: the complete object, object frame.
        mask: [N] bool, what the partial keeps.
        seed: seed of the stream.
        index: which one of the stream.
    """
    rng = np.random.default_rng((seed, index, 12))
    kept = splats.select(mask)
    if len(kept) == 0 or rng.random() < _CLEAN_SHARE:
        return kept
    strength = rng.random(6) ** 2
    points = splat_points(kept)
    outside = np.ones(len(points), np.bool_)
    for _ in range(int(rng.integers(_MOST_HOLES + 1))):
        middle = points[int(rng.integers(len(points)))]
        radius = rng.uniform(*_HOLE_RADIUS)
        outside &= np.square(points - middle).sum(axis=1) > radius * radius
    if outside.mean() > 0.5:
        kept = kept.select(torch.from_numpy(outside).to(mask.device))
    shape = (len(kept), 3)

    def noise(deviation: float, size: tuple[int, ...] = shape) -> Tensor:
        draw = rng.standard_normal(size, dtype=np.float32) * np.float32(deviation)
        return torch.from_numpy(draw).to(kept.means)

    sh = kept.sh.clone()
    shift = torch.from_numpy(rng.uniform(-1, 1, 3).astype(np.float32)).to(sh)
    sh[:, 0] += shift * float(strength[0] * _COLOR_SHIFT / SH_C0)
    sh[:, 0] += noise(strength[1] * _COLOR_NOISE / SH_C0)
    sizes = kept.scales * noise(strength[2] * _SIZE_NOISE, (len(kept), 1)).exp()
    means = kept.means + noise(strength[3] * _POSITION_NOISE)
    flawed = dataclasses.replace(kept, means=means, scales=sizes, sh=sh)
    flying = int(strength[4] * _FLYING_SHARE * len(kept))
    if flying == 0:
        return flawed
    strays = flawed.select(torch.from_numpy(rng.integers(len(kept), size=flying)).to(mask.device))
    away = noise(0.15, (flying, 3))
    return concatenate([flawed, dataclasses.replace(strays, means=strays.means + away)])
