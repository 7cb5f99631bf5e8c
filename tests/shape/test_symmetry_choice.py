import dataclasses
import math

import pytest
import torch

from gscomplete.shape import partial_voxels, symmetry_choice
from gscomplete.shape.ask import ask
from gscomplete.shape.mirror_plane import MirrorPlane
from gscomplete.shape.network import ShapeOutput
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.planes.proposals import candidate_planes
from gscomplete.shape.symmetry import SOURCES, plane_of
from gscomplete.shape.symmetry_choice import (
    CANDIDATES,
    choose_symmetries,
    missing_share,
    score_planes,
    sureness,
    symmetry_scores_of_answers,
)
from gscomplete.shape.voxels import CELLS, COARSE_CELLS
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half
from tests.builders.shape_network import mirrors

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


def test_a_copy_the_answer_fills_scores_above_one_it_leaves_empty():
    seen = LOOK.with_copies(mirrors())
    partial, across, along = (torch.from_numpy(seen.volumes[k, 0]) for k in range(3))
    complete = ((partial > 0) | (across > 0)).float()
    alone = (partial > 0).float()
    answers = torch.stack([complete, complete, alone])
    filled, useless, refused = symmetry_scores_of_answers(
        answers, torch.stack([across, along, across]), partial
    ).tolist()
    assert filled > 0.95
    assert abs(useless) < 0.1  # it shows nothing new
    assert refused < -0.2


def test_an_answer_that_adds_next_to_nothing_does_not_win():
    seen = LOOK.with_copies(mirrors())
    partial, across, along = (torch.from_numpy(seen.volumes[k, 0]) for k in range(3))
    complete = ((partial > 0) | (across > 0)).float()
    little = (partial > 0).float()
    free = (along > 0) & (torch.nn.functional.max_pool3d(partial[None], 3, 1, 1)[0] <= 0)
    little[free] = 1.0  # the few new cells of the copy are all filled
    symmetry_scores = symmetry_scores_of_answers(
        torch.stack([complete, little]), torch.stack([across, along]), partial
    )
    assert float(symmetry_scores[0]) > float(symmetry_scores[1]) + 0.5


def test_the_copies_that_answers_are_consistent_with_are_given():
    tokens = torch.zeros(4, dtype=torch.long)
    planes = candidate_planes(LOOK, CANDIDATES)
    choice = choose_symmetries(Believer(), LOOK, tokens, ends_in_plane=True)
    chosen = choice.seen.symmetries
    assert 0.9 < choice.symmetry_score <= 1
    assert len(chosen) == SOURCES - 1
    places = {plane.shift.tobytes() + plane.matrix.tobytes() for plane in planes}
    among = [plane.shift.tobytes() + plane.matrix.tobytes() in places for plane in chosen]
    assert among == [True, True, False]
    farthest = chosen[0].apply(LOOK.positions)[:, 0].min()
    assert farthest < -0.36
    again = choose_symmetries(Believer(), LOOK, tokens, ends_in_plane=True).seen.symmetries
    assert [c.score for c in chosen] == [c.score for c in again]


def test_the_answer_that_decided_is_handed_on():
    tokens = torch.zeros(4, dtype=torch.long)
    for model, ends_in_plane in ((Believer(), True), (Doubter(), False)):
        choice = choose_symmetries(model, LOOK, tokens, ends_in_plane=ends_in_plane)
        again = ask(model, choice.seen, tokens)
        assert choice.answer is not None
        assert torch.equal(choice.answer.occupancy, again.occupancy)


def test_all_likely_planes_are_asked_about_and_the_best_is_the_one_shown():
    tokens = torch.zeros(4, dtype=torch.long)
    asked = score_planes(Believer(), LOOK, tokens, ends_in_plane=True)
    shown = choose_symmetries(Believer(), LOOK, tokens, ends_in_plane=True)
    planes = candidate_planes(LOOK, CANDIDATES)
    assert {p.shift.tobytes() for p in asked.planes} == {p.shift.tobytes() for p in planes}
    assert asked.planes[0] is not asked.planes[1]
    assert (asked.planes[0].shift == shown.seen.symmetries[0].shift).all()
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
    assert all(symmetry.score == 0 for symmetry in none.seen.symmetries)
    given = choose_symmetries(
        Believer(), LOOK, tokens, ends_in_plane=True, mirror_plane=MirrorPlane(30.0, 0.1)
    )
    angle, offset = plane_of(given.seen.symmetries[0])
    assert math.degrees(angle) == pytest.approx(30.0, abs=1e-4)
    assert offset == pytest.approx(0.1, abs=1e-6)
    assert given.symmetry_score == 1
    assert given.seen.symmetries[0].score > 0


class Doubter(torch.nn.Module):
    """Fills P, and all copies it is given with a probability of one half."""

    def forward(self, volumes, evidence, scores, tokens):
        partial = volumes[:, 0, 0] > 0
        copies = (volumes[:, 1:, 0] > 0).any(dim=1) & ~partial
        n = COARSE_CELLS
        nothing = torch.zeros(len(volumes), SOURCES + 1, n, n, n)
        occupancy = torch.where(partial, 8.0, torch.where(copies, 0.0, -8.0))
        return ShapeOutput(occupancy, nothing[:, :3], nothing)


