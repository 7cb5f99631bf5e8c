"""Bounds on the errors over V: reached, at no cost to what V does not see."""

import dataclasses

import pytest
import torch

from gscomplete.completion.preserve import bounds as hard_preservation
from gscomplete.completion.preserve.bounds import preserve_hard
from gscomplete.completion.preserve.fit import MARGIN, masked_errors, outside_cameras
from gscomplete.completion.rings import inside_distribution
from gscomplete.completion.settings import HardPreservationSettings
from gscomplete.errors import UserError
from gscomplete.evaluate.metrics import MID_GREY, preservation, preservation_of_renders
from gscomplete.render import render
from gscomplete.splats import Splats, concatenate
from gscomplete.views import ViewDistribution
from tests.builders.objects import round_splats

SMALL = HardPreservationSettings(steps=6)
VIEWS = ViewDistribution(0.0, 10.0, azimuth_range_deg=30.0)


@pytest.fixture(autouse=True)
def _few_small_pictures(monkeypatch):
    sizes = {"CHECK_PX": 48, "FIT_PX": 32}
    counts = {"CHECK_VIEWS": 6, "FIRST_VIEWS": 2, "FIT_VIEWS": 4}
    for name, value in (sizes | counts).items():
        monkeypatch.setattr(hard_preservation, f"_{name}", value)


def wall(x: float, color: tuple[float, float, float], side: int = 12, seed: int = 0) -> Splats:
    """A square of round splats across the x axis, at ``x``; V looks from +x."""
    line = torch.linspace(-0.3, 0.3, side)
    y, z = (grid.flatten() for grid in torch.meshgrid(line, line, indexing="ij"))
    places = torch.stack([torch.full((side * side,), x), y, z], dim=1)
    return round_splats(places, opacity=0.95, color=color)


PARTIAL = wall(0.2, (0.8, 0.2, 0.1))
BEHIND = wall(-0.2, (0.1, 0.3, 0.9), side=8)
IN_FRONT = wall(0.35, (0.1, 0.8, 0.2), side=5)
BESIDE = dataclasses.replace(BEHIND, means=BEHIND.means * 0.5 + torch.tensor([0.1, 0.0, 0.75]))


def errors(new: Splats, size_px: int = 48):
    unseen = VIEWS.cameras(VIEWS.sample(7, 0, 12), size_px)
    return preservation(concatenate([PARTIAL, new]), PARTIAL, unseen)


def test_the_errors_are_those_of_the_evaluation():
    new = concatenate([IN_FRONT, BEHIND])
    cameras = VIEWS.cameras(VIEWS.low_discrepancy(3), 32)
    grey = torch.tensor(MID_GREY)
    drawn, target = render(new, cameras, grey, frozen=PARTIAL), render(PARTIAL, cameras, grey)
    color, depth = masked_errors(drawn, target)
    expected = preservation_of_renders(drawn, target)
    assert float(color) == pytest.approx(expected.color, rel=1e-4)
    assert float(depth) == pytest.approx(expected.depth, rel=1e-4)
    assert expected.color > 1e-3


@pytest.mark.parametrize("rounds", [10, 0])
def test_the_bounds_hold_from_views_never_looked_at(rounds):
    new = concatenate([IN_FRONT, BEHIND, BESIDE])
    before = errors(new)
    assert before.color > 0.01
    assert before.depth > 1e-3
    settings = dataclasses.replace(SMALL, rounds=rounds)
    result = preserve_hard(new, PARTIAL, VIEWS, settings)
    after = errors(result.splats)
    assert result.report.met
    assert after.color <= settings.color_bound
    assert after.depth <= settings.depth_bound
    assert (result.report.rounds > 0) == (rounds > 0)
    # What V cannot see, or sees beside P, is what the completion is for.
    unseen = len(IN_FRONT) + len(BEHIND)
    for name, value in result.splats.fields():
        kept = value[int(result.kept[:unseen].sum()) :][: len(BESIDE)]
        assert torch.equal(kept, dict(new.fields())[name][unseen:]), name


