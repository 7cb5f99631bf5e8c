from __future__ import annotations

import dataclasses

import torch

from gscomplete.fitting.densify import SPLIT_SHRINK, GradientStatistics
from gscomplete.splats import Splats
from splatcomplete_data.multiview.training.growth import grow
from splatcomplete_data.multiview.training.parameters import PhotoParameters
from splatcomplete_data.multiview.training.settings import GrowthSettings, LearningRates

SETTINGS = GrowthSettings(max_splats=100)


def parameters(opacities, sizes) -> PhotoParameters:
    count = len(opacities)
    quaternions = torch.zeros(count, 4)
    quaternions[:, 0] = 1.0
    splats = Splats(
        torch.arange(3.0 * count).reshape(count, 3),
        quaternions,
        torch.tensor(sizes)[:, None].repeat(1, 3),
        torch.tensor(opacities),
        torch.zeros(count, 4, 3),
    )
    return PhotoParameters(splats, LearningRates(), 1.0)


def statistics(values) -> GradientStatistics:
    result = GradientStatistics(len(values))
    result.total, result.views = torch.tensor(values), torch.ones(len(values))
    return result


def step(target: PhotoParameters, values, settings=SETTINGS, *, prune_large=False):
    return grow(
        target,
        statistics(values),
        settings,
        extent=1.0,
        prune_large=prune_large,
        seed=0,
        step=7,
    )


def test_small_splats_are_cloned_and_large_ones_split():
    target = parameters([0.5, 0.5, 0.5], [0.001, 0.05, 0.05])
    report = step(target, [1.0, 1.0, 0.0])
    assert (report.cloned, report.split) == (1, 1)
    splats = target.splats()
    # Kept: the small one and the third; added: a clone of the first, two halves of the second.
    torch.testing.assert_close(splats.means[:3, 0], torch.tensor([0.0, 6.0, 0.0]))
    torch.testing.assert_close(splats.scales[3:].mean(), torch.tensor(0.05 / SPLIT_SHRINK))
    assert (splats.means[3:] - torch.tensor([3.0, 4.0, 5.0])).norm(dim=1).max() < 0.05 * 5


def test_pruned_splats_are_counted_by_reason_and_never_divided():
    target = parameters([0.001, 0.5, 0.5], [0.001, 0.5, 0.001])
    report = step(target, [9.0, 9.0, 0.0], prune_large=True)
    assert (report.transparent, report.large, report.cloned, report.split) == (1, 1, 0, 0)
    assert len(target) == 1


def test_where_all_would_be_removed_none_is():
    target = parameters([0.001, 0.5], [0.001, 0.5])
    report = step(target, [0.0, 1.0], prune_large=True)
    assert (report.transparent, report.large, report.split) == (0, 0, 1)
    assert len(target) == 3


def test_the_cap_takes_the_largest_gradients_first():
    target = parameters([0.5] * 4, [0.001] * 4)
    report = step(target, [1.0, 4.0, 3.0, 2.0], dataclasses.replace(SETTINGS, max_splats=6))
    assert report.cloned == 2
    torch.testing.assert_close(target.splats().means[4:, 0], torch.tensor([3.0, 6.0]))
    assert step(target, [1.0] * 6, dataclasses.replace(SETTINGS, max_splats=6)).cloned == 0


def test_moments_follow_their_rows():
    target = parameters([0.5, 0.001, 0.5], [0.001] * 3)
    target.splats().means.square().sum().backward()
    target.step(0.0)
    before = target.state()["adam.means.exp_avg"].clone()
    step(target, [0.0, 0.0, 1.0])
    after = target.state()["adam.means.exp_avg"]
    torch.testing.assert_close(after[:2], before[[0, 2]])
    assert (after[2:] == 0).all()


def test_statistics_average_over_the_steps_that_saw_a_splat():
    found = GradientStatistics(2)
    found.add(torch.tensor([[[0.1, 0.0], [0.0, 0.0]]]), 20, 40)
    found.add(torch.tensor([[[0.0, 0.3], [0.0, 0.0]]]), 20, 40)
    # 0.1 per pixel is 1 per half width of 10 px; 0.3 is 6 per half height of 20 px.
    torch.testing.assert_close(found.mean(), torch.tensor([3.5, 0.0]))


def test_lowered_opacities_forget_their_motion():
    target = parameters([0.9, 0.001], [0.01] * 2)
    target.splats().opacities.sum().backward()
    target.step(0.0)
    target.lower_opacities(0.01)
    assert float(target.splats().opacities[0]) <= 0.01 + 1e-6
    assert float(target.splats().opacities[1]) < 0.01
    assert (target.state()["adam.opacity_logits.exp_avg"] == 0).all()
