"""The splats of the first step."""

import dataclasses

import pytest
import torch

from gscomplete.completion.alternatives import guess_alternatives
from gscomplete.completion.presets import GUESS, RECONSTRUCT
from gscomplete.completion.settings import CompletionSettings
from gscomplete.completion.start import INITIAL_OPACITY, initial_splats, start_splats
from gscomplete.errors import UserError
from gscomplete.fitting.finite import NonFiniteError
from gscomplete.priors.base import FirstGuess
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball
from tests.builders.priors import GuessingPrior

PARTIAL = ball(1500)


def start(seed: int = 0, diameter: float = 0.8, **bounds: float):
    limits = {"min_scale": 1e-6, "max_scale": 1.0, **bounds}
    return initial_splats(PARTIAL, 4000, diameter, seed, **limits)


def test_they_fill_the_sphere_evenly():
    radius = start().means.norm(dim=1)
    assert float(radius.max()) <= 0.4 + 1e-6
    # Of a uniform ball an eighth lies within half the radius: 500 of 4000, +- 21.
    assert int((radius < 0.2).sum()) == pytest.approx(500, abs=100)
    assert float(start().means.mean(dim=0).abs().max()) < 0.02


def test_they_are_faint_and_in_the_colours_of_the_input():
    splats = start()
    assert torch.equal(splats.opacities, torch.full((4000,), INITIAL_OPACITY))
    assert torch.allclose(splats.quaternions.norm(dim=1), torch.ones(4000))
    colors = splats.base_colors
    assert 0.02 - 1e-6 <= float(colors.min()) <= float(colors.max()) <= 0.98 + 1e-6
    # Values in [0, 1] deviate by 0.5 at most, so the mean of 4000 draws by 0.008: four times that.
    assert torch.allclose(colors.mean(dim=0), PARTIAL.base_colors.mean(dim=0), atol=0.03)


def test_their_size_is_half_their_spacing_within_bounds():
    spacing = (torch.pi / 6 * 0.8**3 / 4000) ** (1 / 3)
    assert start().scales.unique().tolist() == pytest.approx([0.5 * spacing])
    assert start(min_scale=0.1).scales.unique().tolist() == pytest.approx([0.1])
    assert start(max_scale=0.01).scales.unique().tolist() == pytest.approx([0.01])


def test_the_seed_decides():
    assert torch.equal(start(3).means, start(3).means)
    assert not torch.equal(start(3).means, start(4).means)


def started(settings, guess=None):
    views = ViewDistribution(0.0, 10.0)
    return start_splats(PARTIAL, GuessingPrior(PARTIAL, guess), None, views, settings)


def test_a_guess_with_nan_is_refused():
    broken = dataclasses.replace(PARTIAL, means=PARTIAL.means * torch.nan)
    with pytest.raises(NonFiniteError, match="step 0: means at the start"):
        started(RECONSTRUCT, FirstGuess(broken, ()))


@pytest.mark.parametrize("settings", [GUESS, RECONSTRUCT])
def test_an_empty_guess_is_followed(settings):
    """It says that nothing is missing: steps from a sphere would add fog to a complete object."""
    empty = FirstGuess(PARTIAL.select(torch.arange(0)), ("not mirrored",))
    guessed = started(settings, empty)
    assert guessed.is_guess
    assert len(guessed.splats) == 0
    assert guessed.note == "start: 0 splats that the prior guesses; not mirrored"


def test_no_steps_and_no_guess_are_refused():
    with pytest.raises(UserError, match="0 steps: expected a prior that guesses"):
        started(GUESS)


@pytest.mark.parametrize("captured", [False, True])
def test_the_prior_and_the_user_are_told_that_p_is_a_capture(captured):
    whole, told = ball(50), []

    class Watching(GuessingPrior):
        def first_guess(self, partial, *more, **options):
            told.append(options["captured"])
            return super().first_guess(partial, *more, **options)

    prior = Watching(whole, FirstGuess(whole.select(torch.arange(5)), ()))
    settings = CompletionSettings(start="guess", captured=captured)
    views, conditioning = ViewDistribution(0.0, 10.0), prior.condition("a ball")
    start = start_splats(whole, prior, conditioning, views, settings)
    assert ("P is a capture that was not cut" in start.note) == captured
    prior.likely_mirrors = lambda *_: ("none",)
    guess_alternatives(prior, whole, views, conditioning, settings, 1)
    assert told == [captured, captured]