def test_what_shows_through_a_thin_input_is_covered_rather_than_faded(monkeypatch):
    thin = dataclasses.replace(PARTIAL, opacities=torch.full((len(PARTIAL),), 0.6))
    far = dataclasses.replace(BEHIND, means=BEHIND.means - torch.tensor([0.3, 0.0, 0.0]))
    bounds = dataclasses.replace(SMALL, color_bound=0.2, depth_bound=0.006)
    backed = preserve_hard(far, thin, VIEWS, bounds)
    monkeypatch.setattr(hard_preservation._Work, "backed", lambda self, *given: given)
    bare = preserve_hard(far, thin, VIEWS, bounds)
    assert bare.report.before == backed.report.before
    assert bare.report.before.depth > bounds.depth_bound
    assert bare.report.added == 0 < backed.report.added
    assert bare.report.met
    assert backed.report.met
    assert bare.report.untouched < backed.report.untouched
    count = int(backed.kept.sum())
    assert len(backed.splats) == count + backed.report.added
    assert f"{backed.report.added:,} added" in backed.report.summary
    # The copies stand behind P, where V looks from +x.
    assert float(backed.splats.means[count:, 0].max()) < 0.2


def test_every_splat_is_accounted_for_and_p_is_not_touched():
    new = concatenate([IN_FRONT, BEHIND])
    values = [value.clone() for _, value in PARTIAL.fields()]
    originals = [value.clone() for _, value in new.fields()]
    result = preserve_hard(new, PARTIAL, VIEWS, SMALL)
    report = result.report
    assert report.total == len(new)
    assert int(result.kept.sum()) + report.added == len(result.splats)
    assert len(new) - int(result.kept.sum()) == sum(report.dropped.values())
    for value, (_, now) in zip(values + originals, [*PARTIAL.fields(), *new.fields()], strict=True):
        assert torch.equal(value, now)
    rows = [
        (value[: len(old[result.kept])] == old[result.kept])
        .reshape(len(old[result.kept]), -1)
        .all(1)
        for (_, value), old in zip(result.splats.fields(), originals, strict=True)
    ]
    assert int(torch.stack(rows).all(0).sum()) == report.untouched > 0
    for reason, count in report.dropped.items():
        assert f"{count:,} removed ({reason.replace('_', ' ')})" in report.summary


def test_within_the_bounds_nothing_is_changed():
    result = preserve_hard(BESIDE, PARTIAL, VIEWS, SMALL)
    assert bool(result.kept.all())
    assert result.report.untouched == len(BESIDE)
    assert result.report.rounds == result.report.fadings == 0
    for (_, old), (_, new) in zip(BESIDE.fields(), result.splats.fields(), strict=True):
        assert torch.equal(old, new)


@pytest.mark.parametrize(("times_found", "views"), [(5.1, 2), (3.9, 6), (0.5, 6)])
def test_few_views_are_enough_far_below_the_bounds_alone(times_found, views):
    new = BEHIND  # shows through the gaps of P by little
    all_of_it = HardPreservationSettings(color_bound=1e-9, depth_bound=10.0, rounds=0)
    few = hard_preservation._Work(new, PARTIAL, VIEWS, all_of_it, 0).check(new, few=True)
    assert few.views == 2
    assert few.color > 0
    bound = times_found * few.color / MARGIN
    settings = dataclasses.replace(all_of_it, color_bound=bound)
    report = preserve_hard(new, PARTIAL, VIEWS, settings).report
    assert report.before.views == report.after.views == views
    assert (report.untouched == len(new)) == (times_found > 1)


def test_the_result_is_a_function_of_its_input_and_the_seed():
    new = concatenate([IN_FRONT, BEHIND])
    first, again = (preserve_hard(new, PARTIAL, VIEWS, SMALL, seed=3) for _ in range(2))
    for (_, a), (_, b) in zip(first.splats.fields(), again.splats.fields(), strict=True):
        assert torch.equal(a, b)


