"""Subdivision and pruning of new splats."""

import dataclasses

import pytest
import torch

from gscomplete.fitting.densify import GradientStatistics, prune_mask, subdivide
from gscomplete.fitting.parameters import BoundedParameters, Bounds
from gscomplete.fitting.settings import DensifySettings, LearningRates
from gscomplete.splats import Splats
from tests.builders.objects import random_splats


def splats(count: int = 100) -> Splats:
    return dataclasses.replace(random_splats(count), scales=torch.full((count, 3), 0.05))


def parameters(count: int = 100) -> BoundedParameters:
    return BoundedParameters(splats(count), LearningRates(), Bounds(1e-3, 1.0))


def test_statistics_average_all_views_that_saw_a_splat():
    statistics = GradientStatistics(2)
    gradient = torch.zeros(3, 2, 2)
    gradient[0, 0] = torch.tensor([3.0, 4.0])
    gradient[2, 0] = torch.tensor([0.0, 1.0])
    statistics.add(gradient, 2, 2)
    assert statistics.mean().tolist() == [3.0, 0.0]


def test_the_cap_is_hard_and_the_largest_gradients_go_first():
    job = parameters()
    statistics = GradientStatistics(100)
    statistics.total, statistics.views = torch.arange(100.0), torch.ones(100)
    settings = DensifySettings(growth=0.5, max_new=110, split_scale=1.0)
    before = job.splats().detach()
    assert subdivide(job, statistics, settings, seed=0, step=0) == 10
    after = job.splats().detach()
    assert len(after) == 110
    assert torch.allclose(after.means[100:].sort(0).values, before.means[90:].sort(0).values)
    assert subdivide(job, GradientStatistics(110), settings, seed=0, step=1) == 0


def test_split_replaces_a_large_splat_by_two_smaller_ones():
    job = parameters(1)
    statistics = GradientStatistics(1)
    statistics.total, statistics.views = torch.ones(1), torch.ones(1)
    subdivide(job, statistics, DensifySettings(growth=1.0, split_scale=0.01), seed=0, step=0)
    after = job.splats().detach()
    assert len(after) == 2
    assert torch.allclose(after.scales, torch.full((2, 3), 0.05 / 1.6))
    assert not torch.equal(after.means[0], after.means[1])


def pulled(gradients: torch.Tensor) -> GradientStatistics:
    """One view with these gradients."""
    statistics = GradientStatistics(len(gradients))
    statistics.total, statistics.views = gradients, torch.ones(len(gradients))
    return statistics


def test_splats_that_nothing_pulls_are_left_alone():
    job = parameters(10)
    settings = DensifySettings(growth=1.0)
    assert subdivide(job, GradientStatistics(10), settings, seed=0, step=0) == 0


def test_only_a_share_of_the_splats_is_divided_at_once():
    job = parameters(100)
    settings = DensifySettings(growth=0.15, split_scale=1.0)
    assert subdivide(job, pulled(torch.ones(100)), settings, seed=0, step=0) == 15


def needles(count: int) -> BoundedParameters:
    """At the origin, long along their x axes, which their quaternions turn into y."""
    half = 0.5**0.5
    base = dataclasses.replace(
        splats(count),
        means=torch.zeros(count, 3),
        quaternions=torch.tensor([[half, 0.0, 0.0, half]]).repeat(count, 1),
        scales=torch.tensor([[0.1, 1e-3, 1e-3]]).repeat(count, 1),
    )
    return BoundedParameters(base, LearningRates(), Bounds(1e-6, 1.0))


def test_halves_lie_along_the_splat_that_they_are_of():
    job = needles(200)
    assert subdivide(job, pulled(torch.ones(200)), DensifySettings(growth=1.0), 0, 0) == 200
    means = job.splats().means.detach()
    assert 0.08 < float(means[:, 1].std()) < 0.12  # 400 draws of 0.1: +- 0.004
    assert float(means[:, [0, 2]].abs().max()) < 6e-3


def test_one_long_side_makes_a_splat_large():
    job = needles(1)
    subdivide(job, pulled(torch.ones(1)), DensifySettings(growth=1.0, split_scale=0.05), 0, 0)
    assert job.splats().scales.detach()[:, 0].tolist() == pytest.approx([0.1 / 1.6] * 2)


@pytest.mark.parametrize("moment", ["exp_avg", "exp_avg_sq"])
def test_kept_rows_keep_their_momentum(moment):
    job = parameters(10)
    job.splats().means.square().sum().backward()
    job.step(0.0)
    moments = job.state()[f"adam.means.{moment}"].clone()
    assert moments.any()
    mask = torch.arange(10) % 2 == 0
    job.edit(mask)
    assert torch.equal(job.state()[f"adam.means.{moment}"], moments[mask])
    job.edit(torch.ones(5, dtype=torch.bool), splats(3))
    state = job.state()[f"adam.means.{moment}"]
    assert torch.equal(state[:5], moments[mask])
    assert not state[5:].any()


def test_pruning_gives_one_reason_per_splat():
    base = splats()
    keep, report = prune_mask(base, prune_opacity=0.3, max_radius=1.5)
    assert report.total == int((~keep).sum())
    assert report.transparent == int((base.opacities < 0.3).sum())
    assert report.far == int(((base.opacities >= 0.3) & (base.means.norm(dim=1) > 1.5)).sum())
