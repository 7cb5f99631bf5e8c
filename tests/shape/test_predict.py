import numpy as np
import pytest
import torch

from gscomplete.shape.ask import mean_answer
from gscomplete.shape.mirror_plane import MirrorPlane
from gscomplete.shape.outline.one_view import ONE_VIEW_SHARE, beside_scan, best_view_share
from gscomplete.shape.outline.scorer import doubts_beside_outlines
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.placements import mean_over_placements
from gscomplete.shape.predict import differing_share, predict
from gscomplete.shape.symmetry_choice import choose_symmetries
from gscomplete.shape.voxels import CELLS, cell_centers
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half
from tests.builders.shape_network import tiny_network

VIEWS, WORDS, NO_WORDS = ViewDistribution(0.0, 10.0), torch.tensor([2, 3]), torch.tensor([1, 0])


@pytest.fixture(scope="module")
def model():
    return tiny_network()


def asked(model, partial, **options):
    return predict(model, partial, VIEWS, WORDS, no_tokens=NO_WORDS, **options)


def plain_answer(model, partial, inputs):
    """Return the logits that nothing has doubted yet."""
    about = mean_answer(model, inputs, (WORDS, NO_WORDS)), inputs, partial, VIEWS, (WORDS, NO_WORDS)
    return mean_over_placements(model, *about).occupancy


def doubts(partial, shape, *, ends_in_plane):
    """Return what cells lose beside outlines."""
    points, places = partial.means.numpy(), cell_centers(CELLS).reshape(-1, 3)
    found = np.zeros(len(places), np.float32)
    if ends_in_plane or best_view_share(points) < ONE_VIEW_SHARE:
        found = doubts_beside_outlines(points, VIEWS, places, ends_in_plane=ends_in_plane)
    if not ends_in_plane:
        found[beside_scan(points, VIEWS, places)] = 6.0
    return torch.from_numpy(found).reshape(shape)


def test_the_answer_is_to_what_was_chosen_with_the_prompt_and_without(model):
    partial = half(ball())
    guess = asked(model, partial, ends_in_plane=True)
    chosen = choose_symmetries(model, voxelize_partial(partial, VIEWS), WORDS, ends_in_plane=True)
    assert guess.symmetry_score == chosen.symmetry_score
    for found, expected in zip(guess.inputs.symmetries, chosen.inputs.symmetries, strict=True):
        assert (found.matrix == expected.matrix).all()
        assert (found.shift == expected.shift).all()
    again = plain_answer(model, partial, guess.inputs)
    lost = doubts(partial, again.shape, ends_in_plane=True)
    lost = torch.where(again > -4.0, lost, 0.0)
    assert torch.equal(guess.output.occupancy, again - lost)
    alone = mean_answer(model, guess.inputs, (WORDS, NO_WORDS)).occupancy
    # the same doubts, as the difference of float32 logits below 10
    assert torch.allclose(guess.in_frame, alone - lost, atol=1e-5)


def test_what_the_prompt_changes_is_counted_and_told(model):
    partial = half(ball())
    guess = asked(model, partial, ends_in_plane=True)
    answers = [
        mean_answer(model, guess.inputs, (tokens, NO_WORDS)).occupancy > 0
        for tokens in (WORDS, NO_WORDS)
    ]
    expected = float((answers[0] ^ answers[1]).sum() / (answers[0] | answers[1]).sum())
    assert guess.prompt_share == pytest.approx(expected)
    same = predict(model, partial, VIEWS, NO_WORDS, no_tokens=NO_WORDS, ends_in_plane=True)
    assert same.prompt_share is None


def test_cells_that_differ_are_counted_against_those_that_either_fills():
    one, other = torch.tensor([1.0, 1.0, -1.0, -1.0]), torch.tensor([1.0, -1.0, 1.0, -1.0])
    assert differing_share(one, other) == pytest.approx(2 / 3)
    assert differing_share(-one.abs(), -one.abs()) == 0.0


def test_cells_beside_outlines_are_doubted_and_no_others(model):
    whole = ball()
    scan = whole.select(whole.means[:, 0] > 0.1)  # all that a view along x shows
    guess = asked(model, scan, ends_in_plane=False)
    plain = plain_answer(model, scan, guess.inputs)
    lost = torch.where(plain > -4.0, doubts(scan, plain.shape, ends_in_plane=False), 0.0)
    assert lost.max() == 6.0
    assert torch.equal(guess.output.occupancy, plain - lost)


def test_what_one_view_shows_asks_for_no_other_outline(model, monkeypatch):
    def never(*arguments, **options):
        raise AssertionError

    monkeypatch.setattr("gscomplete.shape.predict.doubts_beside_outlines", never)
    whole = ball()
    scan = whole.select(whole.means[:, 0] > 0.1)
    assert best_view_share(scan.means.numpy()) >= ONE_VIEW_SHARE
    asked(model, scan, ends_in_plane=False)
    with pytest.raises(AssertionError):
        asked(model, scan, ends_in_plane=True)


def test_beside_a_cut_part_only_whole_outlines_count(model, monkeypatch):
    def above(points, views, places, *, ends_in_plane, captured):
        assert ends_in_plane
        assert captured
        return 6.0 * (places[:, 2] > 0.1).astype(np.float32)

    monkeypatch.setattr("gscomplete.shape.predict.doubts_beside_outlines", above)
    partial = half(ball())
    guess = asked(model, partial, ends_in_plane=True, captured=True)
    plain = plain_answer(model, partial, guess.inputs)
    upper = torch.from_numpy(cell_centers(CELLS)[..., 2] > 0.1).reshape(plain.shape)
    doubted = upper & (plain > -4.0)
    assert torch.equal(guess.output.occupancy, torch.where(doubted, plain - 6.0, plain))


@pytest.mark.parametrize("plane", [MirrorPlane(0.0, 0.0), "none"])
def test_planes_that_users_give_are_taken_at_their_word(model, plane):
    whole = ball()
    scan = whole.select(whole.means[:, 0] > 0.1)
    given = asked(model, scan, ends_in_plane=False, mirror_plane=plane)
    plain = plain_answer(model, scan, given.inputs)
    assert torch.equal(given.output.occupancy, plain) == (plane != "none")
