import dataclasses
import functools

import numpy as np
import pytest
import torch

from recipes.train_embedded_prior.data.shape_dataset import decode_sets
from recipes.train_embedded_prior.gpu import compiled
from recipes.train_embedded_prior.shape_task import (
    ShapeTask,
    cell_weights,
    oblique_turn,
    total_loss,
)
from tests.builders.training import WORDS, stub_source, tiny_shape_run


@pytest.fixture
def task(tmp_path):
    config = dataclasses.replace(tiny_shape_run(tmp_path / "run"), precision="float32")
    return ShapeTask(config, stub_source, WORDS)


@pytest.fixture
def model(task):
    torch.manual_seed(0)
    made = task.make_model()
    for parameter in made.parameters():
        parameter.data += 0.02 * torch.randn_like(parameter)
    return made


def gradients(model):
    found = {n: p.grad.clone() for n, p in model.named_parameters() if p.grad is not None}
    model.zero_grad()
    return found


def test_a_twin_has_the_same_parameters_and_the_same_loss(task, model):
    """Tolerance: norms add up in another order, in single precision; gradients nearly cancel."""
    batch = decode_sets(np.stack([task.spec.maker()(k) for k in range(2)]))
    given = batch, cell_weights(batch.solid), oblique_turn(np.random.default_rng(0))
    twin = compiled.laid_out_twin(task, model)
    assert all(a is b for a, b in zip(model.parameters(), twin.parameters(), strict=True))
    losses, found = [], []
    for network in (model, twin):
        losses.append(total_loss(network, *given))
        losses[-1].backward()
        found.append(gradients(model))
    assert float(losses[1].detach()) == pytest.approx(float(losses[0].detach()), rel=1e-6)
    whole = torch.stack([value.norm() for value in found[0].values()]).norm()
    for name, value in found[0].items():
        assert (found[1][name] - value).norm() <= 1e-3 * value.norm() + 1e-5 * whole, name


def test_what_cannot_be_compiled_runs_as_it_is(task, model, monkeypatch, caplog):
    def refuse(*_, **__):
        def called(*_):
            raise RuntimeError("no compiler")

        return called

    monkeypatch.setattr(torch, "compile", refuse)
    loss = compiled.fastest_loss(task, model, compiled=True)
    assert isinstance(loss, functools.partial)
    assert loss.args == (model,)
    assert "not compiled: RuntimeError: no compiler" in caplog.text
    assert all(parameter.grad is None for parameter in model.parameters())
    assert all(parameter.is_contiguous() for parameter in model.parameters())


@pytest.mark.parametrize("times", [(1.0, 2.0), (2.0, 1.0)])
def test_the_faster_of_both_is_taken(task, model, monkeypatch, times):
    asked = iter(times)  # as it is, compiled
    monkeypatch.setattr(compiled, "_seconds", lambda *_: next(asked))
    loss = compiled.fastest_loss(task, model, compiled=True)
    assert isinstance(loss, functools.partial)
    is_plain = loss.args[0] is model
    assert is_plain == (times[0] < times[1])
    assert all(parameter.is_contiguous() for parameter in model.parameters()) == is_plain
    average = task.make_model()
    before = [parameter.clone() for parameter in average.parameters()]
    compiled.lay_out_like(average, model)
    for kept, own, value in zip(average.parameters(), model.parameters(), before, strict=True):
        assert kept.stride() == own.stride()
        assert torch.equal(kept, value)
