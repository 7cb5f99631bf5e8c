from pathlib import Path

import numpy as np
import torch

from gscomplete.shape.surface.depth import FEATURES
from recipes.train_embedded_prior.small_networks.depth_sets import DepthSets
from recipes.train_embedded_prior.small_networks.train_surface_depth import (
    SurfaceDepthConfig,
    fit,
    loss_of,
    told,
)

CONFIG = SurfaceDepthConfig(Path("unused"), epochs=15, batch_rows=128, width=16)


def simple_sets(count, seed=0):
    """One feature tells the depth; a tenth is near no true surface."""
    rng = np.random.default_rng(seed)
    features = rng.normal(size=(count, len(FEATURES))).astype(np.float32)
    depths = 1 + 0.5 * features[:, 7]
    depths[::10] = np.nan
    return DepthSets(features, depths, np.ones(count, np.float32))


def test_the_perceptron_learns_the_depth():
    scorer, sets = fit(CONFIG, simple_sets(4000)), simple_sets(500, seed=1)
    is_known = np.isfinite(sets.depths)
    errors = np.abs(scorer(sets.features) - sets.depths)[is_known]
    assert errors.mean() < 0.15  # 0.4 for the mean depth
    assert fit(CONFIG, simple_sets(4000)).digest() == scorer.digest()


def test_a_depth_that_many_points_share_costs_less_than_the_median():
    shared, spread = torch.full((45,), 1.0), torch.linspace(2, 4, 55)
    depths = torch.cat([shared, spread])
    median = torch.full_like(depths, float(depths.median()))
    assert (depths - 1).abs().mean() > (depths - median).abs().mean()
    assert loss_of(torch.ones_like(depths), depths) < loss_of(median, depths)
    assert loss_of(depths, depths) == 0


def test_what_is_told_leaves_out_what_is_near_nothing():
    sets = DepthSets(
        np.zeros((4, len(FEATURES)), np.float32),
        np.array([1, 2, np.nan, 3], np.float32),
        np.array([1, 1, 1, 1], np.float32),
    )
    line = told("here", lambda rows: np.full(len(rows), 2, np.float32), sets)
    assert line == (
        "here, 4 points, 75.0% near a true surface: mean error 0.667 cells, 1.000 without a "
        "network; below half a cell 33.3% and 33.3%"
    )
    sets.depths[:] = np.nan
    assert told("here", lambda rows: rows[:, 0], sets) == "here: no point is near a true surface"
