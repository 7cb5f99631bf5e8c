import pytest
import torch

from gscomplete.shape.ask import ask, mean_answer, turned, turned_back
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
    tokens, others = torch.tensor([2, 3]), torch.tensor([4, 0])
    answer = mean_answer(model, seen, (tokens, others))
    assert torch.isfinite(answer.occupancy).all()
    single = ask(model, seen, tokens)
    assert not torch.allclose(single.occupancy, answer.occupancy)
    known = mean_answer(model, seen, (tokens, others), first=single)
    assert torch.equal(known.occupancy, answer.occupancy)
    other = ask(model, seen, others, 1)
    torch.testing.assert_close(answer.occupancy, (single.occupancy + other.occupancy) / 2)
