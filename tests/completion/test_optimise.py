"""The completion loop, driven by a prior that knows the answer."""

import dataclasses

import pytest
import torch

from gscomplete.completion import schedules
from gscomplete.completion.losses import preservation_loss
from gscomplete.completion.presets import DISTILL, RECONSTRUCT
from gscomplete.errors import UserError
from gscomplete.evaluate.metrics import against_truth, preservation
from gscomplete.fitting.densify import prune_mask
from gscomplete.fitting.finite import NonFiniteError
from gscomplete.fitting.settings import DensifySettings, LearningRates
from gscomplete.priors import Guidance
from gscomplete.priors.base import FirstGuess
from gscomplete.splats import concatenate
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball
from tests.builders.priors import GuessingPrior, OraclePrior
from tests.builders.steps import steps_of

TRUTH = ball(1500)
PARTIAL = TRUTH.select(TRUTH.means[:, 0] > 0)
VIEWS = ViewDistribution(0.0, 10.0)
QUICK = {"steps": 60, "new_splats": 400, "warmup_steps": 5}


def completion(settings, prior=None):
    return steps_of(PARTIAL, prior or OraclePrior(TRUTH), None, VIEWS, settings)


def finish(job):
    while not job.finished:
        job.step()
    return job.new_splats


@pytest.mark.parametrize("base", [DISTILL, RECONSTRUCT], ids=["distill", "reconstruct"])
def test_completes_the_hidden_half_and_preserves_the_other(base):
    settings = dataclasses.replace(base, steps=120, new_splats=800, warmup_steps=10, rounds=6)
    whole = concatenate([PARTIAL, finish(completion(settings))])
    around = VIEWS.preview_cameras(64)
    before = against_truth(PARTIAL, PARTIAL, TRUTH, around)
    after = against_truth(whole, PARTIAL, TRUTH, around)
    assert before.hidden_iou < 0.2
    assert after.hidden_iou > 0.75
    errors = preservation(whole, PARTIAL, VIEWS.cameras(VIEWS.low_discrepancy(6), 64))
    assert errors.color < 0.004


def test_preservation_loss_is_what_keeps_the_input():
    """The paper's ablation in small: a prior that wants another object paints over P."""
    other = dataclasses.replace(
        TRUTH, sh=-TRUTH.sh, scales=TRUTH.scales * 1.5, means=TRUTH.means * 1.15
    )
    settings = dataclasses.replace(DISTILL, steps=120, new_splats=800)
    without = dataclasses.replace(settings, preservation_weight=0.0, warmup_steps=0)
    views = VIEWS.cameras(VIEWS.low_discrepancy(6), 64)
    errors = [
        preservation(
            concatenate([PARTIAL, finish(completion(s, OraclePrior(other)))]), PARTIAL, views
        )
        for s in (settings, without)
    ]
    assert errors[0].color * 3 < errors[1].color


def test_same_seed_same_splats_and_other_seed_other_splats():
    settings = dataclasses.replace(RECONSTRUCT, **QUICK, rounds=4)
    one, two = finish(completion(settings)), finish(completion(settings))
    other = finish(completion(dataclasses.replace(settings, seed=1)))
    for (name, a), (_, b) in zip(one.fields(), two.fields(), strict=True):
        assert torch.equal(a, b), name
    assert len(other) != len(one) or not torch.equal(other.means, one.means)


TWICE = dataclasses.replace(DISTILL, prior_every=2)


def test_a_prior_asked_at_every_second_step_pulls_both_alike(monkeypatch):
    asked, gradients = [], []

    class Counting(OraclePrior):
        def distill(self, views, timestep, *arguments, **options):
            asked.append(timestep)
            return super().distill(views, timestep, *arguments, **options)

    settings = dataclasses.replace(TWICE, **QUICK, preservation_weight=0.0)
    job = completion(settings, Counting(TRUTH))

    def stand_still(progress):
        gradients.append({name: g.clone() for name, g in job.parameters.gradients().items()})
        for value in job.parameters._values.values():
            value.grad = None

    monkeypatch.setattr(job.parameters, "step", stand_still)
    reports = [job.step() for _ in range(4)]
    assert len(asked) == 2
    for first, second in ((0, 1), (2, 3)):
        assert reports[first].guidance_loss == reports[second].guidance_loss
        for name, value in gradients[first].items():
            assert torch.equal(gradients[second][name], value), name
    assert reports[0].guidance_loss != reports[2].guidance_loss