def test_answers_are_as_sure_as_they_are_far_from_one_half():
    filled = torch.zeros(3, 4, 4, 4)
    filled[0, 0] = 1.0
    filled[1, 0] = 0.75
    sure = sureness(filled).tolist()
    assert sure == [1.0, 0.5, 0.0]
    filled[0, 1] = 0.05  # as good as empty
    assert sureness(filled).tolist() == sure


def test_no_copy_is_shown_where_every_copy_leaves_the_network_in_doubt():
    tokens = torch.zeros(4, dtype=torch.long)
    assert score_planes(Doubter(), LOOK, tokens, ends_in_plane=False).none_is_best
    open_part = choose_symmetries(Doubter(), LOOK, tokens, ends_in_plane=False)
    assert open_part.symmetry_score == 0
    assert all(symmetry.score == 0 for symmetry in open_part.seen.symmetries)
    # What lies beyond a cut is missing, however sure the network is of P.
    cut_part = choose_symmetries(Doubter(), LOOK, tokens, ends_in_plane=True)
    assert cut_part.seen.symmetries[0].score > 0


@pytest.mark.parametrize("share", [1.0, 0.9])
def test_of_parts_that_one_view_shows_the_surest_answer_wins_of_others_a_small_one(
    monkeypatch, share
):
    monkeypatch.setattr(partial_voxels, "best_view_share", lambda points: share)
    look = dataclasses.replace(LOOK)  # nothing is counted yet

    class Surest(Doubter):
        def forward(self, volumes, evidence, scores, tokens):
            out = super().forward(volumes, evidence, scores, tokens)
            far = (volumes[:, 1, 0] > 0)[:, : CELLS // 4].any(dim=(1, 2, 3))
            sure = torch.where(
                far[:, None, None, None], 2 * out.occupancy + 4.0, 0.5 * out.occupancy
            )
            return ShapeOutput(sure, out.colors, out.sources)

    tokens = torch.zeros(4, dtype=torch.long)
    asked = score_planes(Surest(), look, tokens, ends_in_plane=False)
    assert asked.none_is_best == (share < 1.0)
    if share == 1.0:
        assert asked.planes[0].apply(LOOK.positions)[:, 0].min() < -0.36


class Filler(Believer):
    """Fills P and all copies that it is shown first."""

    def forward(self, volumes, evidence, scores, tokens):
        filled = (volumes[:, 0, 0] > 0) | (volumes[:, 1, 0] > 0)
        nothing = torch.zeros(len(volumes), SOURCES + 1, *(COARSE_CELLS,) * 3)
        return ShapeOutput(16.0 * filled.float() - 8.0, nothing[:, :3], nothing)


@pytest.mark.parametrize("share", [0.6, 0.8])
def test_a_part_that_no_view_shows_much_of_counts_as_cut_if_much_is_missing(monkeypatch, share):
    monkeypatch.setattr(partial_voxels, "best_view_share", lambda points: share)
    look = dataclasses.replace(LOOK)  # nothing is counted yet
    tokens = torch.zeros(4, dtype=torch.long)
    found, cut = (
        score_planes(Filler(), look, tokens, ends_in_plane=ends) for ends in (False, True)
    )
    assert (found.symmetry_scores == cut.symmetry_scores) == (share < 0.7)


@pytest.mark.parametrize(("missing", "first_of_all"), [(0.3, 3), (0.6, 5)])
def test_sureness_counts_beside_the_score_where_little_is_missing(
    monkeypatch, missing, first_of_all
):
    favourite = torch.zeros(CANDIDATES)
    favourite[3] = 1.0
    scores = torch.zeros(CANDIDATES)
    scores[5] = 3.0
    monkeypatch.setattr(symmetry_choice, "missing_share", lambda filled, partial: missing)
    monkeypatch.setattr(symmetry_choice, "sureness", lambda filled: favourite)
    monkeypatch.setattr(symmetry_choice, "symmetry_scores_of_answers", lambda *_: scores)
    tokens = torch.zeros(4, dtype=torch.long)
    first = score_planes(Filler(), LOOK, tokens, ends_in_plane=True).planes[0]
    planes = candidate_planes(LOOK, CANDIDATES)
    assert plane_of(first) == pytest.approx(plane_of(planes[first_of_all]))


def test_what_is_missing_is_the_surface_beyond_p():
    seen = LOOK.with_copies(mirrors())
    partial, across = (torch.from_numpy(seen.volumes[k, 0]) for k in (0, 1))
    whole = ((partial > 0) | (across > 0)).float()[None]
    # half of a ball, but for the cells beside the other
    assert 0.3 < missing_share(whole, partial) < 0.5
    assert missing_share((partial > 0).float()[None], partial) == 0
    assert missing_share(torch.zeros_like(whole), partial) == 0
