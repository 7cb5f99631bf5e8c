import dataclasses
import logging
from pathlib import Path

import numpy as np
import torch

from gscomplete.networks.perceptron import Perceptron
from recipes.train_embedded_prior.small_networks.perceptron_training import (
    PerceptronConfig,
    fit_perceptron,
    train_on_files,
)


def test_a_perceptron_learns_a_sum_and_rows_that_were_not_asked_count_for_nothing():
    """The scale of features comes from the rows asked alone; the others hold huge numbers."""
    unused = Path("unused")
    config = PerceptronConfig(unused, unused, unused, 0, 3, 16, 20, 32, 0.01)
    features = torch.randn(600, 5, generator=torch.Generator().manual_seed(0))
    asked = torch.arange(600) % 3 > 0
    features[~asked] = 1e6
    rows = asked.nonzero()[:, 0]
    targets = features.sum(dim=1)

    def batch_loss(network, inputs, generator):
        chosen = rows[torch.randint(len(rows), (config.batch_rows,), generator=generator)]
        return (network(inputs[chosen])[:, 0] - targets[chosen]).square().mean()

    scorer = fit_perceptron(config, features, asked, batch_loss)
    found, meant = scorer(features[asked].numpy()), targets[asked].numpy()
    assert np.corrcoef(found, meant)[0, 1] > 0.95
    np.testing.assert_allclose(scorer.tensors["center"], features[asked].mean(dim=0), atol=1e-6)
    assert fit_perceptron(config, features, asked, batch_loss).digest() == scorer.digest()


@dataclasses.dataclass(frozen=True)
class Numbers:
    """The least that files of parts are."""

    values: np.ndarray


def test_every_so_many_files_are_held_out_and_all_are_learned_from_at_the_end(tmp_path, caplog):
    config = PerceptronConfig(tmp_path, tmp_path, tmp_path / "x.safetensors", 1, 0, 4, 1, 2, 0.1)
    learned = []

    def fit(sets):
        learned.append(sets.values.tolist())
        rows = torch.arange(8.0).reshape(4, 2)
        every = torch.ones(4, dtype=torch.bool)
        return fit_perceptron(config, rows, every, lambda network, x, _: network(x).square().sum())

    def told(name, scorer, sets):
        return f"{name}: {sets.values.tolist()}"

    with caplog.at_level(logging.INFO):
        train_on_files(config, [Numbers(np.array([k])) for k in range(5)], 3, fit, told)
    assert learned == [[1, 2, 4], [0, 1, 2, 3, 4]]
    assert "held out: [0, 3]" in caplog.text
    assert "learned from: [0, 1, 2, 3, 4]" in caplog.text
    assert Perceptron.load(config.out, 2).digest()
