import pytest
import torch

from gscomplete.shape.bank.shown import answers_that_count


def test_answers_count_that_agree_about_as_much_as_with_the_plain_one():
    def filled(share):
        return torch.where(torch.arange(20) < 20 * share, 1.0, -1.0)

    def answers(shown, plain):
        found = answers_that_count([filled(s) for s in shown], filled(plain))
        return [float((answer > 0).float().mean()) for answer in found]

    assert answers([1.0, 0.9], 0.6) == [pytest.approx(s) for s in (0.6, 1.0, 0.9)]
    assert answers([1.0, 0.9], 0.3) == []  # of another object
    assert answers([1.0, 0.9], 0.95) == []  # nothing new
    assert answers([1.0, 1.0], 0.8) == []  # next to nothing new
    assert answers([1.0, 0.3], 0.5) == []  # no agreement
