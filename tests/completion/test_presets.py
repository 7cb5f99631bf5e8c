"""Named settings."""

import pytest

from gscomplete.completion.presets import PAPER, TEXT_ONLY, preset
from gscomplete.errors import UserError
from tests.builders.objects import ball
from tests.builders.priors import OraclePrior


def test_a_prior_that_names_none_has_those_of_any() -> None:
    prior = OraclePrior(ball(10))
    assert preset("default", prior) == PAPER
    assert preset("fast", prior) == TEXT_ONLY


def test_the_name_of_a_prior_is_no_prior() -> None:
    """It would get the presets of priors that name none, without a word."""
    with pytest.raises(UserError, match=r"expected a prior .*found the text 'embedded'"):
        preset("default", "embedded")  # type: ignore[arg-type]


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(UserError, match="expected one of default"):
        preset("best", OraclePrior(ball(10)))  # type: ignore[arg-type]


def test_settings_that_a_prior_names_and_nobody_knows_are_refused() -> None:
    prior = OraclePrior(ball(10))
    prior.presets = {"default": "destill"}  # type: ignore[attr-defined]
    with pytest.raises(UserError, match=r"default: expected one of paper, .*found 'destill'"):
        preset("default", prior)
