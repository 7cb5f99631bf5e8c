"""Doubts name what is wrong, and are absent where nothing is."""

import dataclasses

import pytest
import torch

from gscomplete.api import complete
from gscomplete.completion.preserve.outcome import CheckedErrors, HardPreservationReport
from gscomplete.completion.presets import GUESS
from gscomplete.evaluate.doubts import (
    MARK,
    doubts_of_change,
    doubts_of_guess,
    doubts_of_partial,
    doubts_of_result,
    doubts_of_values,
)
from gscomplete.framing.input_view import given_view
from gscomplete.priors.base import FirstGuess
from gscomplete.splats import concatenate, transform_splats
from gscomplete.splats.transform import Similarity
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, cylinder, half_cylinder
from tests.builders.priors import GuessingPrior

PART, REST = half_cylinder(75.0), half_cylinder(255.0)
RIGHT, WRONG = ViewDistribution(75.0, 15.0), ViewDistribution(255.0, 15.0)
CLEAN = CheckedErrors(0.0, 0.0, 8)
REPORT = HardPreservationReport(CLEAN, CLEAN, True, 100, 100, 0, 0, 0, {}, 0, 0, 0, 0.0)


def test_a_guess_behind_p_is_not_doubted_one_before_p_is():
    assert doubts_of_guess(given_view(PART, REST, RIGHT).hidden_share) == ()
    (found,) = doubts_of_guess(given_view(PART, REST, WRONG).hidden_share)
    assert found.startswith(MARK)
    assert "hides" in found
    assert "--view" in found


def test_a_few_splats_and_pieces_far_apart_are_told():
    part = half_cylinder(75.0)
    assert doubts_of_partial(part) == ()
    (few,) = doubts_of_partial(part.select(torch.arange(5)))
    assert "P has 5 splats" in few
    away = dataclasses.replace(part, means=part.means + torch.tensor([3.0, 0.0, 0.0]))
    (apart,) = doubts_of_partial(concatenate([part, away]))
    assert "50% and 50%" in apart
    one_place = dataclasses.replace(part, means=torch.zeros_like(part.means))
    assert doubts_of_partial(one_place) == ()


def test_a_line_of_splats_is_told_and_a_narrow_strip_is_not():
    along = torch.linspace(-1, 1, 500)
    for breadth, count in ((0.0, 1), (0.02, 0)):
        across = breadth * torch.linspace(-1, 1, 500)[torch.randperm(500)]
        means = torch.stack([along, across, torch.zeros(500)], dim=1)
        part = dataclasses.replace(ball(500, 1.0), means=means)
        assert len(doubts_of_partial(part)) == count


def test_a_part_larger_than_its_object_and_splats_larger_than_the_part_are_told():
    large = dataclasses.replace(ball(500, 1.0), means=1.5 * ball(500, 1.0).means)
    assert doubts_of_partial(large) == ()
    assert "--object-size" in doubts_of_partial(large, is_size_given=True)[0]
    wide = dataclasses.replace(large, scales=1e5 * large.scales)
    assert "they form no surface" in doubts_of_partial(wide)[0]


def test_values_without_their_conversions_are_told():
    part = ball(500, 1.0)
    assert doubts_of_values(part) == ()
    raw = torch.rand(500, generator=torch.Generator().manual_seed(1))
    opacities = dataclasses.replace(part, opacities=torch.sigmoid(raw))
    assert ["opacities look linear" in doubt for doubt in doubts_of_values(opacities)] == [True]
    scales = dataclasses.replace(part, scales=torch.exp(raw[:, None].expand(500, 3) * 0.02))
    assert ["scales look linear" in doubt for doubt in doubts_of_values(scales)] == [True]
    empty = part.select(torch.arange(0))
    assert doubts_of_values(empty) == ()


def test_a_result_that_covers_p_is_told():
    assert doubts_of_change(0.008, 0.02) == ()
    assert "E_color 0.02" in doubts_of_change(0.02, 0.0)[0]
    assert "E_depth 0.5" in doubts_of_change(0.0, 0.5)[0]


@pytest.mark.parametrize(("faded", "dropped", "count"), [(20, 10, 0), (20, 60, 1), (80, 0, 1)])
def test_most_new_splats_lost_is_told(faded, dropped, count):
    report = dataclasses.replace(REPORT, faded=faded, dropped={"in_the_way": dropped})
    found = doubts_of_result(cylinder(), REST, report.lost)
    assert len(found) == count
    assert all(f"{faded + dropped}%" in doubt for doubt in found)


def test_a_result_no_larger_than_an_open_part_is_told():
    half_size = Similarity(0.5, torch.eye(3).double(), torch.zeros(3).double())
    small = transform_splats(cylinder(), half_size)
    (found,) = doubts_of_result(small, small.select(torch.arange(5)), REPORT.lost)
    assert "hardly larger" in found
    beside = dataclasses.replace(small, means=small.means + torch.tensor([0.4, 0.0, 0.0]))
    assert doubts_of_result(small, beside, REPORT.lost) == ()
    assert doubts_of_result(cylinder(), small, REPORT.lost) == ()  # P fills the frame


def test_doubts_stand_among_the_notes_of_a_completion():
    truth = ball(1500)
    part = truth.select(truth.means[:, 0] > 0)
    known = {"view_deg": (180.0, 0.0), "center_file": (0.0, 0.0, 0.0), "size_file": 0.8}
    rest = truth.select(truth.means[:, 0] <= 0)
    prior = GuessingPrior(truth, FirstGuess(rest, ()))
    found = complete(part, "a ball", prior=prior, settings=GUESS, **known)
    assert any("hides" in doubt for doubt in found.doubts)
    assert set(found.doubts) <= set(found.notes)
