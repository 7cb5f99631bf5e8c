import numpy as np
import torch

from gscomplete.priors.embedded.shape.planes import ANGLES, FEATURES, OFFSETS
from gscomplete.views import ViewDistribution
from recipes.train_embedded_prior.plane_ranker import (
    RankerConfig,
    fit,
    plane_worth,
    worth_of_choice,
)
from recipes.train_embedded_prior.shape_dataset import PosedObject
from tests.priors.embedded.shape.shapes import half, sphere

MIDDLE = OFFSETS.index(0.0)


def test_a_copy_is_worth_what_it_shows_of_the_missing():
    whole = sphere()
    worth = plane_worth(PosedObject(half(whole), whole, ViewDistribution(0.0, 10.0), ""))
    assert worth.shape == (ANGLES, len(OFFSETS))
    assert worth[0, MIDDLE] > 0.9  # the cut itself: all of the other half
    assert abs(worth[ANGLES // 2, MIDDLE]) < 0.1  # a copy onto P shows nothing and harms nothing
    assert worth[0, MIDDLE + 12] < 0.0  # a copy in front of P is nothing but wrong


def test_nothing_missing_is_worth_nothing():
    whole = sphere()
    assert not plane_worth(PosedObject(whole, whole, ViewDistribution(0.0, 10.0), "")).any()


def test_a_ranker_learns_to_prefer_worthy_planes():
    """Worth follows one feature: a ranker that learns finds it among noise on new objects."""
    generator = torch.Generator().manual_seed(0)
    features = torch.randn(24, ANGLES, 5, len(FEATURES), generator=generator)
    worths = features[..., 3].tanh()
    config = RankerConfig(steps=200, width=16, batch_objects=8)
    ranker = fit(config, features[:16], worths[:16])
    found, best = worth_of_choice(ranker, features[16:], worths[16:])
    mean = float(worths[16:].mean())
    assert found > mean + 0.8 * (best - mean)
    again = fit(config, features[:16], worths[:16])
    assert ranker.digest() == again.digest()
    assert all(np.isfinite(value).all() for value in ranker.tensors.values())
