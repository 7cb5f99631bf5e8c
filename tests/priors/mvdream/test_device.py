"""Prior, loop and renderer on one GPU: every operation on tensors of one device (simulated)."""

import dataclasses
import sys
import types
from unittest import mock

import pytest
import torch

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")
pytest.importorskip("transformers", reason="the extra gscomplete[mvdream] is not installed")

from gscomplete.completion import optimise
from gscomplete.completion.optimise import Optimisation
from gscomplete.completion.presets import PAPER, RECONSTRUCT
from gscomplete.priors.mvdream.prior import mvdream_prior
from gscomplete.priors.mvdream.weights import open_weights
from gscomplete.render import cuda
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution
from tests.builders.simulated_gpu import simulated_gpu
from tests.builders.tiny_mvdream import TINY_VIEWS, write_original

NEW = 30


def splats(count: int) -> Splats:
    one = torch.ones(count, 4)
    return Splats(one[:, :3], one, one[:, :3] * 0.1, one[:, 0] * 0.5, one[:, None, :3])


def rasterization(means, quats, scales, opacities, colors, viewmats, Ks, width, height, **more):
    """gsplat's shapes, on the one device that all it is given must be on."""
    tensors = (means, quats, scales, opacities, colors, viewmats, Ks)
    assert {tensor.device.type for tensor in tensors} == {"cuda"}
    total = sum((tensor.sum() for tensor in tensors), start=means.sum())
    images = torch.zeros(len(viewmats), height, width, 5, device=means.device) + total
    return images[..., :4], images[..., 4:], {"means2d": None}


@pytest.fixture
def weights(tmp_path):
    """Opened outside the simulation, which cannot read files."""
    opened = open_weights(write_original(tmp_path))
    networks = {"unet": opened.unet(), "vae": opened.vae(), "text_tower": opened.text_tower()}
    return types.SimpleNamespace(
        config=opened.config,
        fingerprint=opened.fingerprint,
        text_fingerprint=opened.text_fingerprint,
        **{name: (lambda module=module: module) for name, module in networks.items()},
    )


def backward_of(jobs: list[Optimisation]):
    """Stands in for autograd: gives every parameter a gradient where it lies."""

    def backward(loss):
        assert loss.device.type == "cuda"
        for value in jobs[-1].parameters._values.values():
            value.grad = torch.zeros_like(value)

    return backward


def test_steps_of_both_modes_keep_to_the_device(weights, monkeypatch):
    gsplat = types.ModuleType("gsplat")
    gsplat.rasterization = rasterization
    monkeypatch.setitem(sys.modules, "gsplat", gsplat)
    monkeypatch.setattr(cuda, "_pass_center_gradients", lambda *arguments, **more: None)
    monkeypatch.setattr(optimise, "_require_loss", lambda loss, what: None)  # it has no gradients
    start = splats(NEW)
    jobs: list[Optimisation] = []
    partial, settings = splats(50), dataclasses.replace(PAPER, steps=100, new_splats=NEW)
    fitted = dataclasses.replace(RECONSTRUCT, steps=100, new_splats=NEW, start="sphere")
    with simulated_gpu() as gpu, mock.patch.object(torch.Tensor, "backward", backward_of(jobs)):
        prior = mvdream_prior(weights, gpu, views=TINY_VIEWS)
        vae = prior._codec._vae
        assert {p.device for p in vae.encoder.parameters()} == {gpu}
        assert {p.device.type for p in vae.decoder.parameters()} == {"cpu"}, "waits off the device"
        assert {p.dtype for p in vae.parameters()} == {torch.bfloat16}
        conditioning = prior.condition("a red mug")
        for chosen in (settings, fitted):
            views = ViewDistribution(0.0, 10.0)
            job = Optimisation(partial, start, prior, conditioning, views, chosen, gpu)
            jobs.append(job)
            for _ in range(2):
                job.step()
            job._statistics.add(torch.zeros(4, NEW, 2, device=gpu), 32, 32)
            stored = {n: torch.zeros(t.shape, dtype=t.dtype) for n, t in job.state().items()}
            job.restore(stored)  # as read from a checkpoint, on the CPU
            job.step()
            assert {value.device for _, value in job.new_splats.fields()} == {gpu}
        assert {p.device.type for p in vae.decoder.parameters()} == {"cpu"}, "and waits again"


def test_the_simulation_finds_mixed_devices():
    with simulated_gpu() as gpu, pytest.raises(RuntimeError, match="same device"):
        torch.zeros(3, device=gpu) + torch.zeros(3)