@pytest.mark.parametrize(
    "base", [DISTILL, RECONSTRUCT, TWICE], ids=["distill", "reconstruct", "every second step"]
)
def test_resumed_run_equals_unbroken_run(base):
    settings = dataclasses.replace(base, **QUICK, rounds=5)
    unbroken, states = completion(settings), {}
    while not unbroken.finished:
        unbroken.step()
        if unbroken.step_number in (1, 17, 40):
            state = unbroken.state()
            states[unbroken.step_number] = {name: value.clone() for name, value in state.items()}
    assert sorted(states) == [1, 17, 40]
    for step, state in states.items():
        second = completion(settings)
        second.restore(state)
        assert second.step_number == step
        resumed = finish(second)
        for (name, a), (_, b) in zip(unbroken.new_splats.fields(), resumed.fields(), strict=True):
            assert torch.equal(a, b), (step, name)


def test_partial_is_not_touched():
    before = {name: value.clone() for name, value in PARTIAL.fields()}
    finish(completion(dataclasses.replace(DISTILL, **QUICK)))
    for name, value in PARTIAL.fields():
        assert torch.equal(value, before[name]), name


def test_bounds_hold():
    settings = dataclasses.replace(DISTILL, **QUICK)
    job = completion(settings)
    splats = finish(job)
    low = settings.min_scale_px * 1.6 / 32
    assert splats.scales.min() >= low * 0.999
    assert splats.scales.max() <= settings.max_scale * 1.001
    assert splats.base_colors.min() >= -1e-5
    assert splats.base_colors.max() <= 1 + 1e-5
    assert len(splats) <= settings.densify.max_new


def test_nan_from_the_prior_stops_before_the_parameters():
    job = completion(dataclasses.replace(DISTILL, **QUICK), OraclePrior(TRUTH, "loss", 7))
    with pytest.raises(NonFiniteError, match="step 7: the prior's loss"):
        finish(job)
    assert job.step_number == 7
    for name, value in job.new_splats.fields():
        assert torch.isfinite(value).all(), name


@pytest.mark.parametrize(
    ("poison", "culprit"),
    [("loss", "the prior's loss"), ("gradient", "gradient of"), ("huge gradient", "gradient of")],
)
def test_a_poisoned_distillation_step_changes_nothing(poison, culprit):
    """A NaN gradient may come with a finite loss; a huge one would make Adam's moments infinite."""
    job = completion(dataclasses.replace(DISTILL, **QUICK), OraclePrior(TRUTH, poison, 7))
    for _ in range(7):
        job.step()
    before = {name: value.clone() for name, value in job.state().items()}
    with pytest.raises(NonFiniteError, match=f"step 7: {culprit}"):
        job.step()
    assert job.between_updates
    for name, value in job.state().items():
        assert torch.equal(value, before[name]), name


def test_targets_with_nan_are_not_kept():
    """A step may fit another ring than the newest, so a bad one would reach a checkpoint unseen."""
    settings = dataclasses.replace(RECONSTRUCT, **QUICK, rounds=6)
    job = completion(settings, OraclePrior(TRUTH, "target", 2))
    with pytest.raises(NonFiniteError, match="step 20: colour of the prior's targets"):
        finish(job)
    assert all(torch.isfinite(value).all() for value in job.state().values())
    resumed = completion(settings)
    resumed.restore({name: value.clone() for name, value in job.state().items()})
    expected = finish(completion(settings))
    for (name, a), (_, b) in zip(expected.fields(), finish(resumed).fields(), strict=True):
        assert torch.equal(a, b), name


def test_a_box_keeps_its_corners():
    """Views of MVDream show 1.45 object sizes: less than half of it is 0.725, a corner at 0.866."""
    corners = torch.tensor([[0.49, 0.49, 0.49], [0.9, 0.9, 0.9]])
    guess = dataclasses.replace(TRUTH.select(torch.tensor([0, 1])), means=corners)
    prior = GuessingPrior(TRUTH, FirstGuess(guess, ()))
    settings = dataclasses.replace(RECONSTRUCT, **(QUICK | {"steps": 30}), rounds=3)
    job = completion(settings, prior)
    kept = finish(job)
    assert float(kept.means.norm(dim=1).max()) == pytest.approx(0.85, abs=0.05)


@pytest.mark.parametrize("base", [DISTILL, RECONSTRUCT], ids=["distill", "reconstruct"])
@pytest.mark.parametrize(
    "where", ["PartialViews.together", "random_background", "BoundedParameters.step"]
)
def test_a_step_broken_off_is_taken_again_or_marked(base, where, monkeypatch):
    settings = dataclasses.replace(base, **QUICK, rounds=5)
    unbroken = finish(completion(settings))
    job = completion(settings)
    for _ in range(12):
        job.step()

    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(f"gscomplete.completion.optimise.{where}", interrupt)
        with pytest.raises(KeyboardInterrupt):
            job.step()
    assert job.between_updates == (where != "BoundedParameters.step")
    if job.between_updates:
        resumed = completion(settings)
        resumed.restore({name: value.clone() for name, value in job.state().items()})
        for (name, a), (_, b) in zip(unbroken.fields(), finish(resumed).fields(), strict=True):
            assert torch.equal(a, b), name


