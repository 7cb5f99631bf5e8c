import dataclasses
import os
import signal

import numpy as np
import pytest
import torch

from gscomplete.shape.voxels import CELLS
from recipes.train_embedded_prior.data import shape_dataset
from recipes.train_embedded_prior.data.shape_dataset import (
    decode_sets,
    pack_cells,
    turn_batch,
    unpack_cells,
)
from recipes.train_embedded_prior.shape_task import (
    ShapeTask,
    cell_weights,
    filled_iou,
    shadow_overlap,
    shape_losses,
    soft_overlap,
    thin_cells,
)
from recipes.train_embedded_prior.state import open_run
from recipes.train_embedded_prior.train import train
from tests.builders.training import WORDS, stub_source, tiny_shape_run


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


def test_what_is_shown_follows_the_shares(tmp_path, monkeypatch):
    """No copies are shown in the share asked for, and where the best scores too little."""
    spec = ShapeTask(tiny_shape_run(tmp_path), stub_source, WORDS).spec

    def shown(no_copies, best_copy=0.5, least_score=0.05):
        monkeypatch.setattr(shape_dataset, "_NO_COPY_SHARE", no_copies)
        monkeypatch.setattr(shape_dataset, "_BEST_COPY_SHARE", best_copy)
        monkeypatch.setattr(shape_dataset, "_LEAST_SCORE", least_score)
        stored = spec.maker()(3)
        volumes = unpack_cells(stored["cells"])[:, 0] > 0
        return volumes, stored["scores"]

    volumes, scores = shown(1.0)
    assert (scores == 0).all()
    assert all((volume == volumes[0]).all() for volume in volumes)
    volumes, scores = shown(0.0, 1.0, 2.0)
    assert (scores == 0).all()
    volumes, scores = shown(0.0, 1.0, -2.0)
    assert scores[0] > 0
    assert (volumes[1] != volumes[0]).any()


def test_little_is_missing_in_the_share_asked_for(tmp_path):
    spec = ShapeTask(tiny_shape_run(tmp_path), stub_source, WORDS).spec

    def posed(share, index):
        data = dataclasses.replace(spec.data, slight_share=share)
        maker = dataclasses.replace(spec, data=data).maker()
        return maker.posed(index, np.random.default_rng(index))

    assert all(len(posed(1.0, k).partial) == len(posed(1.0, k).complete) for k in range(4))
    assert all(len(posed(0.0, k).partial) < len(posed(0.0, k).complete) for k in range(4))
    kept = [len(posed(0.5, k).partial) == len(posed(0.5, k).complete) for k in range(12)]
    assert 0 < sum(kept) < 12


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


def test_sets_go_where_the_network_is(tmp_path):
    config = dataclasses.replace(tiny_shape_run(tmp_path), device="meta")
    task = ShapeTask(config, stub_source, WORDS)
    maker = task.spec.maker()
    stored = np.stack([maker(k) for k in range(2)])
    assert task.loss(task.make_model().to("meta"), stored, 0, slice(0, None, 1)).is_meta


def test_training_lowers_the_loss(tmp_path, batch):
    task = ShapeTask(
        tiny_shape_run(tmp_path, steps=10, batch_sets=2, fresh_sets=1, learning_rate=1e-2),
        stub_source,
        WORDS,
    )
    open_run(task.config, WORDS)

    def loss(model):
        out = model(batch.volumes, batch.evidence, batch.scores, batch.tokens)
        return float(
            shape_losses(out, batch, cell_weights(batch.solid), torch.eye(3))["occupancy"].detach()
        )

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
    found = unpack_cells(pack_cells(volume, 4096, rng)[None])[0]
    np.testing.assert_allclose(found, volume, atol=0.51 / 255)
    few = unpack_cells(pack_cells(volume, 20, rng)[None])[0]
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
    from gscomplete.shape.network import ShapeOutput
    from gscomplete.shape.symmetry import SOURCES

    count = len(batch.solid)
    half = CELLS // 2
    sources = torch.zeros(count, SOURCES + 1, half, half, half)
    out = ShapeOutput(40 * batch.solid - 20, torch.zeros(count, 3, half, half, half), sources)
    assert filled_iou(out, batch)["iou"] == 1.0
    losses = shape_losses(out, batch, cell_weights(batch.solid), torch.eye(3))
    assert float(losses["occupancy"]) < 1e-3
    # Thousands of cells at a probability of 2e-9 of being wrong.
    assert float(losses["overlap"]) < 1e-4
    assert float(losses["shadow"]) < 1e-4
    wrong = dataclasses.replace(out, occupancy=-out.occupancy)
    assert filled_iou(wrong, batch)["iou"] == 0.0


def test_overlaps_of_hard_answers_are_counts():
    generator = torch.Generator().manual_seed(0)
    ours = (torch.rand(2, 6, 6, 6, generator=generator) < 0.1).float()
    truth = (torch.rand(2, 6, 6, 6, generator=generator) < 0.1).float()

    def counted(a, b):
        return [
            float(both / (both + 1.3 * (y - x).clamp(0).sum() + 0.7 * (x - y).clamp(0).sum()))
            for x, y in zip(a, b, strict=True)
            for both in [(x * y).sum()]
        ]

    assert soft_overlap(ours, truth).tolist() == pytest.approx(counted(ours, truth))
    shadows = [counted(ours.amax(d), truth.amax(d)) for d in (1, 2, 3)]
    found = shadow_overlap(ours, truth, (1, 2, 3))
    assert found.tolist() == pytest.approx(np.mean(shadows, axis=0).tolist(), rel=1e-5)


def test_thin_cells_are_those_of_walls_and_rods():
    solid = torch.zeros(1, 12, 12, 12)
    solid[0, 2:6, 2:6, 2:6] = 1
    solid[0, 9, 1:11, 1:11] = 1
    thin = thin_cells(solid)
    assert float(thin[0, 2:6, 2:6, 2:6].sum()) == 0
    assert float(thin[0, 9].sum()) == 100


def test_shadows_pull_a_missing_rod_into_being():
    truth = torch.zeros(1, 8, 8, 8)
    truth[0, 3, 3, :] = 1
    logits = torch.full_like(truth, -4.0, requires_grad=True)
    (1 - shadow_overlap(logits.sigmoid(), truth, (1, 2, 3))).sum().backward()
    assert float(logits.grad[0, 3, 3].max()) < 0 < float(logits.grad[0, 6, 6].min())
