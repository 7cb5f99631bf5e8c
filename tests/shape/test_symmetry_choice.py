import dataclasses
import math

import pytest
import torch

from gscomplete.shape import symmetry_choice
from gscomplete.shape.ask import ask
from gscomplete.shape.mirror_plane import MirrorPlane
from gscomplete.shape.network import ShapeOutput
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.planes.answer_scorer import FEATURES
from gscomplete.shape.planes.proposals import candidate_planes
from gscomplete.shape.symmetry import SOURCES, plane_of
from gscomplete.shape.symmetry_choice import (
    CANDIDATES,
    choose_symmetries,
    score_planes,
)
from gscomplete.shape.voxels import CELLS, COARSE_CELLS
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half

LOOK = voxelize_partial(half(ball()), ViewDistribution(0.0, 10.0))


class Believer(torch.nn.Module):
    """Fills P and, of the copies shown first, those that reach far behind P."""

    def forward(self, volumes, evidence, scores, tokens):
        assert volumes.shape[0] == evidence.shape[0] == scores.shape[0] == tokens.shape[0]
        partial = volumes[:, 0, 0] > 0
        copy = volumes[:, 1, 0] > 0
        trusted = copy[:, : CELLS // 4].any(dim=(1, 2, 3))[:, None, None, None]
        filled = partial | (copy & trusted)
        n = COARSE_CELLS
        nothing = torch.zeros(len(volumes), SOURCES + 1, n, n, n)
        return ShapeOutput(16.0 * filled.float() - 8.0, nothing[:, :3], nothing)


def test_the_copies_that_answers_are_consistent_with_are_given():
    tokens = torch.zeros(4, dtype=torch.long)
    planes = candidate_planes(LOOK, CANDIDATES)
    choice = choose_symmetries(Believer(), LOOK, tokens, ends_in_plane=True)
    chosen = choice.inputs.symmetries
    assert 0.9 < choice.symmetry_score <= 1
    assert len(chosen) == SOURCES - 1
    places = {plane.shift.tobytes() + plane.matrix.tobytes() for plane in planes}
    among = [plane.shift.tobytes() + plane.matrix.tobytes() in places for plane in chosen]
    assert among == [True, True, False]
    farthest = chosen[0].apply(LOOK.positions)[:, 0].min()
    assert farthest < -0.36
    again = choose_symmetries(Believer(), LOOK, tokens, ends_in_plane=True).inputs.symmetries
    assert [c.score for c in chosen] == [c.score for c in again]


def test_the_answer_that_decided_is_handed_on():
    tokens = torch.zeros(4, dtype=torch.long)
    for model, ends_in_plane in ((Believer(), True), (Doubter(), False)):
        choice = choose_symmetries(model, LOOK, tokens, ends_in_plane=ends_in_plane)
        again = ask(model, choice.inputs, tokens)
        assert choice.answer is not None
        assert torch.equal(choice.answer.occupancy, again.occupancy)


def test_all_likely_planes_are_asked_about_and_the_best_is_the_one_shown():
    tokens = torch.zeros(4, dtype=torch.long)
    asked = score_planes(Believer(), LOOK, tokens, ends_in_plane=True)
    shown = choose_symmetries(Believer(), LOOK, tokens, ends_in_plane=True)
    planes = candidate_planes(LOOK, CANDIDATES)
    assert {p.shift.tobytes() for p in asked.planes} == {p.shift.tobytes() for p in planes}
    assert asked.planes[0] is not asked.planes[1]
    assert (asked.planes[0].shift == shown.inputs.symmetries[0].shift).all()
    assert asked.symmetry_scores[0] == shown.symmetry_score
    unlike = asked.distinct(LOOK.positions)
    assert unlike[0] is asked.planes[0]
    planes_twice = asked.planes[:1] * 2 + asked.planes
    twice = dataclasses.replace(asked, planes=planes_twice, symmetry_scores=(0.0,) * 11)
    assert twice.distinct(LOOK.positions) == unlike
    assert not any(a.is_like(b, LOOK.positions) for k, a in enumerate(unlike) for b in unlike[:k])


def test_users_may_choose_the_plane_or_none():
    tokens = torch.zeros(4, dtype=torch.long)
    none = choose_symmetries(Believer(), LOOK, tokens, ends_in_plane=True, mirror_plane="none")
    assert none.symmetry_score == 0
    assert all(symmetry.score == 0 for symmetry in none.inputs.symmetries)
    given = choose_symmetries(
        Believer(), LOOK, tokens, ends_in_plane=True, mirror_plane=MirrorPlane(30.0, 0.1)
    )
    angle, offset = plane_of(given.inputs.symmetries[0])
    assert math.degrees(angle) == pytest.approx(30.0, abs=1e-4)
    assert offset == pytest.approx(0.1, abs=1e-6)
    assert given.symmetry_score == 1
    assert given.inputs.symmetries[0].score > 0


class Doubter(torch.nn.Module):
    """Fills P, and all copies it is given with a probability of one half."""

    def forward(self, volumes, evidence, scores, tokens):
        partial = volumes[:, 0, 0] > 0
        copies = (volumes[:, 1:, 0] > 0).any(dim=1) & ~partial
        n = COARSE_CELLS
        nothing = torch.zeros(len(volumes), SOURCES + 1, n, n, n)
        occupancy = torch.where(partial, 8.0, torch.where(copies, 0.0, -8.0))
        return ShapeOutput(occupancy, nothing[:, :3], nothing)


def prefer(monkeypatch, name, sign=1.0):
    """Let answers be ranked by one of the features."""

    def scorer(features):
        return sign * features[:, FEATURES.index(name)]

    monkeypatch.setattr(symmetry_choice, "packaged_answer_scorer", lambda: scorer)


def test_no_copy_is_shown_where_the_answer_to_none_is_put_first(monkeypatch):
    prefer(monkeypatch, "no_copy")
    tokens = torch.zeros(4, dtype=torch.long)
    assert score_planes(Doubter(), LOOK, tokens, ends_in_plane=False).none_is_best
    open_part = choose_symmetries(Doubter(), LOOK, tokens, ends_in_plane=False)
    assert open_part.symmetry_score == 0
    assert all(symmetry.score == 0 for symmetry in open_part.inputs.symmetries)
    # What lies beyond a cut is missing, whatever the answer to P alone would be.
    cut_part = choose_symmetries(Doubter(), LOOK, tokens, ends_in_plane=True)
    assert cut_part.inputs.symmetries[0].score > 0
    assert not score_planes(Doubter(), LOOK, tokens, ends_in_plane=True).none_is_best


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_planes_are_in_the_order_of_their_answers(monkeypatch, sign):
    prefer(monkeypatch, "log_belief", sign)
    tokens = torch.zeros(4, dtype=torch.long)
    asked = score_planes(Doubter(), LOOK, tokens, ends_in_plane=True)
    beliefs = [plane.score for plane in candidate_planes(LOOK, CANDIDATES)]
    assert [p.score for p in asked.planes] == sorted(beliefs, reverse=sign > 0)
