"""The input view settles by what a guess of the complete object hides of P."""

import dataclasses

import pytest
import torch

from gscomplete.framing import input_view
from gscomplete.framing.guess import guess_framing
from gscomplete.framing.input_view import (
    DEPTH_TOLERANCE,
    SettledView,
    given_view,
    hidden_share,
    refine_input_view,
)
from gscomplete.splats import concatenate, transform_splats
from gscomplete.splats.transform import Similarity
from gscomplete.views import ViewDistribution
from tests.builders.objects import angle_between, cylinder, half_cylinder, round_splats

PART, REST = half_cylinder(75.0), half_cylinder(255.0)
WHOLE = concatenate([PART, REST])
WRONG = ViewDistribution(255.0, 15.0)
"""From here P shows its inside, and the rest of the cylinder hides that."""


def test_the_wrong_side_gives_way_to_the_right_one() -> None:
    settled = refine_input_view(PART, REST, WRONG)
    assert angle_between(settled.views.azimuth_deg, 75.0) <= 45
    assert "from 255,15 (--view" in settled.note
    # All that has nothing to do with c stays as it was.
    c = {"azimuth_deg": WRONG.azimuth_deg, "elevation_deg": WRONG.elevation_deg}
    assert dataclasses.replace(settled.views, **c) == WRONG


def test_what_the_note_says_of_hidden_shares_is_so() -> None:
    settled = refine_input_view(PART, REST, WRONG)
    shares = [hidden_share(PART, WHOLE, v) for v in (WRONG, settled.views)]
    assert shares[0] > 0.5 > 0.05 > shares[1]
    told = f"hides {100 * shares[1]:.0f} % of P from there, and {100 * shares[0]:.0f} % from"
    assert told in settled.note
    assert settled.hidden_share == shares[1]


def test_the_right_side_stays() -> None:
    guess = guess_framing(PART)
    right = ViewDistribution(guess.view_azimuth_deg, guess.view_elevation_deg)
    settled = refine_input_view(PART, REST, right)
    assert settled == given_view(PART, REST, right)
    assert (settled.views, settled.note) == (right, "")
    assert settled.hidden_share < 0.05


def test_a_guess_that_hides_p_from_everywhere_moves_no_view() -> None:
    wrapping = transform_splats(cylinder(), Similarity(1.3, torch.eye(3), torch.zeros(3)))
    settled = refine_input_view(PART, wrapping, WRONG)
    assert settled == given_view(PART, wrapping, WRONG)
    assert (settled.views, settled.note) == (WRONG, "")
    assert settled.hidden_share > 0.5


def test_nothing_new_changes_nothing() -> None:
    nothing = PART.select(torch.arange(0))
    assert refine_input_view(PART, nothing, WRONG) == SettledView(WRONG, 0.0)


def test_a_choice_of_p_s_splats_is_enough(monkeypatch) -> None:
    all_of_them = refine_input_view(PART, REST, WRONG)
    monkeypatch.setattr(input_view, "_MAX_SPLATS", len(PART) // 3)
    assert refine_input_view(PART, REST, WRONG).views == all_of_them.views


def test_views_that_show_p_badly_are_not_asked(monkeypatch) -> None:
    monkeypatch.setattr(input_view, "_LEAST_SCORE", 1.0)
    best = guess_framing(PART)
    settled = refine_input_view(PART, REST, WRONG)
    assert settled.views.azimuth_deg == best.view_azimuth_deg


@pytest.mark.parametrize("far", [0.02, 0.05])
def test_a_layer_within_the_tolerance_hides_nothing(far: float) -> None:
    line = torch.linspace(-0.4, 0.4, 40)
    board = round_splats(
        torch.cartesian_prod(torch.zeros(1), line, line), scale=0.015, opacity=0.99
    )
    before = dataclasses.replace(board, means=board.means + torch.tensor([far, 0.0, 0.0]))
    share = hidden_share(board, concatenate([board, before]), ViewDistribution(0.0, 0.0, 0.0))
    assert share < 0.01 if far < DEPTH_TOLERANCE else share > 0.95
