import pytest
import torch

from splatcomplete_data.cuts import random_cuts
from splatcomplete_data.cuts.random_cuts import random_partial, slight_partial
from tests.builders.objects import BALL


def test_random_partials_are_repeatable_and_within_their_bounds():
    kinds = set()
    for index in range(60):
        cut = random_partial(BALL, 3, index)
        again = random_partial(BALL, 3, index)
        assert torch.equal(cut.mask, again.mask)
        kept = cut.mask.float().mean().item()
        assert random_cuts._FEWEST_SHARE - 1e-3 <= kept <= random_cuts._MOST_SHARE + 1e-3
        kinds.add(cut.kind)
    assert {"plane", "box", "visibility"} <= kinds
    assert not torch.equal(random_partial(BALL, 3, 0).mask, random_partial(BALL, 4, 0).mask)


def test_random_partials_of_degenerate_objects():
    one = BALL.select(torch.tensor([0]))
    for index in range(20):
        assert random_partial(one, 0, index).mask.shape == (1,)
    with pytest.raises(ValueError, match="no splats"):
        random_partial(one.select(torch.zeros(1, dtype=torch.bool)), 0, 0)


def test_slight_cuts_are_repeatable_and_take_little():
    kinds = set()
    for index in range(60):
        cut = slight_partial(BALL, 3, index)
        assert torch.equal(cut.mask, slight_partial(BALL, 3, index).mask)
        assert cut.kept >= random_cuts._SLIGHT_FEWEST_SHARE * len(BALL)
        assert (cut.kind == "nothing") == bool(cut.mask.all())
        kinds.add(cut.kind)
    assert kinds == {"nothing", "visibility", "plane", "box"}
    assert not torch.equal(slight_partial(BALL, 3, 1).mask, slight_partial(BALL, 4, 1).mask)


def test_of_a_slight_cut_that_takes_too_much_nothing_is_taken(monkeypatch):
    with monkeypatch.context() as greedy:
        greedy.setattr(random_cuts, "_SLIGHT_KIND_SHARES", (0.0, 0.0, 1.0, 0.0))
        greedy.setattr(random_cuts, "_SLIGHT_PLANE_SHARE", (0.1, 0.3))
        assert slight_partial(BALL, 0, 0).kind == "nothing"
    one = BALL.select(torch.tensor([0]))
    assert all(bool(slight_partial(one, 0, index).mask.all()) for index in range(20))
    with pytest.raises(ValueError, match="no splats"):
        slight_partial(one.select(torch.zeros(1, dtype=torch.bool)), 0, 0)


@pytest.mark.parametrize(
    ("keep_share", "fewest", "most"), [((0.4, 0.5), 0.12, 0.6), ((0.7, 0.8), 0.6, 0.92)]
)
def test_cuts_that_keep_too_much_or_too_little_become_planes(monkeypatch, keep_share, fewest, most):
    monkeypatch.setattr(random_cuts, "_KIND_SHARES", (0.0, 1.0, 0.0, 0.0, 0.0))
    monkeypatch.setattr(random_cuts, "_KEEP_SHARE", keep_share)
    monkeypatch.setattr(random_cuts, "_FEWEST_SHARE", fewest)
    monkeypatch.setattr(random_cuts, "_MOST_SHARE", most)
    cuts = [random_partial(BALL, 0, index) for index in range(30)]
    kept = [cut.mask.float().mean().item() for cut in cuts]
    assert {cut.kind for cut in cuts} == {"plane", "box"}
    assert fewest - 1e-3 <= min(kept)
    assert max(kept) <= most + 1e-3
