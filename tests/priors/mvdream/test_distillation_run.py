"""The paper's settings and the default ones through the real loop, with a reduced-width MVDream."""

import dataclasses

import pytest
import torch

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")
pytest.importorskip("transformers", reason="the extra gscomplete[mvdream] is not installed")

from gscomplete.completion.presets import LATENT, PAPER, preset
from gscomplete.fitting.settings import DensifySettings
from gscomplete.priors.base import Guidance
from gscomplete.priors.mvdream.prior import mvdream_prior
from gscomplete.priors.mvdream.weights import open_weights
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half
from tests.builders.steps import steps_of
from tests.builders.tiny_mvdream import TINY_VIEWS, write_original

SETTINGS = dataclasses.replace(
    PAPER,
    steps=120,
    new_splats=150,
    warmup_steps=10,
    densify=DensifySettings(every=25, max_new=250),
)
STOP = 100


@pytest.fixture(scope="module")
def make(tmp_path_factory):
    weights = open_weights(write_original(tmp_path_factory.mktemp("weights")))
    prior = mvdream_prior(weights, torch.device("cpu"), views=TINY_VIEWS)
    conditioning, partial = prior.condition("a red ball"), half(ball(600, 0.45))
    views = ViewDistribution(0.0, 10.0)
    return lambda settings=SETTINGS: steps_of(partial, prior, conditioning, views, settings)


def test_presets_of_this_prior(make):
    prior = make()._prior
    assert preset("default", prior) == LATENT
    assert preset("paper", prior) == PAPER
    assert LATENT.steps <= PAPER.steps // 2


def test_the_default_settings_reach_the_prior_as_they_are(make, monkeypatch):
    """Contrast is pulled back about the background, noise falls, guidance is MVDream's, and
    the first half of the pictures is small."""
    seen, sizes_px = [], []
    job = make(dataclasses.replace(LATENT, steps=6, new_splats=100, warmup_steps=2))
    original = job._prior.distill

    def distill(views, timestep, *arguments):
        seen.append((timestep, arguments[-1]))
        sizes_px.append(views.color.shape[2])
        return original(views, timestep, *arguments)

    monkeypatch.setattr(job._prior, "distill", distill)
    while not job.finished:
        job.step()
    times = [timestep for timestep, _ in seen]
    assert len(times) == 6
    assert times[0] > 800
    assert times[-1] < 300
    side = TINY_VIEWS.resolution_px
    assert sizes_px == [side // 2] * 3 + [side] * 3
    scales = {guidance for _, guidance in seen}
    assert scales == {Guidance(50.0, rescale=0.5, rescale_about="background")}


def test_steps_are_finite_move_only_new_splats_and_resume_exactly(make):
    job = make()
    before = {name: value.clone() for name, value in job.partial.fields()}
    start = job.new_splats
    state, reports = {}, []
    while not job.finished:
        if job.step_number == STOP:
            state = {name: value.clone() for name, value in job.state().items()}
        reports.append(job.step())
    assert len(reports) == SETTINGS.steps
    assert all(0 < report.guidance_loss < float("inf") for report in reports)
    assert {report.preservation_loss is None for report in reports} == {True, False}
    for name, value in job.partial.fields():
        assert torch.equal(value, before[name]), name
        assert not value.requires_grad
        assert value.grad is None
    end = job.new_splats
    assert all(torch.isfinite(value).all() for _, value in end.fields())
    assert len(end) > len(start), "subdivided"
    resumed = make()
    resumed.restore(state)
    for report in reports[STOP:]:
        again = resumed.step()
        assert again.guidance_loss == report.guidance_loss
    for (name, a), (_, b) in zip(end.fields(), resumed.new_splats.fields(), strict=True):
        assert torch.equal(a, b), name


def test_the_gradient_of_a_step_reaches_new_splats(make):
    job, seen = make(), set()
    gradients = job.parameters.gradients

    def record():
        for name, value in job.parameters._values.items():
            if value.grad is not None and float(value.grad.abs().max()) > 0:
                seen.add(name)
        return gradients()

    job.parameters.gradients = record
    job.step()
    # new splats start as spheres, on which a rotation has no effect
    assert seen >= {"means", "log_scales", "opacity_logits", "sh"}
