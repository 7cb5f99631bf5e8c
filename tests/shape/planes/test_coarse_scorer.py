import numpy as np

from gscomplete.shape.planes.coarse_scorer import packaged_coarse_scorer
from gscomplete.shape.planes.features import ANGLES, FEATURES, OFFSETS


def test_all_planes_are_scored_at_once():
    features = np.random.default_rng(0).normal(size=(ANGLES, len(OFFSETS), len(FEATURES)))
    logits = packaged_coarse_scorer()(features.astype(np.float32))
    assert logits.shape == (ANGLES, len(OFFSETS))
    assert np.ptp(logits) > 0


def test_extreme_features_give_finite_logits():
    features = np.full((1, 1, len(FEATURES)), 1e6, np.float32)
    assert np.isfinite(packaged_coarse_scorer()(features)).all()
    assert np.isfinite(packaged_coarse_scorer()(-features)).all()
