"""P prepared for views that come back gives the same pictures, gradients and runs."""

import dataclasses

import pytest
import torch

from gscomplete.completion.optimise import Completion
from gscomplete.completion.presets import RECONSTRUCT
from gscomplete.completion.settings import SkipSettings
from gscomplete.errors import UserError
from gscomplete.render import prepare_frozen
from gscomplete.render.partial_views import PartialViews
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution, join_cameras
from tests.completion.oracle import OraclePrior, ball

TRUTH = ball()
PARTIAL = TRUTH.select(TRUTH.means[:, 0] > 0)
OTHERS = TRUTH.select(TRUTH.means[:, 0] <= 0)
VIEWS = ViewDistribution(0.0, 10.0)
NOTHING_SKIPPED = SkipSettings(**{field.name: False for field in dataclasses.fields(SkipSettings)})


def drawn(views: PartialViews, batches):
    leaves = Splats(**{n: v.clone().requires_grad_() for n, v in OTHERS.fields()})
    picture = views.together(leaves, batches)
    (picture.color.sum() + picture.depth.square().sum()).backward()
    return picture, {name: value.grad for name, value in leaves.fields()}


def test_prepared_views_give_the_same_bits_first_and_again():
    batches = [VIEWS.ring(4, 40), VIEWS.input_camera(40)]
    kept = PartialViews(PARTIAL)
    plain = PartialViews(PARTIAL, SkipSettings(prepared_partial=False))
    expected, expected_gradients = drawn(plain, batches)
    for _ in range(2):
        picture, gradients = drawn(kept, batches)
        assert torch.equal(picture.color, expected.color)
        assert torch.equal(picture.depth, expected.depth)
        for name, value in expected_gradients.items():
            assert torch.equal(gradients[name], value), name
    joined = join_cameras(batches)
    assert torch.equal(kept.alone(joined).color, plain.alone(joined).color)


def test_memory_is_bounded_and_forgetting_changes_nothing():
    rings = [dataclasses.replace(VIEWS, azimuth_deg=20.0 * k).ring(4, 40) for k in range(5)]
    free = PartialViews(PARTIAL)
    for ring in rings:
        free.alone(ring)
    tight = PartialViews(PARTIAL, max_bytes=free.nbytes // 2)
    for ring in [*rings, *rings]:
        assert torch.equal(tight.alone(ring).color, free.alone(ring).color)
        assert tight.nbytes <= free.nbytes // 2
    tiny = PartialViews(PARTIAL, max_bytes=1)
    assert torch.equal(tiny.alone(rings[0]).color, free.alone(rings[0]).color)


def test_a_run_with_all_skips_is_the_run_without():
    """All but the early stop keep every bit; that one leaves 1e-5 of a pixel's light, and Adam
    turns a gradient's rounding into a step where the gradient is all rounding."""
    settings = dataclasses.replace(RECONSTRUCT, steps=12, rounds=3, new_splats=300, start="sphere")

    def finish(skip):
        job = Completion(
            PARTIAL, OraclePrior(TRUTH), None, VIEWS, dataclasses.replace(settings, skip=skip)
        )
        while not job.finished:
            job.step()
        return job.new_splats()

    usual = finish(SkipSettings())
    for exact in ({"prepared_partial": False, "idle_tiles": False}, {"partial_gradients": False}):
        same = finish(SkipSettings(**exact))
        for (name, a), (_, b) in zip(usual.fields(), same.fields(), strict=True):
            assert torch.equal(a, b), name
    nothing = finish(NOTHING_SKIPPED)
    assert len(nothing) == len(usual)
    moved = (nothing.means - usual.means).abs()
    assert float(moved.mean()) < 1e-5


def test_coarse_steps_are_taken_at_half_the_size():
    settings = dataclasses.replace(
        RECONSTRUCT, steps=12, rounds=3, new_splats=300, start="sphere", coarse_until=0.5
    )
    fine = dataclasses.replace(settings, coarse_until=0.0)
    jobs = [Completion(PARTIAL, OraclePrior(TRUTH), None, VIEWS, s) for s in (settings, fine)]
    for job in jobs:
        while not job.finished:
            job.step()
    coarse, full = (job.new_splats() for job in jobs)
    assert not torch.equal(coarse.means, full.means)
    assert torch.isfinite(coarse.means).all()


@pytest.mark.parametrize(("name", "value"), [("preservation_views", 0), ("coarse_until", 1.5)])
def test_settings_out_of_range_are_named(name, value):
    with pytest.raises(UserError, match=name):
        dataclasses.replace(RECONSTRUCT, **{name: value})


@pytest.mark.parametrize(("name", "factor"), [("focal_px", 1.5), ("center_px", 0.7)])
def test_views_that_differ_in_the_lens_alone_are_others(name, factor):
    ring = VIEWS.ring(4, 24)
    other = dataclasses.replace(ring, **{name: factor * getattr(ring, name)})
    kept, plain = PartialViews(PARTIAL), PartialViews(PARTIAL, SkipSettings(prepared_partial=False))
    first = kept.alone(ring)
    assert not torch.equal(kept.alone(other).alpha, first.alpha)
    assert torch.equal(kept.alone(other).alpha, plain.alone(other).alpha)


def test_the_batch_used_longest_ago_is_forgotten_first(monkeypatch):
    prepared = []

    def spy(partial, cameras, settings):
        prepared.append(float(cameras.positions[0, 1]))
        return prepare_frozen(partial, cameras, settings)

    monkeypatch.setattr("gscomplete.render.partial_views.prepare_frozen", spy)
    a, b, c = (dataclasses.replace(VIEWS, azimuth_deg=90.0 * k).ring(1, 40) for k in range(3))
    free = PartialViews(PARTIAL)
    for ring in (a, b, c):
        free.alone(ring)
    views = PartialViews(PARTIAL, max_bytes=free.nbytes - 1)
    for ring in (a, b, a, c):  # b goes
        views.alone(ring)
    prepared.clear()
    for ring in (a, c):
        views.alone(ring)
    assert prepared == []
    views.alone(b)
    assert len(prepared) == 1
