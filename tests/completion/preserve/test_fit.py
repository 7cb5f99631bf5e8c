"""Rounds of refitting: what one weighs, what it may not do, and when no other follows."""

import dataclasses

import pytest
import torch

from gscomplete.completion.preserve.fit import RoundProblem, are_promising, fit_round
from gscomplete.completion.settings import HardPreservationSettings
from gscomplete.evaluate.metrics import MID_GREY
from gscomplete.render import Render, prepare_frozen, render
from gscomplete.splats import Splats
from gscomplete.views import Cameras, ViewDistribution, join_cameras
from tests.builders.objects import round_splats

SIZE_PX = 16
GREY = torch.tensor(MID_GREY)
INSIDE = ViewDistribution(0.0, 10.0, azimuth_range_deg=30.0)
OUTSIDE = ViewDistribution(180.0, 10.0, azimuth_range_deg=30.0)


def balls(x: float, opacity: float, scale: float, count: int = 3) -> Splats:
    """A few round splats side by side across the x axis."""
    y = torch.linspace(-0.2, 0.2, count)
    places = torch.stack([torch.full((count,), x), y, torch.zeros(count)], dim=1)
    return round_splats(places, scale=scale, opacity=opacity, color=(0.9, 0.2, 0.1))


PARTIAL = balls(0.2, 0.9, 0.1)


def cameras() -> Cameras:
    views = [v.cameras(v.low_discrepancy(2), SIZE_PX) for v in (INSIDE, OUTSIDE)]
    return join_cameras(views)


def problem(before: Splats) -> RoundProblem:
    views = cameras()
    frozen = prepare_frozen(PARTIAL, views)
    with torch.no_grad():
        drawn = render(before, views, frozen=frozen)
    return RoundProblem(frozen, drawn, frozen[:2].picture(GREY), GREY, ("color", "depth"))


def test_change_is_weighed_by_how_open_p_leaves_a_pixel():
    g = torch.Generator().manual_seed(0)
    here = problem(balls(-0.2, 0.5, 0.1))
    views = torch.tensor([1, 2, 3])  # one from within V, both from outside
    drawn = Render(
        torch.rand(3, SIZE_PX, SIZE_PX, 3, generator=g),
        torch.rand(3, SIZE_PX, SIZE_PX, generator=g),
        torch.ones(3, SIZE_PX, SIZE_PX),
    )
    change = ((drawn.color - here.before.color[views]) ** 2).mean(dim=-1)
    change = change + (drawn.alpha - here.before.alpha[views]) ** 2
    mask = here.target.alpha[1]
    assert 0.5 < float(mask.max()) <= 1
    expected = torch.cat([(1 - mask)[None] * change[:1], change[1:]]).mean()
    torch.testing.assert_close(here.change(drawn, views), expected)


@pytest.mark.parametrize("wish", [2.0, 0.5])
def test_splats_may_shrink_but_never_grow(wish, monkeypatch):
    """The picture that is to be kept shows them twice as large, or half as large."""
    splats = balls(-0.2, 0.9, 0.1)
    wanted = dataclasses.replace(splats, scales=wish * splats.scales)
    monkeypatch.setattr("gscomplete.completion.preserve.fit._SCALES_RATE", 0.05)
    monkeypatch.setattr("gscomplete.completion.preserve.fit._KEEP_WEIGHT", 100.0)
    settings = HardPreservationSettings(steps=12)
    fitted = fit_round(splats, problem(wanted), settings, 1.0, torch.Generator().manual_seed(0))
    assert float(fitted.scales.max()) <= 0.1 * (1 + 1e-6)
    assert (float(fitted.scales.max()) < 0.09) == (wish < 1)
    assert torch.equal(fitted.sh, splats.sh)
    assert torch.equal(fitted.quaternions, splats.quaternions)


@pytest.mark.parametrize(
    ("largest", "rounds", "expected"),
    [
        ([9.0, 8.5], 10, True),  # one round tells too little
        ([6.0, 5.9, 5.5], 10, False),  # 5.5 x .957^8 = 3.9
        ([12.0, 6.0, 3.0], 10, True),  # halved by every round
        ([6.0, 5.9, 5.5, 2.0], 10, True),  # the last two alone count
        ([1.5, 1.6, 1.7], 4, True),  # 1.7 x 1.065^2 = 1.93
        ([1.5, 1.6, 1.7], 6, False),
    ],
)
def test_rounds_that_get_nowhere_end(largest, rounds, expected):
    assert are_promising(largest, rounds) == expected
