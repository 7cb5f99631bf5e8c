import numpy as np
import pytest
import torch
from torch import nn

from gscomplete.errors import UserError
from gscomplete.networks.perceptron import Perceptron


def perceptron(features: int = 5, width: int = 7) -> Perceptron:
    rng = np.random.default_rng(0)
    shapes = {
        "center": (features,),
        "spread": (features,),
        "weight0": (width, features),
        "bias0": (width,),
        "weight1": (width, width),
        "bias1": (width,),
        "weight2": (1, width),
        "bias2": (1,),
    }
    tensors = {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
    tensors["spread"] = np.abs(tensors["spread"]) + 0.1
    return Perceptron(tensors)


def test_it_is_three_layers_with_silu_between():
    net = perceptron()
    t = {name: value.astype(np.float64) for name, value in net.tensors.items()}
    features = np.random.default_rng(1).normal(size=(3, 4, 5)).astype(np.float32)
    x = (features - t["center"]) / t["spread"]
    for layer in (0, 1):
        x = np.einsum("aof,hf->aoh", x, t[f"weight{layer}"]) + t[f"bias{layer}"]
        x = x * (0.5 + 0.5 * np.tanh(x / 2))
    expected = (np.einsum("aoh,ih->aoi", x, t["weight2"]) + t["bias2"])[..., 0]
    found = net(features)
    assert found.shape == (3, 4)
    # float32 over 7-term sums of values up to the scores' size
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


def test_a_trained_network_gives_the_same_scores():
    torch.manual_seed(0)
    network = nn.Sequential(
        nn.Linear(5, 7), nn.SiLU(), nn.Dropout(0.5), nn.Linear(7, 4), nn.SiLU(), nn.Linear(4, 1)
    )
    center, spread = torch.randn(5), torch.rand(5) + 0.1
    features = torch.randn(9, 5)
    with torch.no_grad():
        expected = network.eval()((features - center) / spread)[:, 0]
    found = Perceptron.of(network, center, spread)(features.numpy())
    # float32 on both sides, in other orders of sums
    np.testing.assert_allclose(found, expected.numpy(), rtol=1e-5, atol=1e-5)


def test_extreme_features_give_finite_scores():
    features = np.full((1, 1, 5), 1e6, np.float32)
    assert np.isfinite(perceptron()(features)).all()
    assert np.isfinite(perceptron()(-features)).all()


def test_files_are_checked(tmp_path):
    path = tmp_path / "planes.safetensors"
    with pytest.raises(UserError, match=r"planes\.safetensors"):
        Perceptron.load(path, 5)
    path.write_bytes(b"junk")
    with pytest.raises(UserError, match="expected a safetensors file"):
        Perceptron.load(path, 5)
    perceptron().save(path)
    assert Perceptron.load(path, 5).digest() == perceptron().digest()
    with pytest.raises(UserError, match="weight0: expected 6 columns, found 5"):
        Perceptron.load(path, 6)


def test_rows_score_alike_alone_and_among_others():
    """A large product would be shared out among BLAS's threads, as many as there are."""
    net = perceptron(features=67, width=96)
    features = np.random.default_rng(2).normal(size=(5000, 67)).astype(np.float32)
    together = net(features)
    for first in (0, 1600, 4992):
        block = features[first : first + 16]
        assert net(block).tobytes() == together[first : first + 16].tobytes()
    assert net(features[:0]).shape == (0,)
