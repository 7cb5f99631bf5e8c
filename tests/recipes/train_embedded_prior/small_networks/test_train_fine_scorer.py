import dataclasses

import numpy as np
import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.shape.planes.features import ANGLES, FEATURES, OFFSETS
from gscomplete.shape.planes.proposals import FINELY_SCORED
from gscomplete.shape.voxels import COARSE_CELLS
from recipes.train_embedded_prior.small_networks.array_sets import joined
from recipes.train_embedded_prior.small_networks.plane_sets import (
    BEST_PLANES,
    FILE_OBJECTS,
    PlaneSets,
    planes_of,
    posed_object,
)
from recipes.train_embedded_prior.small_networks.train_fine_scorer import (
    FineScorerConfig,
    FineScorerTraining,
    batch_of,
    learning_rate,
    open_run,
    score_of_choice,
)


def simple_sets(count: int = FILE_OBJECTS + 8) -> PlaneSets:
    """Small blobs in the middle; a plane scores more the nearer it is to the middle."""
    rng = np.random.default_rng(0)
    cells = rng.integers(1, 256, (count, 60, 7))
    cells[..., :3] = rng.integers(20, 28, (count, 60, 3))
    planes = FINELY_SCORED + BEST_PLANES
    angles, places = (rng.integers(n, size=(count, planes)) for n in (ANGLES, len(OFFSETS)))
    chosen = np.stack([angles, places], axis=-1)
    offsets = np.array(OFFSETS)[chosen[..., 1]]
    true_scores = (1 - np.abs(offsets) / 0.45).astype(np.float32)
    true_scores[:, FINELY_SCORED:] = 1.0
    chosen[:, FINELY_SCORED:, 1] = OFFSETS.index(0.0)
    return PlaneSets(
        cells.astype(np.uint8),
        np.zeros((count, 3, *(COARSE_CELLS,) * 3), np.uint8),
        chosen.astype(np.int16),
        rng.normal(size=(count, planes, len(FEATURES))).astype(np.float32),
        np.zeros((count, planes), np.float32),
        true_scores,
    )


def test_training_goes_on_as_if_it_had_not_stopped(tmp_path):
    sets = simple_sets()
    config = FineScorerConfig(run=tmp_path, steps=4, batch_objects=2, planes=3)
    features = torch.from_numpy(sets.features)
    whole = FineScorerTraining(config, features)
    for step in range(4):
        whole.advance(batch_of(sets, config, step))
    first = FineScorerTraining(config, features)
    for step in range(2):
        first.advance(batch_of(sets, config, step))
    first.save()
    second = FineScorerTraining(dataclasses.replace(config), features)
    second.resume()
    assert second.step == 2
    for step in range(2, 4):
        second.advance(batch_of(sets, config, step))
    for (name, a), b in zip(
        whole.average.state_dict().items(), second.average.state_dict().values(), strict=True
    ):
        assert torch.equal(a, b), name


def test_another_run_is_not_gone_on_with(tmp_path):
    config = FineScorerConfig(run=tmp_path, steps=4)
    open_run(config)
    open_run(dataclasses.replace(config, steps=5))  # nothing is trained yet
    FineScorerTraining(config, torch.from_numpy(simple_sets(4).features)).save()
    open_run(dataclasses.replace(config, steps=5, workers=1, out=tmp_path / "elsewhere"))
    with pytest.raises(UserError, match=r"scorer\.json: cannot resume .* steps: the run has 5"):
        open_run(config)


def test_a_scorer_learns_where_planes_should_be(tmp_path):
    """Only the volumes tell the offset: the features are noise."""
    sets = simple_sets()
    config = FineScorerConfig(run=tmp_path, steps=24, batch_objects=2, planes=3, average=0.9)
    training = FineScorerTraining(config, torch.from_numpy(sets.features))
    losses = [training.advance(batch_of(sets, config, step)) for step in range(config.steps)]
    assert np.mean(losses[-5:]) < 0.5 * np.mean(losses[:5])
    first, ranked, best = score_of_choice(training.average.eval(), sets.first(12))
    assert first > ranked + 0.8 * (best - ranked) > ranked


def test_the_learning_rate_falls_to_nothing():
    config = FineScorerConfig(steps=1000)
    rates = [learning_rate(config, step) for step in (0, 100, 400, 700, 1000)]
    assert rates[0] < rates[1] == rates[2] == config.learning_rate
    assert rates[3] < rates[2]
    assert rates[4] < 1e-9


def test_planes_of_an_object_are_measured_alike_again():
    made = [planes_of(*posed_object((7, 3, None))) for _ in range(2)]
    for field in dataclasses.fields(PlaneSets):
        one, other = (getattr(sets, field.name) for sets in made)
        np.testing.assert_array_equal(one, other)
    sets = joined(made)
    assert len(sets) == 2
    assert sets.true_scores.shape == (2, FINELY_SCORED + BEST_PLANES)
    assert sets.true_scores[0, FINELY_SCORED] == sets.true_scores[0].max()
    assert (sets.cells[0, :, 6] > 0).any()
