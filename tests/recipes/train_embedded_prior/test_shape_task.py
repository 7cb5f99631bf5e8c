import dataclasses
import os
import signal

import numpy as np
import pytest
import torch

from gscomplete.priors.embedded.shape.grid import CELLS
from recipes.train_embedded_prior.shape_dataset import (
    decode_sets,
    pack_cells,
    turn_batch,
    unpack_cells,
)
from recipes.train_embedded_prior.shape_task import ShapeTask, filled_iou, shape_losses
from recipes.train_embedded_prior.state import open_run
from recipes.train_embedded_prior.train import train
from tests.recipes.train_embedded_prior.stub import WORDS, stub_source, tiny_shape_run


def run(config, source=stub_source):
    return train(ShapeTask(config, source, open_run(config, WORDS)))


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    task = ShapeTask(tiny_shape_run(tmp_path_factory.mktemp("run")), stub_source, WORDS)
    maker = task.spec.maker()
    return decode_sets(np.stack([maker(k) for k in range(2)]))


def test_sets_are_a_function_of_seed_and_index(tmp_path):
    spec = ShapeTask(tiny_shape_run(tmp_path), stub_source, WORDS).spec
    assert spec.maker()(3).tobytes() == spec.maker()(3).tobytes()
    assert spec.maker()(3).tobytes() != spec.maker()(4).tobytes()
    assert spec.maker(9)(3).tobytes() != spec.maker()(3).tobytes()


def interrupting_source(seed, index):
    """Ask the trainer to stop while the sets of its second step are made."""
    if index == 2:
        os.kill(os.getpid(), signal.SIGTERM)
    return stub_source(seed, index)


def test_interrupted_and_resumed_is_bitwise_the_same(tmp_path):
    straight = run(tiny_shape_run(tmp_path / "a"))
    part = run(tiny_shape_run(tmp_path / "b"), interrupting_source)
    assert part.step == 2
    resumed = run(tiny_shape_run(tmp_path / "b", resume=True))
    assert straight.step == resumed.step == 4
    for name, value in straight.ema.state_dict().items():
        assert torch.equal(value, resumed.ema.state_dict()[name]), name


def test_training_lowers_the_loss(tmp_path, batch):
    task = ShapeTask(tiny_shape_run(tmp_path, steps=40, learning_rate=1e-2), stub_source, WORDS)
    open_run(task.config, WORDS)

    def loss(model):
        out = model(batch.volumes, batch.evidence, batch.scores, batch.tokens)
        return float(shape_losses(out, batch)["occupancy"].detach())

    before = loss(task.make_model())
    assert loss(train(task).model) < 0.6 * before


def test_replayed_sets_are_older_and_near(tmp_path):
    config = tiny_shape_run(tmp_path, batch_sets=6, fresh_sets=2, replay_shards=3)
    task = ShapeTask(config, stub_source, WORDS)
    for step in range(60):
        indices = list(task.set_indices(step))
        assert len(indices) == 6
        assert indices[-2:] == [2 * step, 2 * step + 1]
        assert all(0 <= k <= 2 * step + 1 for k in indices)
        assert min(indices) >= 2 * step - task.behind * config.shard_sets


def test_cells_survive_storage():
    rng = np.random.default_rng(0)
    volume = np.zeros((4, CELLS, CELLS, CELLS), np.float32)
    place = rng.integers(CELLS, size=(50, 3))
    volume[:, place[:, 0], place[:, 1], place[:, 2]] = rng.random((4, 50)) * 0.9 + 0.1
    found = unpack_cells(pack_cells(volume, 4096, rng))
    np.testing.assert_allclose(found, volume, atol=0.51 / 255)
    few = unpack_cells(pack_cells(volume, 20, rng))
    assert (few[0] > 0).sum() == 20
    assert np.all((few[0] == 0) | (np.abs(few[0] - volume[0]) < 0.01))


def test_turning_a_batch_turns_everything_alike(batch):
    turned = turn_batch(batch, 1, True)
    assert torch.equal(turn_batch(turned, 0, True).solid, torch.rot90(batch.solid, 1, (-3, -2)))
    both = (turned.surface[:, 0] > 0) & (turned.solid > 0)
    before = (batch.surface[:, 0] > 0) & (batch.solid > 0)
    assert int(both.sum()) == int(before.sum())
    assert torch.equal(turned.tokens, batch.tokens)


def test_the_truth_scores_full_marks(batch):
    from gscomplete.priors.embedded.shape.inputs import SOURCES
    from gscomplete.priors.embedded.shape.model import ShapeOutput

    count = len(batch.solid)
    half = CELLS // 2
    sources = torch.zeros(count, SOURCES + 1, half, half, half)
    out = ShapeOutput(40 * batch.solid - 20, torch.zeros(count, 3, half, half, half), sources)
    assert filled_iou(out, batch)["iou"] == 1.0
    assert float(shape_losses(out, batch)["occupancy"]) < 1e-3
    wrong = dataclasses.replace(out, occupancy=-out.occupancy)
    assert filled_iou(wrong, batch)["iou"] == 0.0
