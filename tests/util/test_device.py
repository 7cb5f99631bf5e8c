"""Which device is chosen, what is told of it, and that results keep to PyTorch as it comes."""

import contextlib
import dataclasses
import threading

import pytest
import torch

import gscomplete
from gscomplete.completion.presets import DISTILL
from gscomplete.evaluate import evaluate
from gscomplete.util.device import _tell_of_unused_cuda, choose_device, plain_torch
from tests.builders.objects import ball
from tests.builders.priors import OraclePrior
from tests.builders.torch_states import STATES, default_type


@pytest.mark.parametrize("cuda", [None, "12.8"])
def test_a_build_for_gpus_without_one_is_told_once(monkeypatch, caplog, cuda):
    _tell_of_unused_cuda.cache_clear()
    monkeypatch.setattr(torch.version, "cuda", cuda)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for _ in range(2):
        assert choose_device("auto") == torch.device("cpu")
    assert choose_device("cpu") == torch.device("cpu")
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == (cuda is not None)
    assert all("built for CUDA 12.8 but finds no GPU" in text for text in told)


TRUTH = ball(600)
PARTIAL = TRUTH.select(TRUTH.means[:, 0] > 0)
PRIOR = OraclePrior(TRUTH)
QUICK = dataclasses.replace(DISTILL, steps=3, new_splats=80, warmup_steps=1)


def completed_and_measured():
    found = gscomplete.complete(
        PARTIAL,
        "a ball",
        prior=PRIOR,
        settings=QUICK,
        view_deg=(0.0, 10.0),
        center_file=(0.0, 0.0, 0.0),
        size_file=0.8,
    )
    report = evaluate(found.in_object_frame, found.partial, found.views, truth=None)
    return found.new_in_file, report.all_views


@pytest.mark.parametrize("state", STATES)
def test_results_do_not_depend_on_what_the_caller_has_set(state):
    expected, numbers = completed_and_measured()
    with STATES[state]():
        found, same_numbers = completed_and_measured()
    for (name, a), (_, b) in zip(found.fields(), expected.fields(), strict=True):
        assert a.dtype == torch.float32, name
        assert torch.equal(a, b), name
    assert same_numbers == numbers


def state_now():
    return (
        torch.is_grad_enabled(),
        torch.is_inference_mode_enabled(),
        torch.is_autocast_enabled("cpu"),
        torch.get_default_device(),
        torch.get_default_dtype(),
    )


@pytest.mark.parametrize("state", STATES)
def test_what_the_caller_has_set_is_set_again(state):
    plain = state_now()
    with STATES[state]():
        before = state_now()
        assert before != plain
        with contextlib.suppress(RuntimeError), plain_torch():
            assert state_now() == plain
            raise RuntimeError
        assert state_now() == before
    assert state_now() == plain


def test_threads_that_need_float32_share_it():
    first, second = threading.Event(), threading.Event()

    def outlast() -> None:
        with plain_torch():
            first.set()
            second.wait(10)
            seen.append(torch.get_default_dtype())

    seen: list[torch.dtype] = []
    with default_type(torch.float64):
        thread = threading.Thread(target=outlast)
        with plain_torch():
            thread.start()
            first.wait(10)
        second.set()
        thread.join()
        assert seen == [torch.float32]
        assert torch.get_default_dtype() == torch.float64
