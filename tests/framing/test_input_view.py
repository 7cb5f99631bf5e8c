"""The input view settles by what a guess of the complete object hides of P."""

import dataclasses

import pytest
import torch

from gscomplete.framing import input_view
from gscomplete.framing.guess import guess_framing
from gscomplete.framing.input_view import (
    DEPTH_TOLERANCE,
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
    settled, note = refine_input_view(PART, REST, WRONG)
    assert angle_between(settled.azimuth_deg, 75.0) <= 45
    assert "from 255,15 (--view" in note
    # All that has nothing to do with c stays as it was.
    c = {"azimuth_deg": WRONG.azimuth_deg, "elevation_deg": WRONG.elevation_deg}
    assert dataclasses.replace(settled, **c) == WRONG


def test_what_the_note_says_of_hidden_shares_is_so() -> None:
    settled, note = refine_input_view(PART, REST, WRONG)
    shares = [hidden_share(PART, WHOLE, v) for v in (WRONG, settled)]
    assert shares[0] > 0.5 > 0.05 > shares[1]
    assert (
        f"hides {100 * shares[1]:.0f} % of P from there, and {100 * shares[0]:.0f} % from" in note
    )


def test_the_right_side_stays() -> None:
    guess = guess_framing(PART)
    right = ViewDistribution(guess.view_azimuth_deg, guess.view_elevation_deg)
    assert refine_input_view(PART, REST, right) == (right, "")


def test_a_guess_that_hides_p_from_everywhere_moves_no_view() -> None:
    wrapping = transform_splats(cylinder(), Similarity(1.3, torch.eye(3), torch.zeros(3)))
    settled, note = refine_input_view(PART, wrapping, WRONG)
    assert (settled, note) == (WRONG, "")


def test_nothing_new_changes_nothing() -> None:
    assert refine_input_view(PART, PART.select(torch.arange(0)), WRONG) == (WRONG, "")


def test_a_choice_of_p_s_splats_is_enough(monkeypatch) -> None:
    all_of_them, _ = refine_input_view(PART, REST, WRONG)
    monkeypatch.setattr(input_view, "_MAX_SPLATS", len(PART) // 3)
    assert refine_input_view(PART, REST, WRONG)[0] == all_of_them


def test_views_that_show_p_badly_are_not_asked(monkeypatch) -> None:
    monkeypatch.setattr(input_view, "_LEAST_SCORE", 1.0)
    best = guess_framing(PART)
    settled, _ = refine_input_view(PART, REST, WRONG)
    assert settled.azimuth_deg == best.view_azimuth_deg


@pytest.mark.parametrize("far", [0.02, 0.05])
def test_a_layer_within_the_tolerance_hides_nothing(far: float) -> None:
    line = torch.linspace(-0.4, 0.4, 40)
    board = round_splats(
        torch.cartesian_prod(torch.zeros(1), line, line), scale=0.015, opacity=0.99
    )
    before = dataclasses.replace(board, means=board.means + torch.tensor([far, 0.0, 0.0]))
    share = hidden_share(board, concatenate([board, before]), ViewDistribution(0.0, 0.0, 0.0))
    assert share < 0.01 if far < DEPTH_TOLERANCE else share > 0.95
