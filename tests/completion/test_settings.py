"""What makes no sense is refused before a run begins, by name."""

import math

import pytest

from gscomplete.completion.settings import CompletionSettings, TimestepStage
from gscomplete.errors import UserError
from gscomplete.fitting.settings import DensifySettings

NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("name", "value"),
    [("until", 1.5), ("every", 0), ("growth", 5.0),
     ("growth", -0.1), ("max_new", -1), ("split_scale", NAN), ("split_scale", INF),
     ("final_from", -1.0)],
)  # fmt: skip
def test_densify_settings_out_of_range_are_named(name, value):
    with pytest.raises(UserError, match=rf"densify\.{name}: expected .*, found {value}"):
        DensifySettings(**{name: value})


@pytest.mark.parametrize(
    ("until", "low", "high"),
    [(NAN, 20.0, 500.0), (0.0, 20.0, 500.0), (1.5, 20.0, 500.0), (1.0, NAN, 5.0),
     (1.0, 20.0, NAN), (1.0, 20.0, 5000.0), (1.0, -1.0, 5.0), (1.0, 500.0, 20.0)],
)  # fmt: skip
def test_timesteps_out_of_range_are_refused(until, low, high):
    with pytest.raises(UserError, match="timesteps: expected"):
        TimestepStage(until, low, high)


@pytest.mark.parametrize("ends", [(), (0.5,), (0.5, 0.5, 1.0), (0.75, 0.5, 1.0)])
def test_stages_follow_each_other_to_the_end(ends):
    with pytest.raises(UserError, match="timesteps: expected stages that end later and later"):
        CompletionSettings(timesteps=tuple(TimestepStage(end, 20.0, 500.0) for end in ends))


@pytest.mark.parametrize(
    ("name", "value"),
    [("max_scale", 0.0), ("max_scale", -1.0), ("max_scale", NAN), ("min_scale_px", INF),
     ("preservation_weight", INF), ("preservation_weight", NAN)],
)  # fmt: skip
def test_settings_out_of_range_are_named(name, value):
    with pytest.raises(UserError, match=f"{name}: expected .*, found {value}"):
        CompletionSettings(**{name: value})


def test_the_edges_of_the_ranges_are_allowed():
    densify = DensifySettings(0.0, 1, 1.0, 0, 0.0, 0.0)
    stages = (TimestepStage(0.5, 0.0, 0.0), TimestepStage(1.0, 999.0, 999.0))
    assert CompletionSettings(timesteps=stages, densify=densify).timesteps == stages