def test_a_bound_near_zero_is_reached_by_removing_what_is_in_the_way(monkeypatch):
    monkeypatch.setattr(hard_preservation, "_FADE_SWEEPS", 0)
    tight = dataclasses.replace(SMALL, color_bound=1e-12, depth_bound=1e-12, rounds=1)
    new = concatenate([IN_FRONT, BESIDE])
    result = preserve_hard(new, PARTIAL, VIEWS, tight)
    assert result.report.met
    assert not bool(result.kept[: len(IN_FRONT)].any())
    assert result.report.dropped["in_the_way"] > 0
    assert int(result.kept[len(IN_FRONT) :].sum()) > len(BESIDE) // 2


def test_opaque_splats_that_fill_the_picture_are_found():
    # Everywhere at the renderer's largest alpha, where opacities get no gradient.
    giant = round_splats([[0.6, 0.0, 0.0]], scale=50.0, opacity=1.0, color=(0.1, 0.9, 0.1))
    result = preserve_hard(giant, PARTIAL, VIEWS, dataclasses.replace(SMALL, rounds=0))
    assert result.report.before.color > 0.1
    assert result.report.met
    assert float(result.splats.opacities[: int(result.kept.sum())].sum()) < 0.1


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_to_do_is_no_error(count):
    result = preserve_hard(BEHIND.select(torch.arange(count)), PARTIAL, VIEWS, SMALL)
    assert result.report.met
    assert len(result.splats) == count


def test_views_from_outside_v_are_outside_v():
    cameras = outside_cameras(VIEWS, 32)
    assert cameras is not None
    assert not bool(inside_distribution(cameras, VIEWS).any())
    assert outside_cameras(dataclasses.replace(VIEWS, azimuth_range_deg=180.0), 32) is None


def test_v_all_round_leaves_no_view_outside():
    all_round = dataclasses.replace(VIEWS, azimuth_range_deg=180.0)
    result = preserve_hard(IN_FRONT, PARTIAL, all_round, dataclasses.replace(SMALL, rounds=2))
    assert result.report.met


def test_what_rounds_cannot_mend_is_faded_at_once():
    # Over the whole of P: no small step brings it behind.
    many = wall(0.35, (0.1, 0.8, 0.2))
    tight = dataclasses.replace(SMALL, color_bound=1e-7, depth_bound=1e-7, steps=1)
    report = preserve_hard(many, PARTIAL, VIEWS, tight).report
    assert report.met
    assert report.rounds == 2
    assert report.fadings > 0


@pytest.mark.parametrize(
    ("field", "value"),
    [("color_bound", 0.0), ("depth_bound", float("inf")), ("steps", 0), ("rounds", -1)],
)
def test_settings_out_of_range_are_refused(field, value):
    with pytest.raises(UserError, match=field):
        HardPreservationSettings(**{field: value})


def test_pixels_where_p_is_faint_can_be_left_out():
    faint = dataclasses.replace(PARTIAL, opacities=torch.full((len(PARTIAL),), 0.1))
    held = preserve_hard(IN_FRONT, faint, VIEWS, SMALL)
    assert held.report.before.color > held.report.after.color
    free = preserve_hard(IN_FRONT, faint, VIEWS, dataclasses.replace(SMALL, mask_from=0.9))
    assert free.report.before.color == 0.0
    assert free.report.untouched == len(IN_FRONT)


def test_no_more_is_taken_than_has_to_be(monkeypatch):
    """A part of what the last round or fading did is taken back while the bounds still hold."""
    new = concatenate([IN_FRONT, BEHIND])
    results = {}
    for tries in (0, 4):
        monkeypatch.setattr(hard_preservation, "_GOING_BACK", tries)
        settings = dataclasses.replace(SMALL, rounds=0)
        results[tries] = preserve_hard(new, PARTIAL, VIEWS, settings)
    for result in results.values():
        assert result.report.met
    assert results[4].report.fadings == results[0].report.fadings > 0
    left = [float(result.splats.opacities.sum()) for result in results.values()]
    assert left[1] > left[0]
    shares = [
        max(
            result.report.after.color / (MARGIN * SMALL.color_bound),
            result.report.after.depth / (MARGIN * SMALL.depth_bound),
        )
        for result in results.values()
    ]
    assert shares[0] < shares[1] <= 1
