import dataclasses

import pytest
import torch

from gscomplete.completion.alternatives import alternatives_sheet, guess_alternatives
from gscomplete.completion.presets import UNBOUNDED_GUESS
from gscomplete.priors import load_prior
from gscomplete.shape.mirror_plane import MirrorPlane
from gscomplete.util.randomness import generator_for
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half

PARTIAL = half(ball(2000))
VIEWS = ViewDistribution(0.0, 10.0)
SETTINGS = dataclasses.replace(UNBOUNDED_GUESS, new_splats=600)


@pytest.fixture(scope="module")
def prior():
    return load_prior("embedded", "cpu")


@pytest.fixture(scope="module")
def found(prior):
    conditioning = prior.condition("a ball")
    return guess_alternatives(prior, PARTIAL, VIEWS, conditioning, SETTINGS, 2)


def test_planes_come_first_and_none_last(found):
    assert len(found) == 4
    assert all(isinstance(alternative.mirror, MirrorPlane) for alternative in found[:2])
    assert found[2].option == "--mirror=cut"
    assert found[3].option == "--mirror=none"
    assert all(0 < len(alternative.splats) <= len(PARTIAL) + 600 for alternative in found)
    assert len(found[3].splats) <= 600  # P is not mirrored


def test_an_option_names_the_plane_that_was_drawn(prior, found):
    """To the digits printed: a run with the option starts from the very guess that was drawn."""
    first = found[0]
    azimuth_deg, offset = map(float, first.option.removeprefix("--mirror=").split(","))
    assert first.mirror == MirrorPlane(azimuth_deg, offset)
    again = prior.first_guess(
        PARTIAL,
        VIEWS,
        prior.condition("a ball"),
        generator_for(SETTINGS.seed, 0, "first guess"),
        600,
        first.mirror,
    )
    assert torch.equal(again.splats.means, first.splats.means)


def test_planes_differ(found):
    first, second = (alternative.splats.means for alternative in found[:2])
    assert first.shape != second.shape or not torch.allclose(first, second, atol=1e-3)


def test_priors_without_guesses_have_no_alternatives(prior):
    scattered = dataclasses.replace(SETTINGS, start="sphere")
    assert guess_alternatives(prior, PARTIAL, VIEWS, prior.condition("x"), scattered, 2) == []
    blind = type("Blind", (), {"name": "blind"})()
    assert guess_alternatives(blind, PARTIAL, VIEWS, prior.condition("x"), SETTINGS, 2) == []


def test_the_sheet_has_a_row_each(found):
    one = alternatives_sheet(found[:1], PARTIAL, PARTIAL, VIEWS, "a ball")
    four = alternatives_sheet(found, PARTIAL, PARTIAL, VIEWS, "a ball")
    assert four.height - one.height == 3 * (192 + 4)
