import pytest
import torch

from gscomplete.shape.ask import ask, mean_answer
from gscomplete.shape.mirror_plane import MirrorPlane
from gscomplete.shape.one_view import beside_scan
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.predict import (
    differing_share,
    predict,
)
from gscomplete.shape.symmetry_choice import choose_symmetries
from gscomplete.shape.voxels import CELLS, cell_centers
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half
from tests.builders.shape_network import tiny_network


@pytest.fixture(scope="module")
def model():
    return tiny_network()


def test_the_answer_is_to_what_was_chosen(model):
    partial, views = half(ball()), ViewDistribution(0.0, 10.0)
    tokens = torch.tensor([2, 3])
    guess = predict(model, partial, views, tokens, ends_in_plane=True)
    chosen = choose_symmetries(model, voxelize_partial(partial, views), tokens, ends_in_plane=True)
    assert guess.symmetry_score == chosen.symmetry_score
    for found, expected in zip(guess.seen.symmetries, chosen.seen.symmetries, strict=True):
        assert (found.matrix == expected.matrix).all()
        assert (found.shift == expected.shift).all()
    again = mean_answer(model, guess.seen, tokens)
    assert torch.equal(guess.output.occupancy, again.occupancy)


def test_what_the_prompt_changes_is_counted_and_told(model):
    partial, views = half(ball()), ViewDistribution(0.0, 10.0)
    one, other = torch.tensor([2, 3]), torch.tensor([1, 0])
    asked = predict(model, partial, views, one, ends_in_plane=True, no_tokens=other)
    filled = [ask(model, asked.seen, tokens).occupancy > 0 for tokens in (one, other)]
    expected = float((filled[0] ^ filled[1]).sum() / (filled[0] | filled[1]).sum())
    assert asked.prompt_share == pytest.approx(expected)
    same = predict(model, partial, views, other, ends_in_plane=True, no_tokens=other)
    assert same.prompt_share is None


def test_cells_that_differ_are_counted_against_those_that_either_fills():
    one, other = torch.tensor([1.0, 1.0, -1.0, -1.0]), torch.tensor([1.0, -1.0, 1.0, -1.0])
    assert differing_share(one, other) == pytest.approx(2 / 3)
    assert differing_share(-one.abs(), -one.abs()) == 0.0


def test_cells_beside_a_scan_are_doubted_and_no_others(model):
    whole, views, tokens = ball(), ViewDistribution(0.0, 10.0), torch.tensor([2, 3])
    scan = whole.select(whole.means[:, 0] > 0.1)  # all that a view along x shows
    guess = predict(model, scan, views, tokens, ends_in_plane=False)
    plain = mean_answer(model, guess.seen, tokens).occupancy
    places = cell_centers(CELLS).reshape(-1, 3)
    beside = torch.from_numpy(beside_scan(scan.means.numpy(), views, places)).reshape(plain.shape)
    doubted = beside & (plain > -4.0)
    assert doubted.any()
    assert torch.equal(guess.output.occupancy, torch.where(doubted, plain - 6.0, plain))


@pytest.mark.parametrize("plane", [MirrorPlane(0.0, 0.0), "none"])
def test_planes_that_users_give_are_taken_at_their_word(model, plane):
    whole, views, tokens = ball(), ViewDistribution(0.0, 10.0), torch.tensor([2, 3])
    scan = whole.select(whole.means[:, 0] > 0.1)
    given = predict(model, scan, views, tokens, ends_in_plane=False, mirror_plane=plane)
    plain = mean_answer(model, given.seen, tokens).occupancy
    assert torch.equal(given.output.occupancy, plain) == (plane != "none")
