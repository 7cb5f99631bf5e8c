"""Metrics equal their definitions on hand-made renders, and stay sane at the edges."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from gscomplete.evaluate import PreservationErrors, against_truth, preservation
from gscomplete.evaluate.metrics import preservation_of_renders, truth_errors_of_renders
from gscomplete.render import Render
from gscomplete.splats import Splats, concatenate
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, round_splats


def random_render(seed: int, views: int = 2, size: int = 7) -> Render:
    generator = torch.Generator().manual_seed(seed)
    color = torch.rand(views, size, size, 3, generator=generator)
    alpha = torch.rand(views, size, size, generator=generator)
    alpha = torch.where(alpha < 0.4, torch.zeros_like(alpha), alpha)
    depth = (2.0 + torch.rand(views, size, size, generator=generator)) * (alpha > 0)
    return Render(color, alpha, depth)


def slow_preservation(completed: Render, partial: Render) -> tuple[float, float, float]:
    """Pixel by pixel, as the module's head defines it."""
    color = depth = weight = image = 0.0
    arrays = [
        tensor.double().numpy()
        for r in (completed, partial)
        for tensor in (r.color, r.alpha, r.depth)
    ]
    o_color, o_alpha, o_depth, p_color, p_alpha, p_depth = arrays
    for index in np.ndindex(p_alpha.shape):
        mask = p_alpha[index]
        squared = float(np.mean((o_color[index] - p_color[index]) ** 2))
        missing = o_alpha[index] < 1 / 255
        depth += mask * (1.0 if missing else (o_depth[index] - p_depth[index]) ** 2)
        color += mask * squared
        image += mask**2 * squared
        weight += mask
    return color / weight, image / p_alpha.size, depth / weight


