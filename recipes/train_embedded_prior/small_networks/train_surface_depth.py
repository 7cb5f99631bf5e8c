"""Train the surface depth.

``python -m recipes.train_embedded_prior.small_networks.train_surface_depth``

Parts are guessed once and kept in the run's folder, so that the same command goes on; learning
takes two minutes.

Conventions
-----------
* What is learned lies between the true depth's median and its likeliest value (``loss_of``).
* Points that are near no true surface are left out.
* Every sixth file of objects is held out.
"""

from __future__ import annotations

import functools
import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from gscomplete.networks.perceptron import Perceptron
from gscomplete.priors.embedded.weights import packaged_weights
from gscomplete.shape.surface.depth import SURFACE_DEPTH_FILE
from recipes.entry_point import start
from recipes.train_embedded_prior.small_networks.depth_sets import DepthSets, depth_sets
from recipes.train_embedded_prior.small_networks.perceptron_training import (
    PerceptronConfig,
    fit_perceptron,
    train_on_files,
)

_HELD_OUT_EVERY = 6
_ROUNDED_BELOW = 0.2
"""Errors smaller than this count by their square, larger ones in proportion, cells."""
_SMALL = 0.4
"""Errors up to about this count as small, cells."""
_SMALL_WEIGHT = 3.0
"""Weight of the errors that are not small."""


@dataclass(frozen=True)
class SurfaceDepthConfig(PerceptronConfig):
    """Train the surface depth."""

    run: Path = Path("runs/surface_depth")
    out: Path = field(default_factory=lambda: packaged_weights() / SURFACE_DEPTH_FILE)
    objects: int = 720
    seed: int = 5
    width: int = 96
    epochs: int = 6
    batch_rows: int = 2048
    weight_decay: float = 1.0
    dropout: float = 0.05


def fit(config: SurfaceDepthConfig, sets: DepthSets) -> Perceptron:
    """Train the perceptron."""
    is_known = np.isfinite(sets.depths)
    features, depths = (torch.from_numpy(x[is_known]) for x in (sets.features, sets.depths))

    def batch_loss(network: nn.Sequential, inputs: Tensor, generator: torch.Generator) -> Tensor:
        chosen = torch.randint(len(inputs), (config.batch_rows,), generator=generator)
        return loss_of(network(inputs[chosen])[:, 0], depths[chosen])

    return fit_perceptron(config, features, torch.ones(len(features), dtype=torch.bool), batch_loss)


def loss_of(found: Tensor, depths: Tensor) -> Tensor:  # [B] both -> []
    """Return the loss: absolute errors, and about how many are not small (Welsch's function)."""
    absolute = F.smooth_l1_loss(found, depths, beta=_ROUNDED_BELOW)
    large = 1.0 - torch.exp(-0.5 * ((found - depths) / _SMALL) ** 2)
    return absolute + _SMALL_WEIGHT * _SMALL * large.mean()


def told(name: str, scorer: Perceptron, sets: DepthSets) -> str:
    """Describe how well the perceptron predicts the depths of points."""
    is_known = np.isfinite(sets.depths)
    if not is_known.any():
        return f"{name}: no point is near a true surface"
    true, features = sets.depths[is_known], sets.features[is_known]
    before, now = (np.abs(x - true) for x in (sets.insets[is_known], scorer(features)))
    return (
        f"{name}, {len(sets):,} points, {is_known.mean():.1%} near a true surface: mean error "
        f"{now.mean():.3f} cells, {before.mean():.3f} without a network; below half a cell "
        f"{(now < 0.5).mean():.1%} and {(before < 0.5).mean():.1%}"
    )


def main(config: SurfaceDepthConfig) -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    files = depth_sets(config)
    train_on_files(config, files, _HELD_OUT_EVERY, functools.partial(fit, config), told)
    return 0


if __name__ == "__main__":
    start(main, SurfaceDepthConfig, __doc__)
