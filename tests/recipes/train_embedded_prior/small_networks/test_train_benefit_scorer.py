import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from gscomplete.shape.benefit import FEATURES
from recipes.train_embedded_prior.small_networks.benefit_sets import BenefitSets
from recipes.train_embedded_prior.small_networks.train_benefit_scorer import (
    BenefitScorerConfig,
    fit,
    loss_of,
    told,
)

CONFIG = BenefitScorerConfig(Path("unused"), epochs=40)


def simple_sets(parts: int) -> BenefitSets:
    """Completing gains where one feature is positive; every fourth is a complete object."""
    rng = np.random.default_rng(parts)
    features = rng.normal(size=(parts, len(FEATURES))).astype(np.float32)
    gains = 0.1 * np.tanh(3 * features[:, 2])
    return BenefitSets(features, gains, (np.arange(parts) % 4 == 0).astype(np.float32))


def test_a_scorer_learns_where_completing_gains():
    scorer = fit(CONFIG, simple_sets(600))
    sets = simple_sets(300)
    right = (scorer(sets.features) > 0) == (sets.gains > 0)
    assert right[np.abs(sets.gains) > 0.03].mean() > 0.95
    assert fit(CONFIG, simple_sets(600)).digest() == scorer.digest()
    other = fit(dataclasses.replace(CONFIG, seed=1), simple_sets(600))
    assert other.digest() != scorer.digest()


def test_the_loss_is_least_where_losses_are_left_and_gains_taken():
    gains = torch.tensor([0.1, -0.2, 0.05, -0.05])
    right = torch.sign(gains) * 5
    assert float(loss_of(right, gains)) < float(loss_of(torch.zeros(4), gains))
    assert float(loss_of(torch.zeros(4), gains)) < float(loss_of(-right, gains))
    far = torch.tensor([0.9, -0.9])  # count as .1 and -.2
    assert float(loss_of(right[:2], far)) == pytest.approx(float(loss_of(right[:2], gains[:2])))


def test_what_is_told_counts_complete_objects_and_parts_apart():
    sets = BenefitSets(
        np.eye(4, len(FEATURES), dtype=np.float32),
        np.array([-0.2, 0.1, 0.3, -0.1], np.float32),
        np.array([1, 0, 0, 0], np.float32),
    )
    text = told("here", lambda features: 1 - 9 * features[:, 0] - 9 * features[:, 3], sets)
    complete, parts = text.splitlines()
    assert "complete, 1: 100.0% left" in complete
    assert "-0.2000 to +0.0000" in complete
    assert "parts, 3: 33.3% left" in parts
    assert "+0.1000 to +0.1333" in parts
