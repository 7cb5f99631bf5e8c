import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from gscomplete.shape.planes.answer_scorer import FEATURES, OF_ANSWER
from recipes.train_embedded_prior.small_networks.answer_sets import ANSWERS, AnswerSets
from recipes.train_embedded_prior.small_networks.train_answer_scorer import (
    AnswerScorerConfig,
    fit,
    loss_of,
    true_scores_of_choice,
)


def simple_sets(parts: int = 400) -> AnswerSets:
    """True scores follow one feature; of a third of the parts the last answer was not asked for."""
    rng = np.random.default_rng(0)
    features = rng.normal(size=(parts, ANSWERS, len(FEATURES))).astype(np.float32)
    true_scores = (0.8 + 0.05 * np.tanh(features[..., 3])).astype(np.float32)
    true_scores[::3, -1], features[::3, -1] = np.nan, 0.0
    return AnswerSets(features, true_scores, np.ones(parts, np.float32))


def first(sets: AnswerSets, rows: slice) -> AnswerSets:
    return AnswerSets(sets.features[rows], sets.true_scores[rows], sets.weights[rows])


def test_a_scorer_learns_what_makes_answers_good():
    sets = simple_sets()
    config = AnswerScorerConfig(Path("unused"), width=16, epochs=20, batch_rows=32)
    scorer = fit(config, first(sets, slice(300)))
    chosen, likeliest, best = true_scores_of_choice(scorer, first(sets, slice(300, None)))
    assert chosen.mean() > likeliest.mean() + 0.8 * (best - likeliest).mean()
    assert (best >= chosen).all()
    assert not np.isnan(chosen).any()
    again = fit(config, first(sets, slice(300)))
    assert again.digest() == scorer.digest()
    other = fit(dataclasses.replace(config, seed=1), first(sets, slice(300)))
    assert other.digest() != scorer.digest()


def test_parts_count_by_their_weights():
    """Half of the parts say the contrary of the others, and count for nothing."""
    sets = simple_sets()
    contrary = np.arange(len(sets)) % 2 == 0
    true_scores = np.where(contrary[:, None], 1.6 - sets.true_scores, sets.true_scores)
    weights = np.where(contrary, 0.0, 1.0).astype(np.float32)
    config = AnswerScorerConfig(Path("unused"), width=16, epochs=20, batch_rows=32)
    scorer = fit(config, AnswerSets(sets.features, true_scores, weights))
    chosen, likeliest, best = true_scores_of_choice(scorer, sets)
    assert chosen.mean() > likeliest.mean() + 0.8 * (best - likeliest).mean()


def test_the_likeliest_plane_is_that_of_the_highest_belief():
    sets = simple_sets(6)
    belief = sets.features[..., OF_ANSWER.index("log_belief")]
    _, likeliest, _ = true_scores_of_choice(lambda features: features[..., 0], sets)
    for row in (1, 2, 4, 5):  # all were asked about
        assert likeliest[row] == sets.true_scores[row, belief[row].argmax()]


def test_the_loss_is_least_where_the_best_answer_is_put_first_by_as_much_as_it_is_better():
    true_scores = torch.tensor([[0.9, 0.8, 0.7, 0.0]])
    asked = torch.tensor([[True, True, True, False]])
    right = 20 * (true_scores - 0.8)
    right[0, 3] = 50.0  # never asked: counts for nothing
    wrong = right.flip(1).roll(-1, 1)
    # softmax([3, 0, -3]) draws the others 5 times of 100
    assert float(loss_of(right, true_scores, asked)) == pytest.approx(0.104, abs=1e-3)
    assert float(loss_of(wrong, true_scores, asked)) > 2.0
    moved = right + 7.0  # only differences count
    assert float(loss_of(moved, true_scores, asked)) == pytest.approx(
        float(loss_of(right, true_scores, asked)), abs=1e-5
    )
