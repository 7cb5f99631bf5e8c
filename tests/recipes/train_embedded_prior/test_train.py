import dataclasses
import json
import os
import signal
import threading

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.priors.embedded.diffusion import NUM_TIMESTEPS
from recipes.train_embedded_prior.data.replicas import GradientExchange, Signals
from recipes.train_embedded_prior.state import open_run
from recipes.train_embedded_prior.train import learning_rate
from recipes.train_embedded_prior.train import train as train_task
from recipes.train_embedded_prior.views_task import ViewsTask, draw_step_noise
from tests.builders.training import WORDS, stub_source, tiny_run


def train(config, source, words):
    return train_task(ViewsTask(config, source, open_run(config, words)))


def weights(state):
    return {
        f"{kind}.{name}": value
        for kind, model in (("model", state.model), ("ema", state.ema))
        for name, value in model.state_dict().items()
    }


def interrupting_source(seed, index):
    """Ask the trainer to stop while the sets of its second step are made."""
    if index == 2:
        os.kill(os.getpid(), signal.SIGTERM)
    return stub_source(seed, index)


def test_interrupted_and_resumed_is_bitwise_the_same(tmp_path):
    straight = train(tiny_run(tmp_path / "a"), stub_source, WORDS)
    part = train(tiny_run(tmp_path / "b"), interrupting_source, WORDS)
    assert part.step == 2
    resumed = train(tiny_run(tmp_path / "b", resume=True), stub_source, WORDS)
    assert straight.step == resumed.step == 4
    for name, value in weights(straight).items():
        assert torch.equal(value, weights(resumed)[name]), name


def test_training_lowers_the_loss_and_logs(tmp_path):
    config = tiny_run(
        tmp_path, steps=40, warmup_steps=5, learning_rate=3e-3, evaluation_sets=2, ema_decay=0.9
    )
    train(config, stub_source, WORDS)
    entries = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    losses = [entry["loss"] for entry in entries if entry["kind"] == "step"]
    # Single steps are at random noise levels: their losses differ by a factor of three.
    assert sum(losses[1:]) / len(losses[1:]) < 0.9 * losses[0]
    held_out = entries[-1]
    assert held_out["kind"] == "held_out"
    assert 0 < held_out["input_mean"] < 1
    assert (tmp_path / "samples-000040.png").stat().st_size > 0


def test_a_run_is_not_overwritten_nor_mixed(tmp_path):
    train(tiny_run(tmp_path, steps=1), stub_source, WORDS)
    with pytest.raises(UserError, match="holds a checkpoint"):
        train(tiny_run(tmp_path, steps=1), stub_source, WORDS)
    with pytest.raises(UserError, match=r"seed: expected 0 .* found 1"):
        train(tiny_run(tmp_path, resume=True, seed=1), stub_source, WORDS)
    (tmp_path / "checkpoint.safetensors").unlink()
    with pytest.raises(UserError, match="checkpoint to resume"):
        train(tiny_run(tmp_path, resume=True), stub_source, WORDS)


def test_new_words_are_appended_on_resume(tmp_path):
    train(tiny_run(tmp_path, steps=1), stub_source, WORDS)
    train(tiny_run(tmp_path, steps=2, resume=True), stub_source, ("apple", *WORDS))
    assert json.loads((tmp_path / "run.json").read_text())["words"] == [*WORDS, "apple"]
    with pytest.raises(UserError, match="vocabulary_size: room for 4"):
        train(tiny_run(tmp_path, resume=True), stub_source, ("u", "v", "w", "x", "y"))


def test_step_noise_is_a_function_of_the_step_and_covers_all_timesteps(tmp_path):
    config = tiny_run(tmp_path, batch_sets=8, drop_input=0.0)
    first, again = draw_step_noise(config, 3), draw_step_noise(config, 3)
    for field in dataclasses.fields(first):
        assert torch.equal(getattr(first, field.name), getattr(again, field.name))
    assert not torch.equal(first.noise, draw_step_noise(config, 4).noise)
    # Stratified before they lean: 1 - (1 - share)^2 undone gives one set per eighth.
    share = 1 - (1 - first.timestep / (NUM_TIMESTEPS - 1)).clamp_min(0).sqrt()
    assert (share * 8).floor().clamp_max(7).sort().values.tolist() == list(range(8))


def test_sets_lean_to_high_noise(tmp_path):
    config = tiny_run(tmp_path, batch_sets=8)
    timestep = torch.cat([draw_step_noise(config, step).timestep for step in range(60)])
    # Density proportional to 1 / sqrt(1 - t): the mean lies at two thirds, the median at 3/4.
    assert float(timestep.mean()) == pytest.approx(2 / 3 * (NUM_TIMESTEPS - 1), abs=10)
    assert float(timestep.median()) == pytest.approx(3 / 4 * (NUM_TIMESTEPS - 1), abs=15)
    assert float(timestep.max()) <= NUM_TIMESTEPS - 1


def test_conditions_are_dropped_as_often_as_asked(tmp_path):
    config = tiny_run(tmp_path, batch_sets=8)
    drawn = [draw_step_noise(config, step) for step in range(150)]
    for name, share in (("keep_input", config.drop_input), ("keep_text", config.drop_text)):
        kept = torch.cat([getattr(noise, name) for noise in drawn]).float().mean()
        assert abs(float(kept) - (1 - share)) < 0.04


def test_learning_rate_warms_up_and_falls_to_zero(tmp_path):
    config = tiny_run(tmp_path, warmup_steps=10, decay_share=0.5, learning_rate=1.0)
    assert learning_rate(config, 0, 0.0) == pytest.approx(0.1)
    assert learning_rate(config, 50, 0.5) == 1.0
    assert learning_rate(config, 50, 0.75) == pytest.approx(0.5)
    assert learning_rate(config, 50, 1.2) == 0.0


def test_replicas_average_gradients_and_follow_the_first():
    models = [torch.nn.Conv2d(3, 2, 3), torch.nn.Conv2d(3, 2, 3)]
    for model in models:
        model.weight.data = model.weight.data.contiguous(memory_format=torch.channels_last)
    exchange = GradientExchange.create(threading, 2, models[0].parameters())
    results = {}

    def run(rank):
        parameters = list(models[rank].parameters())
        for step in range(3):
            for n, parameter in enumerate(parameters):
                values = torch.arange(parameter.numel()).reshape(parameter.shape) + n
                gradient = values.float() * (1 + 2 * rank) + step
                parameter.grad = (
                    gradient.to(memory_format=torch.channels_last) if n == 0 else gradient
                )
            told = exchange.average(
                step, rank, parameters, float(rank), Signals(0.25 * step, step == 2 and rank == 0)
            )
            results[rank, step] = (told, [p.grad.clone() for p in parameters])

    threads = [threading.Thread(target=run, args=(rank,)) for rank in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    for step in range(3):
        (loss, signals), gradients = results[0, step]
        assert (loss, signals) == results[1, step][0]
        assert loss == 0.5
        assert signals == Signals(0.25 * step, step == 2)
        for n, (own, other) in enumerate(zip(gradients, results[1, step][1], strict=True)):
            assert torch.equal(own, other)
            expected = (torch.arange(own.numel()).reshape(own.shape) + n).float() * 2 + step
            torch.testing.assert_close(own, expected)
