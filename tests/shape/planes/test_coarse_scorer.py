import numpy as np
import pytest

from gscomplete.errors import UserError
from gscomplete.shape.planes.coarse_scorer import CoarseSymmetryScorer, packaged_coarse_scorer
from gscomplete.shape.planes.features import FEATURES


def test_the_scorer_is_a_perceptron():
    scorer = packaged_coarse_scorer()
    t = {name: value.astype(np.float64) for name, value in scorer.tensors.items()}
    features = np.random.default_rng(0).normal(size=(3, 4, len(FEATURES))).astype(np.float32)
    x = (features - t["center"]) / t["spread"]
    for layer in (0, 1):
        x = np.einsum("aof,hf->aoh", x, t[f"weight{layer}"]) + t[f"bias{layer}"]
        x = x * (0.5 + 0.5 * np.tanh(x / 2))
    expected = (np.einsum("aoh,ih->aoi", x, t["weight2"]) + t["bias2"])[..., 0]
    found = scorer(features)
    assert found.shape == (3, 4)
    # float32 over 48-term sums of values up to the logits' size
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


def test_extreme_features_give_finite_logits():
    features = np.full((1, 1, len(FEATURES)), 1e6, np.float32)
    assert np.isfinite(packaged_coarse_scorer()(features)).all()
    assert np.isfinite(packaged_coarse_scorer()(-features)).all()


def test_files_are_checked(tmp_path):
    path = tmp_path / "planes.safetensors"
    with pytest.raises(UserError, match=r"planes\.safetensors"):
        CoarseSymmetryScorer.load(path)
    path.write_bytes(b"junk")
    with pytest.raises(UserError, match="expected a safetensors file"):
        CoarseSymmetryScorer.load(path)
    packaged_coarse_scorer().save(path)
    again = CoarseSymmetryScorer.load(path)
    assert again.digest() == packaged_coarse_scorer().digest()
    narrow = CoarseSymmetryScorer({**again.tensors, "weight0": again.tensors["weight0"][:, 1:]})
    narrow.save(path)
    with pytest.raises(UserError, match="weight0: expected 21 columns, found 20"):
        CoarseSymmetryScorer.load(path)
