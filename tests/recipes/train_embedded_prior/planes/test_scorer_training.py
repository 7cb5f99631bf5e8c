from pathlib import Path

import numpy as np
import torch

from recipes.train_embedded_prior.planes.scorer_training import ScorerConfig, fit_perceptron


def test_a_perceptron_learns_a_sum_and_rows_that_were_not_asked_count_for_nothing():
    """The scale of features comes from the rows asked alone; the others hold huge numbers."""
    unused = Path("unused")
    config = ScorerConfig(unused, unused, unused, 0, 3, 16, 60, 32, 0.01)
    features = torch.randn(600, 5, generator=torch.Generator().manual_seed(0))
    asked = torch.arange(600) % 3 > 0
    features[~asked] = 1e6
    rows = asked.nonzero()[:, 0]
    targets = features.sum(dim=1)

    def batch_loss(network, inputs, generator):
        chosen = rows[torch.randint(len(rows), (config.batch_parts,), generator=generator)]
        return (network(inputs[chosen])[:, 0] - targets[chosen]).square().mean()

    scorer = fit_perceptron(config, features, asked, batch_loss)
    found, meant = scorer(features[asked].numpy()), targets[asked].numpy()
    assert np.corrcoef(found, meant)[0, 1] > 0.95
    np.testing.assert_allclose(scorer.tensors["center"], features[asked].mean(dim=0), atol=1e-6)
    assert fit_perceptron(config, features, asked, batch_loss).digest() == scorer.digest()