@pytest.mark.parametrize("base", [DISTILL, RECONSTRUCT], ids=["distill", "reconstruct"])
def test_rates_a_hundred_times_too_large_end_finite(base):
    rates = LearningRates(
        **{k: 100 * v for k, v in dataclasses.asdict(base.learning_rates).items()}
    )
    job = completion(dataclasses.replace(base, **QUICK, learning_rates=rates))
    counts = [len(job.parameters)]
    while not job.finished:
        report = job.step()
        edits = schedules.is_densify_step(job.settings, report.step) or schedules.is_prune_step(
            job.settings, report.step
        )
        assert edits or report.new_splats == counts[-1], "a count changed between edits"
        counts.append(report.new_splats)
    for name, value in job.new_splats.fields():
        assert torch.isfinite(value).all(), name


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_rates_that_make_no_sense_are_refused(rate):
    with pytest.raises(UserError, match=r"learning_rates\.means_final"):
        LearningRates(means_final=rate)


def test_guidance_is_the_prior_s_own_but_for_what_the_rescale_is_about():
    prior = OraclePrior(TRUTH)
    completion(dataclasses.replace(DISTILL, steps=1, rescale_about="background"), prior).step()
    assert prior.guidance_seen == Guidance(9.0, rescale=0.25, rescale_about="background")


def test_the_preservation_loss_is_unmasked_in_the_warm_up_alone(monkeypatch):
    seen = []

    def spy(*arguments, masked):
        seen.append(masked)
        return preservation_loss(*arguments, masked=masked)

    monkeypatch.setattr("gscomplete.completion.optimise.preservation_loss", spy)
    settings = {**QUICK, "warmup_steps": 2, "preservation_every": 1}
    job = completion(dataclasses.replace(DISTILL, **settings))
    for _ in range(4):
        job.step()
    assert seen == [False, False, True, True]


def test_the_preservation_loss_has_its_weight(monkeypatch):
    """With a prior that wants nothing, gradients are the preservation loss's, times lambda."""
    monkeypatch.setattr(OraclePrior, "distill", lambda self, views, *rest: 0.0 * views.color.sum())
    gradients = []
    for weight in (1.0, 3.0):
        settings = {**QUICK, "warmup_steps": 0, "preservation_every": 1}
        job = completion(dataclasses.replace(DISTILL, **settings, preservation_weight=weight))

        def keep_gradient(progress, parameters=job.parameters):
            gradients.append(parameters.gradients()["gradient of opacity_logits"].clone())

        monkeypatch.setattr(job.parameters, "step", keep_gradient)
        job.step()
    assert gradients[0].abs().max() > 0
    torch.testing.assert_close(gradients[1], 3 * gradients[0], rtol=1e-4, atol=1e-7)


def test_step_sizes_and_pruning_follow_the_progress(monkeypatch):
    """Positions move less and less; what is left of failed splats goes in the second half."""
    progress, limits = [], []

    def spy(splats, opacity, radius):
        limits.append(opacity)
        return prune_mask(splats, opacity, radius)

    monkeypatch.setattr("gscomplete.completion.optimise.prune_mask", spy)
    densify = DensifySettings(every=2, final_from=0.5)
    settings = {**QUICK, "steps": 12, "densify": densify}
    job = completion(dataclasses.replace(DISTILL, **settings))
    step = job.parameters.step
    monkeypatch.setattr(job.parameters, "step", lambda at: progress.append(at) or step(at))
    finish(job)
    assert progress == pytest.approx([k / 12 for k in range(12)])
    assert limits == [0.01, 0.01, 0.1, 0.1, 0.1]  # after steps 2, 4, 6, 8 and 10


def test_colors_alone_change_where_only_they_move():
    settings = dataclasses.replace(
        DISTILL,
        **{**QUICK, "moves": "colors", "steps": 12},
        densify=DensifySettings(until=1.0, every=2),
    )
    job = completion(settings)
    before = dataclasses.replace(job.new_splats, sh=job.new_splats.sh.clone())
    after = finish(job)
    for name, value in before.fields():
        # Quaternions are normalised again at every step.
        same = torch.allclose(value, getattr(after, name), rtol=0.0, atol=1e-6)
        assert same == (name != "sh"), name
    wanted = TRUTH.base_colors.mean(dim=0)
    off = [(splats.base_colors - wanted).abs().mean() for splats in (before, after)]
    assert off[1] < off[0]
