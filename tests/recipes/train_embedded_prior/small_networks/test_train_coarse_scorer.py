import numpy as np
import torch

from gscomplete.shape.planes.features import ANGLES, FEATURES
from recipes.train_embedded_prior.small_networks.train_coarse_scorer import (
    CoarseScorerConfig,
    fit,
    score_of_choice,
)


def test_a_scorer_learns_to_prefer_planes_of_high_score():
    """The score follows one feature: a scorer that learns finds it among noise on new objects."""
    generator = torch.Generator().manual_seed(0)
    features = torch.randn(24, ANGLES, 5, len(FEATURES), generator=generator)
    true_scores = features[..., 3].tanh()
    config = CoarseScorerConfig(steps=200, width=16, batch_objects=8)
    scorer = fit(config, features[:16], true_scores[:16])
    found, best = score_of_choice(scorer, features[16:], true_scores[16:])
    mean = float(true_scores[16:].mean())
    assert found > mean + 0.8 * (best - mean)
    again = fit(config, features[:16], true_scores[:16])
    assert scorer.digest() == again.digest()
    assert all(np.isfinite(value).all() for value in scorer.tensors.values())
