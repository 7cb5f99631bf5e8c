"""P prepared for views that come back gives the same pictures, gradients and runs."""

import dataclasses

import pytest
import torch

from gscomplete.completion.presets import RECONSTRUCT
from gscomplete.errors import UserError
from gscomplete.render import prepare_frozen, render
from gscomplete.render.partial_views import PartialViews
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution, join_cameras
from tests.builders.objects import ball
from tests.builders.priors import OraclePrior
from tests.builders.steps import steps_of

TRUTH = ball(1500)
PARTIAL = TRUTH.select(TRUTH.means[:, 0] > 0)
OTHERS = TRUTH.select(TRUTH.means[:, 0] <= 0)
VIEWS = ViewDistribution(0.0, 10.0)


def drawn(views: PartialViews, batches):
    leaves = Splats(**{n: v.clone().requires_grad_() for n, v in OTHERS.fields()})
    picture = views.together(leaves, batches)
    (picture.color.sum() + picture.depth.square().sum()).backward()
    return picture, {name: value.grad for name, value in leaves.fields()}


def test_prepared_views_give_the_same_bits_first_and_again():
    batches = [VIEWS.ring(4, 40), VIEWS.input_camera(40)]
    kept = PartialViews(PARTIAL)
    leaves = Splats(**{n: v.clone().requires_grad_() for n, v in OTHERS.fields()})
    expected = render(leaves, join_cameras(batches), frozen=PARTIAL)
    (expected.color.sum() + expected.depth.square().sum()).backward()
    expected_gradients = {name: value.grad for name, value in leaves.fields()}
    for _ in range(2):
        picture, gradients = drawn(kept, batches)
        assert torch.equal(picture.color, expected.color)
        assert torch.equal(picture.depth, expected.depth)
        for name, value in expected_gradients.items():
            assert torch.equal(gradients[name], value), name
    joined = join_cameras(batches)
    assert torch.equal(kept.alone(joined).color, render(PARTIAL, joined).color)


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


def test_coarse_steps_are_taken_at_half_the_size():
    settings = dataclasses.replace(
        RECONSTRUCT, steps=12, rounds=3, new_splats=300, start="sphere", coarse_until=0.5
    )
    fine = dataclasses.replace(settings, coarse_until=0.0)
    jobs = [steps_of(PARTIAL, OraclePrior(TRUTH), None, VIEWS, s) for s in (settings, fine)]
    for job in jobs:
        while not job.finished:
            job.step()
    coarse, full = (job.new_splats for job in jobs)
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
    kept = PartialViews(PARTIAL)
    first = kept.alone(ring)
    assert not torch.equal(kept.alone(other).alpha, first.alpha)
    assert torch.equal(kept.alone(other).alpha, render(PARTIAL, other).alpha)


def test_the_batch_used_longest_ago_is_forgotten_first(monkeypatch):
    prepared = []

    def spy(partial, cameras):
        prepared.append(float(cameras.positions[0, 1]))
        return prepare_frozen(partial, cameras)

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
