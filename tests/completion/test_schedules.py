"""The paper's schedule, to the letter."""

import dataclasses

import pytest

from gscomplete.completion import schedules
from gscomplete.completion.presets import PAPER, RECONSTRUCT
from gscomplete.completion.settings import CompletionSettings, TimestepStage
from gscomplete.errors import UserError


def test_paper_preset_is_the_paper():
    settings = PAPER
    assert settings.steps == 6000
    assert settings.new_splats == 5000
    assert settings.warmup_steps == 50
    assert settings.preservation_weight == 2.0
    assert settings.preservation_every == 2
    assert settings.densify.until * settings.steps == 1500
    assert settings.mode == "distill"


@pytest.mark.parametrize(
    ("first", "last", "low", "high"),
    [(0, 2999, 0.4 * 980, 0.6 * 980), (3000, 4499, 20, 0.35 * 980), (4500, 5999, 20, 0.25 * 980)],
)
def test_timesteps_follow_the_paper(first, last, low, high):
    drawn = [schedules.timestep_at(PAPER, step) for step in (first, *range(first, last, 7), last)]
    assert low <= min(drawn)
    assert max(drawn) <= high
    # Uniform: the extremes of some 200 draws lie close to the ends of the range.
    assert min(drawn) < low + 0.06 * (high - low)
    assert max(drawn) > high - 0.06 * (high - low)


def test_preservation_joins_every_other_step_after_the_warm_up():
    flags = [schedules.has_preservation(PAPER, step) for step in range(60)]
    assert all(flags[:50])
    assert flags[50:54] == [False, True, False, True]
    off = dataclasses.replace(PAPER, preservation_weight=0.0)
    assert not any(schedules.has_preservation(off, step) for step in range(60))


def test_rounds_cover_the_run():
    settings = RECONSTRUCT
    starts = [s for s in range(settings.steps) if schedules.is_round_start(settings, s)]
    assert starts[0] == 0
    assert len(starts) == settings.rounds


def test_stages_end_with_the_step_that_the_paper_names():
    coarse = dataclasses.replace(PAPER, coarse_until=0.5)
    assert schedules.resolution_at(coarse, 2999, 256) == 128
    assert schedules.resolution_at(coarse, 3000, 256) == 256
    assert schedules.is_densify_step(PAPER, 1450)
    assert not schedules.is_densify_step(PAPER, 1500)
    assert schedules.is_prune_step(PAPER, 1500)
    assert not schedules.is_prune_step(PAPER, 0)


def test_the_ablation_has_one_stage_and_nothing_that_preserves():
    ablated = PAPER.ablated()
    assert ablated.timesteps == (TimestepStage(1.0, 20.0, 980.0),)
    assert (ablated.warmup_steps, ablated.preservation_weight) == (0, 0.0)


@pytest.mark.parametrize(
    ("name", "value"), [("steps", -1), ("new_splats", 0), ("resolution_px", 4), ("rounds", 0)]
)
def test_settings_out_of_range_are_named(name, value):
    with pytest.raises(UserError, match=name):
        CompletionSettings(**{name: value})


@pytest.mark.parametrize(("steps", "rounds"), [(15, 8), (100, 8), (31, 16), (7, 16), (240, 8)])
def test_there_are_as_many_rounds_as_asked_for(steps, rounds):
    settings = dataclasses.replace(RECONSTRUCT, steps=steps, rounds=rounds)
    starts = [s for s in range(steps) if schedules.is_round_start(settings, s)]
    assert starts[0] == 0
    assert len(starts) == min(steps, rounds)
    lengths = [b - a for a, b in zip(starts, [*starts[1:], steps], strict=True)]
    assert max(lengths) - min(lengths) <= 1
