import pytest
import torch

from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.predict import predict, predict_occupancy, turned, turned_back
from gscomplete.shape.symmetry_choice import choose_symmetries
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half
from tests.builders.shape_network import likeliest_inputs, tiny_network


@pytest.fixture(scope="module")
def model():
    return tiny_network()


def test_turning_is_undone_and_the_mean_answer_turns_with_the_object(model):
    x = torch.rand(1, 2, 6, 6, 6)
    for turns in range(4):
        for mirror in (False, True):
            assert torch.equal(turned_back(turned(x, turns, mirror), turns, mirror), x)
    seen = likeliest_inputs(half(ball()), ViewDistribution(0.0, 10.0))
    tokens = torch.tensor([2, 3])
    answer = predict_occupancy(model, seen, tokens)
    assert torch.isfinite(answer.occupancy).all()
    single = predict_occupancy(model, seen, tokens, orientations=1)
    assert not torch.allclose(single.occupancy, answer.occupancy)


def test_the_answer_is_to_what_was_chosen(model):
    partial, views = half(ball()), ViewDistribution(0.0, 10.0)
    tokens = torch.tensor([2, 3])
    guess = predict(model, partial, views, tokens, ends_in_plane=True)
    chosen = choose_symmetries(model, voxelize_partial(partial, views), tokens, ends_in_plane=True)
    assert guess.symmetry_score == chosen.symmetry_score
    for found, expected in zip(guess.seen.symmetries, chosen.symmetries, strict=True):
        assert (found.matrix == expected.matrix).all()
        assert (found.shift == expected.shift).all()
    again = predict_occupancy(model, guess.seen, tokens)
    assert torch.equal(guess.output.occupancy, again.occupancy)
