"""How often another system's result is aligned: ``python -m recipes.benchmarks.alignment``.

The complete real objects are moved by random similarities (any rotation, scale .3 to 3, shift of
twice the size, another brightness); of each a part that lacks 30 to 50 % of its surface beyond a
random plane is to be found in it. Result and part are different halves of the object's splats, so
that they share no point.

* ``found``: within 2 degrees, 1 % of scale and 1 % of the size.
* ``up to symmetry``: scale and place of the middle within 1 % and 2 %, and 95 % of the surface
  within 1.5 spacings of the samples of the true one: another pose that the shape allows.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from gscomplete.evaluate.align import align_points
from gscomplete.evaluate.align.align import evenly_spread
from gscomplete.splats.transform import Similarity
from recipes.entry_point import start
from recipes.real_objects.complete import DATA
from recipes.real_objects.load import load_real_object, names

_SPLATS = 24_000
"""Of an object, so that samples of either half are about 1 % of its size apart."""


@dataclass(frozen=True)
class Options:
    """Measure how often results are aligned."""

    names: tuple[str, ...] = ()
    """Objects by name; none = every mesh of the table."""
    data: Path = DATA
    """Folder of the real data."""
    seed: int = 0


def main(options: Options) -> None:
    """Align every object once and count."""
    rows: list[tuple[bool, bool, float]] = []
    for number, name in enumerate(options.names or names()):
        item = load_real_object(name, options.data)
        if item.complete is None:
            continue
        rng = np.random.default_rng([options.seed, number])
        points = item.complete.means.double().numpy()
        colors = item.complete.base_colors.double().numpy().clip(0, 1)
        size = float(np.ptp(points, axis=0).max())
        chosen = evenly_spread(points / size, _SPLATS, rng)
        points, colors = points[chosen] / size, colors[chosen]
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        points = points - middle
        first = np.arange(len(points)) % 2 == 0
        normal = rng.normal(size=3)
        height = points @ (normal / np.linalg.norm(normal))
        part = ~first & (height > np.quantile(height, rng.uniform(0.3, 0.5)))
        shift = rng.normal(size=3)
        true = Similarity(
            math.exp(rng.uniform(math.log(0.3), math.log(3.0))),
            torch.from_numpy(Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()),
            torch.from_numpy(2.0 * shift / np.linalg.norm(shift)),
        )
        began = time.perf_counter()
        found = align_points(
            true.apply(torch.from_numpy(points[first])).numpy(),
            points[part],
            colors=rng.uniform(0.6, 1.0) * colors[first],
            target_colors=colors[part],
        )
        seconds = time.perf_counter() - began
        left = found.target_from_result.compose(true)
        degrees = math.degrees(
            math.acos(max(-1.0, min(1.0, float(torch.trace(left.rotation) - 1) / 2)))
        )
        growth, moved = abs(left.scale - 1), float(left.translation.norm())
        placed = left.apply(torch.from_numpy(points)).numpy()
        spacing = float(np.median(cKDTree(points[first]).query(points[~first])[0]))
        away = max(
            float(np.quantile(cKDTree(a).query(b)[0], 0.95))
            for a, b in ((points, placed), (placed, points))
        )
        exact = degrees < 2 and growth < 0.01 and moved < 0.01
        alike = growth < 0.01 and moved < 0.02 and away < max(1.5 * spacing, 0.01)
        rows.append((exact, exact or alike, seconds))
        sys.stdout.write(
            f"{name:16} {degrees:6.2f} deg  scale {100 * growth:5.2f} %  shift {100 * moved:5.2f} %"
            f"  surface {100 * away:5.2f} % (spacing {100 * spacing:.2f} %)  residual "
            f"{100 * found.residual:.2f} %  {seconds:5.1f} s  "
            f"{'found' if exact else 'up to symmetry' if alike else 'MISSED'}\n"
        )
        sys.stdout.flush()
    exact, alike, seconds = (np.array(column) for column in zip(*rows, strict=True))
    sys.stdout.write(
        f"{len(rows)} objects: {int(exact.sum())} found, {int(alike.sum())} found up to symmetry; "
        f"median {np.median(seconds):.1f} s\n"
    )


if __name__ == "__main__":
    start(main, Options, __doc__)