@given(st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_preservation_equals_its_definition(seed: int) -> None:
    completed, partial = random_render(seed), random_render(seed + 1)
    errors = preservation_of_renders(completed, partial)
    expected = slow_preservation(completed, partial)
    found = (errors.color, errors.color_image_mean, errors.depth)
    assert found == pytest.approx(expected, rel=1e-9)
    weights = partial.alpha.double().sum(dim=(1, 2))
    weights = weights / weights.sum()
    assert float((weights * torch.tensor(errors.color_per_view)).sum()) == pytest.approx(
        errors.color
    )


@given(st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_what_happens_outside_the_mask_does_not_count(seed: int) -> None:
    completed, partial = random_render(seed), random_render(seed + 1)
    outside = partial.alpha == 0
    color = torch.where(outside[..., None], torch.rand_like(completed.color), completed.color)
    depth = torch.where(outside, torch.full_like(completed.depth, 9.0), completed.depth)
    changed = Render(color, completed.alpha, depth)
    assert preservation_of_renders(changed, partial) == preservation_of_renders(completed, partial)


def test_identical_renders_have_no_error() -> None:
    partial = random_render(3)
    errors = preservation_of_renders(partial, partial)
    assert isinstance(errors, PreservationErrors)
    assert (errors.color, errors.color_image_mean, errors.depth) == (0.0, 0.0, 0.0)


def test_invisible_input_is_an_error() -> None:
    nothing = Render(torch.zeros(1, 4, 4, 3), torch.zeros(1, 4, 4), torch.zeros(1, 4, 4))
    with pytest.raises(UserError, match="not visible"):
        preservation_of_renders(random_render(0, 1, 4), nothing)
    with pytest.raises(UserError, match="visible"):
        truth_errors_of_renders(nothing, nothing, nothing)


@given(st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_truth_errors_equal_their_definition(seed: int) -> None:
    completed, partial, truth = (random_render(seed + i) for i in range(3))
    errors = truth_errors_of_renders(completed, partial, truth)
    ours = {tuple(i) for i in torch.nonzero(completed.alpha >= 0.5).tolist()}
    real = {tuple(i) for i in torch.nonzero(truth.alpha >= 0.5).tolist()}
    seen = {tuple(i) for i in torch.nonzero(partial.alpha >= 0.5).tolist()}
    hidden = (ours | real) - seen
    both = (ours & real) - seen
    of_view = [[{i for i in cells if i[0] == view} for cells in (ours, real)] for view in (0, 1)]
    for found, cells in (
        (errors.silhouette_iou, lambda o, t: o & t),
        (errors.silhouette_missed, lambda o, t: t - o),
        (errors.silhouette_excess, lambda o, t: o - t),
    ):
        expected = np.mean([len(cells(o, t)) / len(o | t) for o, t in of_view])
        assert found == pytest.approx(expected)
    assert errors.hidden_iou == pytest.approx(len(both) / len(hidden))
    assert errors.hidden_precision == pytest.approx(len(both) / len(ours - seen))
    assert errors.hidden_recall == pytest.approx(len(both) / len(real - seen))
    squared = [float(((completed.color[i] - truth.color[i]) ** 2).mean()) for i in hidden]
    assert errors.hidden_color_psnr_db == pytest.approx(-10 * math.log10(np.mean(squared)))


def test_perfect_and_empty_completions() -> None:
    truth, partial = random_render(1), random_render(2)
    perfect = truth_errors_of_renders(truth, partial, truth)
    assert perfect.hidden_iou == 1.0
    assert perfect.hidden_color_psnr_db == pytest.approx(100.0)
    empty = Render(torch.full_like(truth.color, 0.5), 0 * truth.alpha, 0 * truth.depth)
    nothing = truth_errors_of_renders(empty, partial, truth)
    assert (nothing.hidden_iou, nothing.hidden_recall, nothing.hidden_precision) == (0.0, 0.0, 1.0)
    covered = Render(truth.color, torch.ones_like(truth.alpha), truth.depth)
    no_region = truth_errors_of_renders(truth, covered, truth)
    assert no_region.hidden_iou == 1.0
    assert no_region.hidden_color_psnr_db is None


def red_green_blue() -> list[Splats]:
    """Balls of radius 0.2: in front of c, behind that one, and before it."""
    places = ((0.2, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.6, 0.0, 0.0))
    around = ball(400, 0.2).means
    colors = torch.eye(3)
    return [
        round_splats(around + torch.tensor(place), color=color)
        for place, color in zip(places, colors, strict=True)
    ]


def test_covering_the_input_costs_and_adding_behind_it_does_not() -> None:
    partial, green, blue = red_green_blue()
    behind, before = concatenate([partial, green]), concatenate([partial, blue])
    camera = ViewDistribution(0, 0).input_camera(48)
    hidden, covered = (preservation(o, partial, camera) for o in (behind, before))
    assert hidden.color < 2e-3 < 0.1 < covered.color
    assert hidden.depth < 2e-2 < 0.05 < covered.depth
    around = ViewDistribution(0, 0).preview_cameras(48)
    right = against_truth(behind, partial, behind, around)
    wrong = against_truth(before, partial, behind, around)
    assert right.hidden_iou == 1.0
    assert wrong.hidden_iou < 0.2
    assert (wrong.hidden_color_psnr_db or 0) < 20


def test_views_that_show_neither_have_no_say_in_the_silhouette() -> None:
    """The second view is empty in O as in T: the first alone is compared."""
    truth = torch.zeros(2, 4, 4)
    truth[0] = 1.0
    half = truth.clone()
    half[0, :2] = 0.0
    color = torch.zeros(2, 4, 4, 3)
    nothing = Render(color, torch.zeros(2, 4, 4), torch.zeros(2, 4, 4))
    real = Render(color, truth, 2 * truth)
    for alpha, iou in ((truth, 1.0), (half, 0.5)):
        errors = truth_errors_of_renders(Render(color, alpha, 2 * alpha), nothing, real)
        assert errors.silhouette_iou == iou
