"""Named settings."""

from pathlib import Path

import pytest

from gscomplete.completion.presets import PAPER, TEXT_ONLY, preset
from gscomplete.completion.schedules import is_densify_step
from gscomplete.completion.start import INITIAL_OPACITY
from gscomplete.errors import UserError
from gscomplete.fitting.densify import PRUNE_OPACITY
from gscomplete.views.distribution import ELEVATION_RANGE_DEG
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


def test_what_the_paper_leaves_open_is_told_as_it_is() -> None:
    """The table of docs/mvdream.md has the numbers of the settings."""
    text = (Path(__file__).parents[2] / "docs/mvdream.md").read_text(encoding="utf-8")
    table = text[text.index("## What the paper leaves open") :]
    rates, densify = PAPER.learning_rates, PAPER.densify
    subdivided = [step + 1 for step in range(PAPER.steps) if is_densify_step(PAPER, step)]
    for told in (
        f"every {densify.every} steps from the {subdivided[0]}st to step {subdivided[-1]:,}",
        f"the {100 * densify.growth:.0f} % of largest",
        f"{densify.max_new:,} splats at most",
        f"opacity below {PRUNE_OPACITY}",
        f"opacity {INITIAL_OPACITY}, round",
        f"scales of at most {PAPER.max_scale} sizes",
        f"in every one of the {PAPER.warmup_steps} steps",
        f"elevations too, {ELEVATION_RANGE_DEG:.0f} degrees",
        f"positions {rates.means:.0e} to {rates.means_final:.0e}".replace("e-0", "e-"),
        f"scales {rates.log_scales:.0e}, opacities {rates.opacity_logits:.0e}".replace("e-0", "e-"),
        f"colours {rates.sh:.0e}".replace("e-0", "e-"),
    ):
        assert told in table, told
